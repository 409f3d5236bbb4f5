"""The linear model of a metric in a design of components, with the level of the full model as the second of each."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel, fit_effects
from ablate.metrics import Direction, metric_of
from ablate.networks import COMPONENTS, Component


def models_of(
    metrics: Sequence[str], means: pd.DataFrame, design: Design | None, interactions: bool = True
) -> dict[str, LinearModel | str]:
    """The model of every metric, or why there is none: main effects, blocks, and two-way interactions if asked for.

    An effect is the mean of the runs with a component minus the mean of those without it. `means` is what `run_means`
    gives.
    """
    found: dict[str, LinearModel | str] = {}
    for metric in metrics:
        if design is None or metric not in set(means["metric"]):
            found[metric] = f"no run was scored by {metric}"
            continue
        try:
            runs = oriented(metric, means, design)
            found[metric] = fit_effects(runs, design.factors, block="data", interactions=interactions)
        except ValueError as error:
            found[metric] = str(error)
    return found


def why_untold(component: Component, design: Design | None) -> str:
    """Why a design says nothing of a component; empty where it does."""
    if design is None or component.field not in design.factors:
        return "no run goes without it"
    levels = list(design.cells[component.field].cat.categories)
    if isinstance(component.on, str) and set(levels) != {component.on, component.off}:
        return f"the runs compare {levels[0]} with {levels[1]}"
    return ""


def oriented(metric: str, means: pd.DataFrame, design: Design) -> pd.DataFrame:
    """The runs by a metric, with the full model's level the second one of every factor.

    A metric that is best at 0 is replaced by its absolute value.
    """
    runs = means[means["metric"] == metric]
    if metric_of(metric).better is Direction.zero:
        runs = runs.assign(value=runs["value"].abs())
    on = {c.field: c.on for c in COMPONENTS}
    for factor in design.factors:
        first, second = design.cells[factor].cat.categories
        last = on[factor] if on[factor] in (first, second) else first
        if not isinstance(last, str):  # a depth follows the size of the frame; the full model's is the smaller one
            last = min(first, second)
        runs = runs.assign(**{factor: runs[factor].cat.set_categories([second if last == first else first, last])})
    return runs


def of_component(component: Component, model: LinearModel, full: bool = False) -> np.ndarray:
    """(terms,) weights of the effect of a component; with `full` where all others are on, else averaged."""
    return np.array([component.field in term and (full or len(term) == 1) for term in model.terms], dtype=np.float64)
