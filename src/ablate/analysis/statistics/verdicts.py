"""Which components earn their keep: each on its one primary metric, by a rule that was written down before the runs."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import StrEnum
from functools import cache

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.components import DEPTH, Component, level_with, with_undeclared
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel, fit_effects
from ablate.analysis.statistics.paired import holm, where_known
from ablate.metrics import Direction, Group, metric_of
from ablate.metrics.metric import FRAME_TIME

ALPHA = 0.05
_COSTS = FRAME_TIME, "parameters"  # some runs may lack them: a factor is then told by the others, or not at all
UNDECLARED = "no primary metric and band were declared for it before the runs"
VERDICT_COLUMNS = (
    *("component", "metric", "effect", "lower", "upper", "band", "runs_a", "runs_b", "p_holm", "verdict"),
    *("better", "p_band_holm", "dof", "full_effect", "full_lower", "full_upper", "least", "most"),
    *("ms_per_frame", "parameters", "why"),
)


class Verdict(StrEnum):
    """What is known of a component: it earns its keep, it does not, or the runs cannot tell."""

    earns = "earns"
    does_not = "does_not"
    undecided = "undecided"


def verdict(improvement: float, p_holm: float, p_band_holm: float) -> Verdict:
    """The rule. Both p-values are corrected over the components (Holm), each family at 5 %.

    1. `does_not`: the improvement is smaller than the band (one-sided test, `p_band_holm`). This includes harm, and an
       improvement above zero that is too small to matter.
    2. Else `earns`: the metric improves (two-sided test against zero, `p_holm`, and its sign).
    3. Else `undecided`.
    """
    if p_band_holm < ALPHA:
        return Verdict.does_not
    return Verdict.earns if p_holm < ALPHA and improvement > 0 else Verdict.undecided


def verdict_table(
    means: pd.DataFrame,
    design: Design | None,
    components: Sequence[Component],
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
    spreads : mapping of str to float, optional
        By cost, the spread of what was measured of a run: a component that adds no more adds none, 0.

    Returns
    -------
    DataFrame
        One row a component, columns component, metric, effect (mean of the runs with it minus mean of those without it,
        in units of the metric), lower, upper, band, runs_a (with it), runs_b (without it), p_holm (that the effect is
        zero), verdict; then better (which values of the metric are better), p_band_holm (that the improvement reaches
        the band), dof (of the error), full_effect, full_lower, full_upper (the effect with all others on, from
        the same model, if runs can tell it), least and most (what the rule compares with zero and with the band:
        the ends of two tests with Holm's correction, not of an interval), ms_per_frame and parameters (what the
        component adds), and why it is undecided. What the runs cannot tell is missing.
    """
    components = with_undeclared(components, [] if design is None else design.factors)
    model_by = cache(lambda metric: _fitted(metric, means, design, components))
    has = pd.DataFrame()  # a row a cell: which components it has
    if design is not None:
        has = pd.DataFrame({f: design.cells[f] == on for f, on in _levels_on(design, components).items()})
    rows = [_row(component, model_by, design, has, spreads or {}) for component in components]
    table = pd.DataFrame(rows, columns=[*VERDICT_COLUMNS, "improvement", "error", "p", "p_band"])
    table["better"] = [None if c.metric is None else metric_of(c.metric).better.value for c in components]
    for name in ("p", "p_band"):
        table[f"{name}_holm"] = where_known(holm, table[name])
    # Holm's test of a component at 5 % is a test at 5 % over this factor, at most the number of tests.
    p = table[["p", "p_band", "p_holm", "p_band_holm"]].astype(float)
    factor = {name: (p[f"{name}_holm"] / p[name]).where(p[name] > 0, p[name].count()) for name in ("p", "p_band")}
    dof, error = table["dof"].astype(float), table["error"]
    table["least"] = table["improvement"] - error * stats.t.isf(ALPHA / 2 / factor["p"], dof)
    table["most"] = table["improvement"] + error * stats.t.isf(ALPHA / factor["p_band"], dof)
    # A missing p-value is below no level: undecided.
    judged = table[["improvement", "p_holm", "p_band_holm"]].to_numpy(float)
    table["verdict"] = [str(verdict(*row)) for row in judged]
    table["why"] = table["why"].astype(object)
    open_ = table["p_holm"].notna() & (table["verdict"] == Verdict.undecided)
    table.loc[open_, "why"] = "its improvement is neither shown to be above zero nor below the band"
    words = ("component", "metric", "verdict", "better", "why")
    types = {name: "float64" for name in VERDICT_COLUMNS if name not in words}
    return table[list(VERDICT_COLUMNS)].astype(types | dict.fromkeys(("runs_a", "runs_b", "dof"), "Int64"))


