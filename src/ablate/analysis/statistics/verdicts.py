"""What is known of components: each on its one primary metric, by a rule that was written down before the runs."""

from collections.abc import Callable, Mapping, Sequence
from enum import StrEnum
from functools import cache

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.components import Component, Question, short_keys, with_undeclared
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.statistics.component_models import (
    ALPHA,
    COSTS,
    added_costs,
    average_effect,
    effect_at_full,
    error_of,
    fitted,
    judged_components,
    levels_on,
    require_judged,
    runs_by,
    sign_of,
)
from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel, t_interval, t_test
from ablate.analysis.statistics.paired import holm, where_known
from ablate.metrics import metric_of

_TYPES = {  # of the columns
    "component": "object",
    "metric": "object",
    "effect": "float64",
    "lower": "float64",
    "upper": "float64",
    "band": "float64",
    "runs_a": "Int64",
    "runs_b": "Int64",
    "p_holm": "float64",
    "verdict": "object",
    "better": "object",
    "p_band_holm": "float64",
    "dof": "float64",
    "full_effect": "float64",
    "full_lower": "float64",
    "full_upper": "float64",
    "least": "float64",
    "most": "float64",
    "ms_per_frame": "float64",
    "parameters": "float64",
    "question": "object",
    "share": "float64",
    "error": "object",
    "why": "object",
}
VERDICT_COLUMNS = tuple(_TYPES)


class Verdict(StrEnum):
    """What is known of a component, by what was asked of it; `undecided` where the runs cannot tell."""

    earns = "earns"
    does_not = "does_not"
    saves = "saves"
    harms = "harms"
    undecided = "undecided"


def verdict(improvement: float, p_holm: float, p_band_holm: float) -> Verdict:
    """The rule for a component that is to earn its keep. Both p-values are corrected (Holm), each family at 5 %.

    1. `does_not`: the improvement is smaller than the band (one-sided test, `p_band_holm`). This includes harm, and an
       improvement above zero that is too small to matter.
    2. Else `earns`: the metric improves (two-sided test against zero, `p_holm`, and its sign).
    3. Else `undecided`.
    """
    if p_band_holm < ALPHA:
        return Verdict.does_not
    return Verdict.earns if p_holm < ALPHA and improvement > 0 else Verdict.undecided


def saving_verdict(improvement: float, p_holm: float, p_band_holm: float, cheaper: bool) -> Verdict:
    """The rule for a component that is to save: not worse by the band, at a lower cost (a test of non-inferiority).

    1. `saves`: it is `cheaper`, and the harm is smaller than the band (one-sided test, `p_band_holm`). This includes
       an improvement, and a harm above zero that is too small to matter.
    2. Else `harms`: the metric gets worse (two-sided test against zero, `p_holm`, and its sign), unless the harm is
       smaller than the band.
    3. Else `undecided`.

    Parameters
    ----------
    improvement : float
        The effect, above 0 where the metric is better with the component.
    p_holm, p_band_holm : float
        Of both tests, corrected (Holm).
    cheaper : bool
        Whether it makes one of the costs lower and none higher.
    """
    if p_band_holm < ALPHA:
        return Verdict.saves if cheaper else Verdict.undecided
    return Verdict.harms if p_holm < ALPHA and improvement < 0 else Verdict.undecided


