"""The model of the metric that a component is judged by, and where its effect stands in it."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from enum import StrEnum

import numpy as np
import pandas as pd

from ablate.analysis.components import Component, key_of, level_with, with_undeclared
from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel, fit_effects
from ablate.metrics import Direction, Group, metric_of
from ablate.metrics.metric import FRAME_TIME

COSTS = (FRAME_TIME, "parameters")  # some runs may lack them: a factor is then told by the others, or not at all
ALPHA = 0.05
_ROUNDING = 1e-6  # of a cost that least squares give
UNDECLARED = "no primary metric and band were declared for it before the runs"


class ErrorOf(StrEnum):
    """Whose spread the error of a component's tests is."""

    all = "all"  # of all runs of the design, pooled
    own = "own"  # of the runs with it and of those without it, each side by itself


def require_judged(component: Component, design: Design | None) -> tuple[str, float, str]:
    """A component's metric, its band, and the factor of the design that switches it.

    Raises ValueError where it cannot be judged by them, and the message says why.
    """
    if component.metric is None or component.band is None:
        raise ValueError(UNDECLARED)
    judge = metric_of(component.metric)
    if not judge.computed and judge.group is not Group.cost:
        raise ValueError("its metric is not known to this command: name it in metrics=")
    if judge.better is Direction.none or judge.group is Group.cost:  # all runs of a network have one measured time
        raise ValueError("it has no metric that judges it")
    factors = [] if design is None else [name for name in design.factors if key_of(name) == component.key]
    if design is None or not factors:
        raise ValueError("no run goes without it")
    for factor in factors:
        if component.compares(*design.cells[factor].cat.categories):
            return component.metric, component.band, factor
    first = design.cells[factors[0]].cat.categories[0]
    others = " and ".join(str(design.cells[factor].cat.categories[1]) for factor in factors)
    raise ValueError(f"the runs compare {first} with {others}")


def judged_components(
    means: pd.DataFrame, design: Design | None, components: Sequence[Component], interactions: bool = True
) -> Iterator[tuple[Component, str, LinearModel]]:
    """The components that can be judged, each with its factor and the model of its primary metric.

    Parameters
    ----------
    means : DataFrame
        What `run_means` gives.
    design : Design or None
        Of the runs.
    components : sequence of Component
        Those that the design's factors switch.
    interactions : bool
        Whether two-way interactions are in the model.
    """
    for component in components:
        with suppress(ValueError):
            metric, _, factor = require_judged(component, design)
            yield component, factor, fitted(metric, means, levels_on(design, components), interactions)


def fitted(metric: str, means: pd.DataFrame, on: Mapping[str, object], interactions: bool = True) -> LinearModel:
    """The model of a metric: main effects, blocks, and two-way interactions if asked for.

    An effect is the mean of the runs with a component minus the mean of those without it.

    Parameters
    ----------
    metric : str
        Its name.
    means : DataFrame
        What `run_means` gives.
    on : mapping of str to object
        What `levels_on` gives.
    interactions : bool
        Whether two-way interactions are in the model.

    Raises
    ------
    ValueError
        When no run was scored by the metric, or the runs cannot tell the components apart.
    """
    if metric not in set(means["metric"]):
        raise ValueError(f"no run was scored by {metric}")
    runs = runs_by(metric, means, on)
    factors = [factor for factor in on if metric not in COSTS or runs[factor].nunique() > 1]
    return fit_effects(runs, factors, interactions)


def runs_by(metric: str, means: pd.DataFrame, on: Mapping[str, object]) -> pd.DataFrame:
    """The runs by a metric, its size where it is best at 0; the second level of every factor is that of `levels_on`."""
    runs = means[means["metric"] == metric]
    if metric_of(metric).better is Direction.zero:
        runs = runs.assign(value=runs["value"].abs())
    for factor, level in on.items():
        off = set(runs[factor].cat.categories) - {level}
        runs = runs.assign(**{factor: runs[factor].cat.set_categories([*off, level])})
    return runs


def levels_on(design: Design | None, components: Sequence[Component]) -> dict[str, object]:
    """By factor of a design, the level that has the component."""
    if design is None:
        return {}
    known = with_undeclared(components, design.factors)
    levels = {}
    for factor in design.factors:
        pair = list(design.cells[factor].cat.categories)
        entries = [component for component in known if component.key == key_of(factor)]
        declared = [component for component in entries if component.compares(*pair)]
        levels[factor] = level_with([*declared, *entries][0], pair)
    return levels


def average_effect(factor: str, model: LinearModel) -> np.ndarray:
    """(terms,) weights of the effect of a component, by its factor, averaged over the others."""
    return np.array([term == (factor,) for term in model.terms], dtype=np.float64)


def effect_at_full(factor: str, model: LinearModel, has: pd.DataFrame) -> np.ndarray:
    """(terms,) weights of the effect of a component where all others are on; NaN where the runs cannot tell it.

    `has` says which components each cell has, a column a factor.
    """
    weights = np.array([factor in term for term in model.terms], dtype=np.float64)
    others = [name for name in has if name != factor]
    beside_all_others = has.loc[has[others].all(axis=1), factor]
    terms = {frozenset(term) for term in model.terms}
    in_model = all(frozenset([factor, other]) in terms for other in others)
    if beside_all_others.nunique() < 2 and not in_model:
        return weights * np.nan
    return weights


def sign_of(metric: str | None) -> int:
    """1 where larger values of a metric are better, and -1 where smaller ones are."""
    return 1 if metric_of(str(metric)).better is Direction.higher else -1


def error_of(model: LinearModel, weights: np.ndarray, term: int) -> tuple[float, float, ErrorOf]:
    """The standard error that an effect is tested by, its degrees of freedom, and whose spread it is.

    It is that of each side by itself where that is larger, and an F-test at 5 % finds that the sides vary differently:
    the runs with the component, whose own term is `term`, and those without it. `weights`, (terms,), are the effect's.
    """
    _, pooled = model.contrast(weights)
    own, dof, p_alike = model.own_error(weights, term)
    if p_alike < ALPHA and own > pooled:
        return own, dof, ErrorOf.own
    return pooled, model.dof, ErrorOf.all


def added_costs(factor: str, model_of: Callable[[str], LinearModel], spreads: Mapping[str, float]) -> dict[str, float]:
    """What a component adds, by cost that was measured with it and without; 0 where it is within the spread."""
    costs = {}
    for cost in COSTS:
        with suppress(ValueError):  # not measured
            model = model_of(cost)
            weights = average_effect(factor, model)
            if weights.any():
                added, _ = model.contrast(weights)
                costs[cost] = added if abs(added) > spreads.get(cost, _ROUNDING) else 0.0
    return costs