def improvements(means: pd.DataFrame, design: Design | None, components: Sequence[Component]) -> pd.DataFrame:
    """What every run scored on the primary metric of every component, adjusted for other components and blocks.

    Columns are component, variant, seed, on (whether the run has the component) and improvement (over the mean of the
    runs without it, in units of the metric): residuals of the model of main effects and blocks, plus the effect for the
    runs that have the component. Where no run goes without two, those without another one tell nothing: left out.
    """
    tables = []
    for component, model in _judged(means, design, components, interactions=False):
        assert design is not None  # or none could be judged
        runs = _runs_by(str(component.metric), means, design, components)
        on = runs[component.key].cat.codes.to_numpy() == 1
        effect, _ = model.contrast(_of_component(component, model))
        improvement = _sign(component) * (model.residuals + effect * on)
        table = runs[["variant", "seed"]].assign(component=component.name, on=on, improvement=improvement)
        lacking = runs[design.factors].apply(lambda levels: levels.cat.codes == 0).sum(axis=1)
        tables.append(table if lacking.max() > 1 else table[(lacking == 0) | ~on])
    names = ["component", "variant", "seed", "on", "improvement"]
    return pd.concat(tables, ignore_index=True)[names] if tables else pd.DataFrame(columns=names)


def interactions(means: pd.DataFrame, design: Design | None, components: Sequence[Component]) -> pd.DataFrame:
    """How each other component changes the improvement that a component makes on its primary metric.

    Columns are component, other, improvement (half of the improvement by `component` with `other` minus that without
    it, in units of the metric of `component`) and q (the share of false claims among rows with a q as small, by
    Benjamini and Hochberg 1995; NaN where `factorial_effects` gives no p).
    """
    components = with_undeclared(components, [] if design is None else design.factors)
    named = {component.key: component.name for component in components}
    rows = []
    for component, model in _judged(means, design, components):
        for k, term in enumerate(model.terms):
            if len(term) == 2 and component.key in term:
                other = named[term[0] if term[1] == component.key else term[1]]
                told = model.dof > 0 and model.runs[k].min() >= FEWEST_SEEDS
                p = model.p_value(np.eye(len(model.terms))[k]) if told else np.nan
                rows.append((component.name, other, _sign(component) * model.effects[k], p))
    table = pd.DataFrame(rows, columns=["component", "other", "improvement", "q"])
    return table.assign(q=where_known(stats.false_discovery_control, table["q"]).astype("float64"))


def _row(
    component: Component,
    model_by: Callable[[str], LinearModel],
    design: Design | None,
    has: pd.DataFrame,
    spreads: Mapping[str, float],
) -> dict[str, object]:
    """What `verdict_table` and the rule need of one component, by column."""
    row: dict[str, object] = {"component": component.name, "metric": component.metric, "band": component.band}
    try:
        metric, band = _require_judged(component, design)
        model = model_by(metric)
    except ValueError as why:
        return row | {"why": str(why)}
    for cost in _COSTS:
        with suppress(ValueError):  # not measured
            if (weights := _of_component(component, model_by(cost))).any():  # measured with it and without
                added = model_by(cost).contrast(weights)[0]
                row[cost] = added if abs(added) > spreads.get(cost, 0.0) else 0.0
    averaged, at_full = (_of_component(component, model, full=full) for full in (False, True))
    others = [key for key in has if key != component.key]
    of_full = has.loc[has[others].all(axis=1), component.key]  # whether it is on, where all others are
    if of_full.nunique() < 2 and not all({(component.key, k), (k, component.key)} & {*model.terms} for k in others):
        at_full = at_full * np.nan  # these runs cannot tell it
    effect, error = model.contrast(averaged)
    off, on = (int(n) for n in model.runs[model.terms.index((component.key,))])
    row |= {"effect": effect, "full_effect": model.contrast(at_full)[0], "runs_a": on, "runs_b": off, "dof": model.dof}
    if model.dof < 1 or min(on, off) < FEWEST_SEEDS:
        least = f"{FEWEST_SEEDS} on either side and a degree of freedom for the error are needed"
        return row | {"why": f"{on} runs with it and {off} without it; {least}"}
    row["lower"], row["upper"] = model.interval(averaged)
    row["full_lower"], row["full_upper"] = model.interval(at_full)
    improvement = _sign(component) * effect
    below = float(stats.t.cdf((improvement - band) / error, model.dof)) if error > 0 else float(improvement >= band)
    return row | {"improvement": improvement, "error": error, "p": model.p_value(averaged), "p_band": below}