def verdict_table(
    means: pd.DataFrame,
    design: Design | None,
    components: Sequence[Component],
    spreads: Mapping[str, float] | None = None,
) -> pd.DataFrame:
    """Judge every component on its primary metric, from one mean a run.

    Effects, intervals and p-values are those of `fit_effects`: main effects, two-way interactions and blocks, with one
    error pooled over all runs of the design. Where an F-test at 5 % finds that the runs with a component and those
    without it vary differently, and the error by the spread of each side is larger than the pooled one, it counts
    (`LinearModel.own_error`). A metric that is best at 0 enters by the absolute value of a run's mean.

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
        zero), verdict; then better (which values of the metric are better), p_band_holm (that the improvement, or
        the harm where the question is whether it saves, reaches the band), dof (of the error), full_effect,
        full_lower, full_upper (the effect with all others on, from the same model, if runs can tell it), least and
        most (what the rule compares with zero and with the band: the ends of two tests with Holm's correction, not of
        an interval), ms_per_frame and parameters (what the component adds), question, share (that the band is of the
        scale), error (an `ErrorOf`), and why it is undecided. What the runs cannot tell is missing.
    """
    on = levels_on(design, components)
    components = with_undeclared(components, on)
    model_of = cache(lambda metric: fitted(metric, means, on))
    cells = pd.DataFrame() if design is None else design.cells
    has = pd.DataFrame({factor: cells[factor] == level for factor, level in on.items()})
    rows = [_row(component, model_of, design, has, spreads or {}) for component in components]
    table = pd.DataFrame(rows, columns=[*VERDICT_COLUMNS, "improvement", "standard_error", "p", "p_band"])
    table["better"] = [None if c.metric is None else metric_of(c.metric).better.value for c in components]
    table["question"] = [str(c.question) for c in components]
    table["share"] = [c.share for c in components]
    for name in ("p", "p_band"):
        table[f"{name}_holm"] = where_known(holm, table[name])
    dof = table["dof"].astype(float)
    error = table["standard_error"]
    to_zero = error * stats.t.isf(ALPHA / 2 / _holm_factor(table, "p"), dof)
    to_band = error * stats.t.isf(ALPHA / _holm_factor(table, "p_band"), dof)
    saving = table["question"] == Question.saves
    table["least"] = table["improvement"] - to_zero.where(~saving, to_band)
    table["most"] = table["improvement"] + to_band.where(~saving, to_zero)
    # A missing p-value is below no level: undecided.
    judged = table[["improvement", "p_holm", "p_band_holm"]].to_numpy(float)
    cheaper = _is_cheaper(table)
    table["verdict"] = [
        str(saving_verdict(improvement, p, p_band, cheap) if saves else verdict(improvement, p, p_band))
        for (improvement, p, p_band), cheap, saves in zip(judged, cheaper, saving, strict=True)
    ]
    table["why"] = table["why"].astype(object)
    is_open = table["p_holm"].notna() & (table["verdict"] == Verdict.undecided)
    table.loc[is_open & ~saving, "why"] = "its improvement is neither shown to be above zero nor below the band"
    table.loc[is_open & saving, "why"] = "its harm is neither shown to be above zero nor below the band"
    no_saving = is_open & saving & (table["p_band_holm"] < ALPHA)
    table.loc[no_saving, "why"] = "its harm is below the band, but no lower cost was measured"
    return table[list(VERDICT_COLUMNS)].astype({name: kind for name, kind in _TYPES.items() if kind != "object"})


def _is_cheaper(table: pd.DataFrame) -> pd.Series:
    """Whether a component makes one of the costs lower and none higher."""
    costs = table[list(COSTS)].astype(float)
    return (costs < 0).any(axis=1) & ~(costs > 0).any(axis=1)


def _holm_factor(table: pd.DataFrame, name: str) -> pd.Series:
    """Holm's test of a component at 5 % is a test at 5 % over this factor, at most the number of tests."""
    p = table[name].astype(float)
    corrected = table[f"{name}_holm"].astype(float)
    return (corrected / p).where(p > 0, p.count())


