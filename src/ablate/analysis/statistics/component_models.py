"""The model of the metric that a component is judged by, and where its effect stands in it."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
import pandas as pd

from ablate.analysis.components import DEPTH, Component, level_with, with_undeclared
from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel, fit_effects
from ablate.metrics import Direction, Group, metric_of
from ablate.metrics.metric import FRAME_TIME

COSTS = (FRAME_TIME, "parameters")  # some runs may lack them: a factor is then told by the others, or not at all
UNDECLARED = "no primary metric and band were declared for it before the runs"


def require_judged(component: Component, design: Design | None) -> tuple[str, float]:
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
    first, second = design.cells[component.key].cat.categories
    if not _compare_declared_levels(component, first, second):
        raise ValueError(f"the runs compare {first} with {second}")
    return component.metric, component.band


def _compare_declared_levels(component: Component, first: Any, second: Any) -> bool:
    """Whether these two levels of its factor are the ones that a component was declared with."""
    if component.key == DEPTH and component.off is not None:  # small frames may have a level less
        declared = abs(component.on - component.off)  # type: ignore[operator]
        return bool(abs(first - second) >= declared - 1)
    levels = {first, second}
    levels_on = set(component.levels_on)
    off_is_compared = component.off is None or levels - levels_on == {component.off}
    on_is_compared = component.on is None or len(levels & levels_on) == 1
    return off_is_compared and on_is_compared


def judged_components(
    means: pd.DataFrame, design: Design | None, components: Sequence[Component], interactions: bool = True
) -> Iterator[tuple[Component, LinearModel]]:
    """The components that can be judged, each with the model of its primary metric.

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
            metric, _ = require_judged(component, design)
            yield component, fitted(metric, means, design, components, interactions)


def fitted(
    metric: str, means: pd.DataFrame, design: Design | None, components: Sequence[Component], interactions: bool = True
) -> LinearModel:
    """The model of a metric: main effects, blocks, and two-way interactions if asked for.

    An effect is the mean of the runs with a component minus the mean of those without it.

    Parameters
    ----------
    metric : str
        Its name.
    means : DataFrame
        What `run_means` gives.
    design : Design or None
        Of the runs.
    components : sequence of Component
        Those that the design's factors switch.
    interactions : bool
        Whether two-way interactions are in the model.

    Raises
    ------
    ValueError
        When no run was scored by the metric, or the runs cannot tell the components apart.
    """
    if design is None or metric not in set(means["metric"]):
        raise ValueError(f"no run was scored by {metric}")
    runs = runs_by(metric, means, design, components)
    factors = [factor for factor in design.factors if metric not in COSTS or runs[factor].nunique() > 1]
    return fit_effects(runs, factors, interactions)


def runs_by(metric: str, means: pd.DataFrame, design: Design, components: Sequence[Component]) -> pd.DataFrame:
    """The runs by a metric, with the level that has the component as the second one of every factor.

    A metric that is best at 0 is replaced by its absolute value.

    Parameters
    ----------
    metric : str
        Its name.
    means : DataFrame
        What `run_means` gives.
    design : Design
        Of the runs.
    components : sequence of Component
        Those that the design's factors switch.
    """
    runs = means[means["metric"] == metric]
    if metric_of(metric).better is Direction.zero:
        runs = runs.assign(value=runs["value"].abs())
    for factor, on in levels_on(design, components).items():
        off = set(runs[factor].cat.categories) - {on}
        runs = runs.assign(**{factor: runs[factor].cat.set_categories([*off, on])})
    return runs


def levels_on(design: Design, components: Sequence[Component]) -> dict[str, object]:
    """By factor of a design, the level that has the component."""
    switched = {component.key: component for component in with_undeclared(components, design.factors)}
    return {
        factor: level_with(switched[factor], list(design.cells[factor].cat.categories)) for factor in design.factors
    }


def average_effect(component: Component, model: LinearModel) -> np.ndarray:
    """(terms,) weights of the effect of a component, averaged over the others."""
    return np.array([term == (component.key,) for term in model.terms], dtype=np.float64)


def effect_at_full(component: Component, model: LinearModel, has: pd.DataFrame) -> np.ndarray:
    """(terms,) weights of the effect of a component where all others are on; NaN where the runs cannot tell it.

    `has` says which components each cell has.
    """
    weights = np.array([component.key in term for term in model.terms], dtype=np.float64)
    others = [key for key in has if key != component.key]
    beside_all_others = has.loc[has[others].all(axis=1), component.key]
    terms = {frozenset(term) for term in model.terms}
    in_model = all(frozenset([component.key, other]) in terms for other in others)
    if beside_all_others.nunique() < 2 and not in_model:
        return weights * np.nan
    return weights


def sign_of(component: Component) -> int:
    """1 where larger values of its metric are better, and -1 where smaller ones are."""
    return 1 if metric_of(str(component.metric)).better is Direction.higher else -1