def _require_judged(component: Component, design: Design | None) -> tuple[str, float]:
    """A component's metric and band; raises ValueError where it cannot be judged by them, and the message says why."""
    if component.metric is None or component.band is None:
        raise ValueError(UNDECLARED)
    judge = metric_of(component.metric)
    if not judge.computed and judge.group is not Group.cost:
        raise ValueError("its metric is not known to this command: name it in metrics=")
    if judge.better is Direction.none or judge.group is Group.cost:  # all runs of a network have one measured time
        raise ValueError("it has no metric that judges it")
    if design is None or component.key not in design.factors:
        raise ValueError("no run goes without it")
    here, there = design.cells[component.key].cat.categories
    on = set(component.levels_on)
    told = component.off is None or {here, there} - on == {component.off}
    told &= component.on is None or len({here, there} & on) == 1
    if component.key == DEPTH and component.off is not None:  # small frames may have a level less
        told = abs(here - there) >= abs(component.on - component.off) - 1  # type: ignore[operator]
    if not told:
        raise ValueError(f"the runs compare {here} with {there}")
    return component.metric, component.band


def _judged(
    means: pd.DataFrame, design: Design | None, components: Sequence[Component], interactions: bool = True
) -> Iterator[tuple[Component, LinearModel]]:
    """The components that can be judged, each with the model of its primary metric."""
    for component in components:
        with suppress(ValueError):
            metric, _ = _require_judged(component, design)
            yield component, _fitted(metric, means, design, components, interactions)


def _fitted(
    metric: str, means: pd.DataFrame, design: Design | None, components: Sequence[Component], interactions: bool = True
) -> LinearModel:
    """The model of a metric: main effects, blocks, and two-way interactions if asked for; ValueError if there is none.

    An effect is the mean of the runs with a component minus the mean of those without it.
    """
    if design is None or metric not in set(means["metric"]):
        raise ValueError(f"no run was scored by {metric}")
    runs = _runs_by(metric, means, design, components)
    factors = [factor for factor in design.factors if metric not in _COSTS or runs[factor].nunique() > 1]
    return fit_effects(runs, factors, interactions)


def _runs_by(metric: str, means: pd.DataFrame, design: Design, components: Sequence[Component]) -> pd.DataFrame:
    """The runs by a metric, with the level that has the component as the second one of every factor.

    A metric that is best at 0 is replaced by its absolute value.
    """
    runs = means[means["metric"] == metric]
    if metric_of(metric).better is Direction.zero:
        runs = runs.assign(value=runs["value"].abs())
    for factor, on in _levels_on(design, components).items():
        runs = runs.assign(
            **{factor: runs[factor].cat.set_categories([*(set(runs[factor].cat.categories) - {on}), on])}
        )
    return runs


def _levels_on(design: Design, components: Sequence[Component]) -> dict[str, object]:
    """By factor of a design, the level that has the component."""
    switched = {component.key: component for component in with_undeclared(components, design.factors)}
    return {f: level_with(switched[f], list(design.cells[f].cat.categories)) for f in design.factors}


def _of_component(component: Component, model: LinearModel, full: bool = False) -> np.ndarray:
    """(terms,) weights of the effect of a component; with `full` where all others are on, else averaged."""
    return np.array([component.key in term and (full or len(term) == 1) for term in model.terms], dtype=np.float64)


def _sign(component: Component) -> int:
    """1 where larger values of its metric are better, and -1 where smaller ones are."""
    return 1 if metric_of(str(component.metric)).better is Direction.higher else -1