def improvements(means: pd.DataFrame, design: Design | None, components: Sequence[Component]) -> pd.DataFrame:
    """What every run scored on the primary metric of every component, adjusted for other components and blocks.

    Columns are component, variant, seed, on (whether the run has the component) and improvement (over the mean of the
    runs without it, in units of the metric): residuals of the model of main effects and blocks, plus the effect for the
    runs that have the component. Where no run goes without two, those without another one tell nothing: left out.
    """
    tables = []
    on = levels_on(design, components)
    for component, factor, model in judged_components(means, design, components, interactions=False):
        runs = runs_by(str(component.metric), means, on)
        has = runs[factor].cat.codes.to_numpy() == 1
        effect, _ = model.contrast(average_effect(factor, model))
        improvement = sign_of(component.metric) * (model.residuals + effect * has)
        table = runs[["variant", "seed"]].assign(component=component.name, on=has, improvement=improvement)
        lacking = runs[list(on)].apply(lambda levels: levels.cat.codes == 0).sum(axis=1)
        if lacking.max() <= 1:
            table = table[(lacking == 0) | ~has]
        tables.append(table)
    names = ["component", "variant", "seed", "on", "improvement"]
    return pd.concat(tables, ignore_index=True)[names] if tables else pd.DataFrame(columns=names)


def interactions(means: pd.DataFrame, design: Design | None, components: Sequence[Component]) -> pd.DataFrame:
    """How each other component changes the improvement that a component makes on its primary metric.

    Columns are component, other, improvement (half of the improvement by `component` with `other` minus that without
    it, in units of the metric of `component`) and q (the share of false claims among rows with a q as small, by
    Benjamini and Hochberg 1995; NaN where `factorial_effects` gives no p).
    """
    judged = list(judged_components(means, design, components))
    names = short_keys(levels_on(design, components))
    names |= {component.key: component.name for component in reversed(components) if component.key in names}
    names |= {factor: component.name for component, factor, _ in judged}
    rows = []
    for component, factor, model in judged:
        for k, term in enumerate(model.terms):
            if len(term) != 2 or factor not in term:
                continue
            other = term[0] if term[1] == factor else term[1]
            p = model.p_value(np.eye(len(model.terms))[k]) if model.is_tested(k) else np.nan
            rows.append((component.name, names[other], sign_of(component.metric) * model.effects[k], p))
    table = pd.DataFrame(rows, columns=["component", "other", "improvement", "q"])
    return table.assign(q=where_known(stats.false_discovery_control, table["q"]).astype("float64"))


def _row(
    component: Component,
    model_of: Callable[[str], LinearModel],
    design: Design | None,
    has: pd.DataFrame,
    spreads: Mapping[str, float],
) -> dict[str, object]:
    """What `verdict_table` and the rule need of one component, by column."""
    row: dict[str, object] = {"component": component.name, "metric": component.metric, "band": component.band}
    try:
        metric, band, factor = require_judged(component, design)
        model = model_of(metric)
    except ValueError as reason:
        return row | {"why": str(reason)}
    row |= added_costs(factor, model_of, spreads)
    average = average_effect(factor, model)
    at_full = effect_at_full(factor, model, has)
    effect, full_effect = model.contrast(average)[0], model.contrast(at_full)[0]
    term = model.terms.index((factor,))
    off, on = (int(count) for count in model.runs[term])
    row |= {"effect": effect, "full_effect": full_effect, "runs_a": on, "runs_b": off, "dof": model.dof}
    if model.dof < 1 or min(on, off) < FEWEST_SEEDS:
        least = f"{FEWEST_SEEDS} on either side and a degree of freedom for the error are needed"
        return row | {"why": f"{on} runs with it and {off} without it; {least}"}
    if not model.is_tested(term):
        where = " and ".join(np.array(["without it", "with it"])[~model.spread[term]])
        return row | {"why": f"no spread: no seed changes anything in the runs {where}"}
    error, dof, source = error_of(model, average, term)
    row["lower"], row["upper"] = t_interval(effect, error, dof)
    row["full_lower"], row["full_upper"] = t_interval(full_effect, *error_of(model, at_full, term)[:2])
    row |= {"dof": dof, "error": str(source), "standard_error": error, "p": t_test(effect, error, dof)}
    improvement = sign_of(component.metric) * effect
    beyond = improvement + band if component.question is Question.saves else band - improvement
    reached = float(stats.t.sf(beyond / error, dof)) if error > 0 else float(beyond <= 0)
    return row | {"improvement": improvement, "p_band": reached}
