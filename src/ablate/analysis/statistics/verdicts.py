"""Which components earn their keep: each on its one primary metric, by a rule that was written down before the runs."""

from collections.abc import Mapping, Sequence
from enum import StrEnum

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.components import Component, with_undeclared
from ablate.analysis.scored import REFERENCE, RESIMULATION
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.statistics.component_models import models_of, of_component, oriented, why_untold
from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel
from ablate.analysis.statistics.paired import holm_where_known
from ablate.metrics import Direction, metric_of
from ablate.metrics.stored_names import FRAME_TIME

ALPHA = 0.05
UNDECLARED = "no primary metric and band were declared for it before the runs"
VERDICT_COLUMNS = (
    *("component", "metric", "effect", "lower", "upper", "band", "runs_a", "runs_b", "p_holm", "verdict"),
    *("better", "p_band_holm", "dof", "distance", "full_effect", "full_lower", "full_upper"),
    *("ms_per_frame", "parameters", "why"),
)
COSTS = (FRAME_TIME, "parameters")


class Answer(StrEnum):
    """The verdict on a component: it earns its keep, it does not, or the runs cannot tell."""

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
    components: Sequence[Component],
    distances: Mapping[str, float] | None = None,
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
    components : sequence of Component
        Factors of the design that none of them switches are judged like components without a metric: undecided.
    distances : mapping of str to float, optional
        By metric, what `distances_to_resimulation` gives.
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
    components = with_undeclared(components, [] if design is None else design.factors)
    models = models_of(_judged_by(components), means, design, components)
    rows = [_row(component, models, design, level, spreads or {}) for component in components]
    table = pd.DataFrame(rows, columns=[*VERDICT_COLUMNS, "improvement", "p", "p_band"])
    table["better"] = [None if c.metric is None else metric_of(c.metric).better.value for c in components]
    table["distance"] = [(distances or {}).get(str(c.metric), np.nan) for c in components]
    for name in ("p", "p_band"):
        table[f"{name}_holm"] = holm_where_known(table[name])
    known = table["p_holm"].notna()
    verdicts = [answer(*row) for row in table.loc[known, ["improvement", "p_holm", "p_band_holm"]].to_numpy(float)]
    table["verdict"] = str(Answer.undecided)
    table.loc[known, "verdict"] = [str(verdict) for verdict in verdicts]
    open_ = known & (table["verdict"] == Answer.undecided)
    table["why"] = table["why"].astype(object)
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


def improvements(means: pd.DataFrame, design: Design | None, components: Sequence[Component]) -> pd.DataFrame:
    """What every run scored on the primary metric of every component, adjusted for other components and blocks.

    Returns
    -------
    DataFrame
        Columns component, variant, seed, on (whether the run has the component), improvement (over the mean of the runs
        without it, in units of the metric): residuals of the model of main effects and blocks, plus the effect for the
        runs that have the component.
    """
    tables, models = [], models_of(_judged_by(components), means, design, components, interactions=False)
    for component in components:
        model = _model(component, models, design)
        if isinstance(model, str) or design is None:
            continue
        runs = oriented(str(component.metric), means, design, components)
        on = runs[component.key].cat.codes.to_numpy() == 1
        effect, _ = model.contrast(of_component(component, model))
        improvement = _sign(component) * (model.residuals + effect * on)
        shown = runs[["variant", "seed"]].assign(component=component.name, on=on, improvement=improvement)
        tables.append(shown)
    names = ["component", "variant", "seed", "on", "improvement"]
    return pd.concat(tables, ignore_index=True)[names] if tables else pd.DataFrame(columns=names)


def interactions(means: pd.DataFrame, design: Design | None, components: Sequence[Component]) -> pd.DataFrame:
    """How each other component changes the improvement that a component makes on its primary metric.

    Returns
    -------
    DataFrame
        Columns component, other, improvement (half of the improvement by `component` with `other` minus that without
        it, in units of the metric of `component`) and q (the share of false claims among rows with a q as small, by
        Benjamini and Hochberg 1995; NaN where no error can be estimated).
    """
    components = with_undeclared(components, [] if design is None else design.factors)
    named = {component.key: component.name for component in components}
    rows, models = [], models_of(_judged_by(components), means, design, components)
    for component in components:
        model = _model(component, models, design)
        if isinstance(model, str):
            continue
        for k, term in enumerate(model.terms):
            if len(term) == 2 and component.key in term:
                other = named[term[0] if term[1] == component.key else term[1]]
                p = model.p_value(np.eye(len(model.terms))[k]) if model.dof > 0 else np.nan
                rows.append((component.name, other, _sign(component) * model.effects[k], p))
    table = pd.DataFrame(rows, columns=["component", "other", "improvement", "q"])
    known = table["q"].notna()
    table.loc[known, "q"] = stats.false_discovery_control(table.loc[known, "q"].to_numpy(dtype=np.float64))
    return table


def _row(
    component: Component,
    models: Mapping[str, LinearModel | str],
    design: Design | None,
    level: float,
    spreads: Mapping[str, float],
) -> dict[str, object]:
    """What `verdict_table` and the rule need of one component, by column."""
    row: dict[str, object] = {"component": component.name, "metric": component.metric, "band": component.band}
    model = _model(component, models, design)
    if isinstance(model, str) or component.band is None:
        return row | {"why": model}
    for cost in COSTS:
        priced = models[cost]
        if not isinstance(priced, str):
            added = priced.contrast(of_component(component, priced))[0]
            row[cost] = added if abs(added) > spreads.get(cost, 0.0) else 0.0
    averaged, at_full = (of_component(component, model, full=full) for full in (False, True))
    effect, error = model.contrast(averaged)
    off, on = (int(n) for n in model.runs[model.terms.index((component.key,))])
    row |= {"effect": effect, "full_effect": model.contrast(at_full)[0]}
    row |= {"runs_a": on, "runs_b": off, "dof": model.dof}
    if model.dof < 1 or min(on, off) < FEWEST_SEEDS:
        least = f"{FEWEST_SEEDS} on either side and a degree of freedom for the error are needed"
        return row | {"why": f"{on} runs with it and {off} without it; {least}"}
    row["lower"], row["upper"] = model.interval(averaged, level)[1:]
    row["full_lower"], row["full_upper"] = model.interval(at_full, level)[1:]
    improvement = _sign(component) * effect
    above = improvement - component.band
    below = float(stats.t.cdf(above / error, model.dof)) if error > 0 else float(above >= 0)
    return row | {"improvement": improvement, "p": model.p_value(averaged), "p_band": below}


def _model(component: Component, models: Mapping[str, LinearModel | str], design: Design | None) -> LinearModel | str:
    """The model of a component's primary metric, or why nothing can be said of the component."""
    if component.metric is None or component.band is None:
        return UNDECLARED
    if metric_of(component.metric).better is Direction.none:
        return "it has no metric that judges it"
    return why_untold(component, design) or models[component.metric]


def _sign(component: Component) -> int:
    """1 where larger values of its metric are better, and -1 where smaller ones are."""
    return 1 if metric_of(str(component.metric)).better is Direction.higher else -1


def _judged_by(components: Sequence[Component]) -> tuple[str, ...]:
    """The primary metrics of components, and what a network costs."""
    return (*dict.fromkeys(c.metric for c in components if c.metric is not None), *COSTS)
