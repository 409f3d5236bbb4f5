"""Which components earn their keep: each on its one primary metric, by a rule that was written down before the runs."""

from collections.abc import Mapping
from enum import StrEnum

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.order import REFERENCE, RESIMULATION
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.statistics.component_models import models_of, of_component, oriented, why_untold
from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel
from ablate.analysis.statistics.paired import holm_where_known
from ablate.metrics import Direction, metric_of
from ablate.metrics.stored_names import FRAME_TIME
from ablate.networks import COMPONENTS, Component

ALPHA = 0.05
# By component, the improvement of its primary metric that is too small to matter, in units of the metric: a tenth of
# the distance from SA2H to re-simulation on validation sites of the pilot, rounded, and fixed before the study
# (docs/study.md).
BANDS: dict[str, float] = {
    "att": 3.0,
    "concat": 2.5,
    "conv": 0.4,
    "noise": 0.8,
    "depth": 1.0,
    "encoding": 1.0,
}
VERDICT_COLUMNS = (
    *("component", "metric", "effect", "lower", "upper", "band", "runs_a", "runs_b", "p_holm", "verdict"),
    *("better", "p_band_holm", "dof", "distance", "full_effect", "full_lower", "full_upper"),
    *("ms_per_frame", "parameters", "why"),
)
COSTS = (FRAME_TIME, "parameters")
JUDGED_BY = (*dict.fromkeys(str(component.metric) for component in COMPONENTS), *COSTS)


class Answer(StrEnum):
    """What is said of a component."""

    earns = "earns"
    does_not = "does_not"
    undecided = "undecided"


def answer(improvement: float, p_holm: float, p_band_holm: float) -> Answer:
    """The rule. Both p-values are corrected over the components (Holm), each family at 5 %.

    1. `does_not`: the improvement is smaller than the band (one-sided test, `p_band_holm`). This includes harm, and an
       improvement above zero that is too small to matter.
    2. Else `earns`: the metric improves (two-sided test against zero, `p_holm`, and its sign).
    3. Else `undecided`.
    """
    if p_band_holm < ALPHA:
        return Answer.does_not
    return Answer.earns if p_holm < ALPHA and improvement > 0 else Answer.undecided


def verdict_table(
    means: pd.DataFrame,
    design: Design | None,
    distances: Mapping[str, float] | None = None,
    bands: Mapping[str, float] = BANDS,
    level: float = 1 - ALPHA,
    spreads: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """Judge every component on its primary metric, from one mean a run.

    Effects, intervals and p-values are those of `fit_effects`: main effects, two-way interactions and blocks, with one
    error pooled over all runs of the design. A metric that is best at 0 enters by the absolute value of a run's mean.

    Parameters
    ----------
    means : DataFrame
        What `run_means` gives.
    design : Design or None
        None where no two runs differ in a component.
    distances : mapping of str to float, optional
        By metric, what `distances_to_resimulation` gives.
    bands : mapping of str to float
        By component, in units of its metric, above 0.
    level : float
        Coverage of the intervals.
    spreads : mapping of str to float, optional
        By cost, the spread of what was measured of a run: a component that adds no more adds none, 0.

    Returns
    -------
    DataFrame
        One row a component, columns component, metric, effect (mean of the runs with it minus mean of those without it,
        in units of the metric), lower, upper, band, runs_a (with it), runs_b (without it), p_holm (that the effect is
        zero), verdict; then better (which values of the metric are better), p_band_holm (that the improvement reaches
        the band), dof (of the error), distance, full_effect, full_lower, full_upper (the effect where all other
        components are on, from the same model), ms_per_frame and parameters (what the component adds), and why it is
        undecided. What the runs cannot tell is missing.
    """
    models = models_of(JUDGED_BY, means, design)
    table = pd.DataFrame([_row(c, models, design, bands[c.name], level, spreads or {}) for c in COMPONENTS])
    table["better"] = [None if c.metric is None else metric_of(c.metric).better.value for c in COMPONENTS]
    table["distance"] = [(distances or {}).get(str(c.metric), np.nan) for c in COMPONENTS]
    for name in ("p", "p_band"):
        table[f"{name}_holm"] = holm_where_known(table[name])
    known = table["p_holm"].notna()
    verdicts = [answer(*row) for row in table.loc[known, ["improvement", "p_holm", "p_band_holm"]].to_numpy(float)]
    table["verdict"] = str(Answer.undecided)
    table.loc[known, "verdict"] = [str(verdict) for verdict in verdicts]
    open_ = known & (table["verdict"] == Answer.undecided)
    table.loc[open_, "why"] = "the runs can neither tell its improvement from zero nor from the band"
    words = ("component", "metric", "verdict", "better", "why")
    types = {name: "float64" for name in VERDICT_COLUMNS if name not in words}
    return table[list(VERDICT_COLUMNS)].astype(types | dict.fromkeys(("runs_a", "runs_b", "dof"), "Int64"))


def distances_to_resimulation(table: pd.DataFrame, reference: str = REFERENCE) -> dict[str, float]:
    """By metric, how much worse the reference is than re-simulation, in units of the metric: what there is to gain.

    `table` is what `comparison_table` gives. Metrics that one of the two lacks, or that do not judge, are left out.
    """
    means = table.pivot(index="metric", columns="variant", values="mean")
    if not {RESIMULATION, reference} <= set(means.columns):
        return {}
    found = {}
    for name, row in means.iterrows():
        metric = metric_of(str(name))
        found[str(name)] = metric.badness(row[reference]) - metric.badness(row[RESIMULATION])
    return {name: float(value) for name, value in found.items() if np.isfinite(value)}


def improvements(means: pd.DataFrame, design: Design | None) -> pd.DataFrame:
    """What every run scored on the primary metric of every component, adjusted for other components and blocks.

    Returns
    -------
    DataFrame
        Columns component, variant, seed, on (whether the run has the component), improvement (over the mean of the runs
        without it, in units of the metric): residuals of the model of main effects and blocks, plus the effect for the
        runs that have the component.
    """
    tables, models = [], models_of(JUDGED_BY, means, design, interactions=False)
    for component in COMPONENTS:
        model = _model(component, models, design)
        if isinstance(model, str) or design is None:
            continue
        runs = oriented(str(component.metric), means, design)
        on = runs[component.field].cat.codes.to_numpy() == 1
        effect, _ = model.contrast(of_component(component, model))
        improvement = _sign(component) * (model.residuals + effect * on)
        shown = runs[["variant", "seed"]].assign(component=component.name, on=on, improvement=improvement)
        tables.append(shown)
    names = ["component", "variant", "seed", "on", "improvement"]
    return pd.concat(tables, ignore_index=True)[names] if tables else pd.DataFrame(columns=names)


def interactions(means: pd.DataFrame, design: Design | None) -> pd.DataFrame:
    """How each other component changes the improvement that a component makes on its primary metric.

    Returns
    -------
    DataFrame
        Columns component, other, improvement (half of the improvement by `component` with `other` minus that without
        it, in units of the metric of `component`) and q (the share of false claims among rows with a q as small, by
        Benjamini and Hochberg 1995; NaN where no error can be estimated).
    """
    named = {component.field: component.name for component in COMPONENTS}
    rows, models = [], models_of(JUDGED_BY, means, design)
    for component in COMPONENTS:
        model = _model(component, models, design)
        if isinstance(model, str):
            continue
        for k, term in enumerate(model.terms):
            if len(term) == 2 and component.field in term:
                estimate, error = model.contrast(np.eye(len(model.terms))[k])
                other = named[term[0] if term[1] == component.field else term[1]]
                p = _two_sided(estimate, error, model.dof) if model.dof > 0 else np.nan
                rows.append((component.name, other, _sign(component) * estimate, p))
    table = pd.DataFrame(rows, columns=["component", "other", "improvement", "q"])
    known = table["q"].notna()
    table.loc[known, "q"] = stats.false_discovery_control(table.loc[known, "q"].to_numpy(dtype=np.float64))
    return table


def _row(
    component: Component,
    models: Mapping[str, LinearModel | str],
    design: Design | None,
    band: float,
    level: float,
    spreads: Mapping[str, float],
) -> dict[str, object]:
    row: dict[str, object] = dict.fromkeys((*VERDICT_COLUMNS, "improvement", "p", "p_band"))
    row |= {"component": component.name, "metric": component.metric, "band": band}
    model = _model(component, models, design)
    if isinstance(model, str):
        return row | {"why": model}
    for cost in COSTS:
        priced = models[cost]
        if not isinstance(priced, str):
            added = priced.contrast(of_component(component, priced))[0]
            row[cost] = added if abs(added) > spreads.get(cost, 0.0) else 0.0
    effect, error = model.contrast(of_component(component, model))
    full, full_error = model.contrast(of_component(component, model, full=True))
    off, on = (int(n) for n in model.runs[model.terms.index((component.field,))])
    row |= {"effect": effect, "full_effect": full, "runs_a": on, "runs_b": off, "dof": model.dof}
    if model.dof < 1 or min(on, off) < FEWEST_SEEDS:
        least = f"{FEWEST_SEEDS} on either side and a degree of freedom for the error are needed"
        return row | {"why": f"{on} runs with it and {off} without it; {least}"}
    reach = float(stats.t.ppf((1 + level) / 2, model.dof))
    improvement = _sign(component) * effect
    below = stats.t.cdf((improvement - band) / error, model.dof) if error > 0 else float(improvement >= band)
    return row | {
        "lower": effect - reach * error,
        "upper": effect + reach * error,
        "full_lower": full - reach * full_error,
        "full_upper": full + reach * full_error,
        "improvement": improvement,
        "p": _two_sided(effect, error, model.dof),
        "p_band": float(below),
    }


def _model(component: Component, models: Mapping[str, LinearModel | str], design: Design | None) -> LinearModel | str:
    """The model of a component's primary metric, or why nothing can be said of the component."""
    if component.metric is None or metric_of(component.metric).better is Direction.none:
        return "it has no metric that judges it"
    return why_untold(component, design) or models[component.metric]


def _sign(component: Component) -> int:
    """1 where larger values of its metric are better, and -1 where smaller ones are."""
    return 1 if metric_of(str(component.metric)).better is Direction.higher else -1


def _two_sided(effect: float, error: float, dof: int) -> float:
    return float(2 * stats.t.sf(abs(effect) / error, dof)) if error > 0 else float(effect == 0)
