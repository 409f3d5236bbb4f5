"""The linear model of a metric in a design of components, and the paper's effects beside those of a study."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ablate.analysis.components import Component, level_with, why_not_compared, with_undeclared
from ablate.analysis.statistics.designs import Design
from ablate.analysis.statistics.effects import LinearModel, fit_effects
from ablate.metrics import Direction, metric_of

# Means of the paper's Table II. Patch chi-square is printed there times 100.
_FULL = {"psnr": 28.19, "mae": 6.37, "pchi2": 0.1860}
_WITHOUT: dict[str, dict[str, float]] = {
    "att": {"psnr": 25.04, "mae": 8.75, "pchi2": 0.2940},
    "concat": {"psnr": 26.23, "mae": 9.08, "pchi2": 0.2936},
    "conv": {"psnr": 24.85, "mae": 8.87, "pchi2": 0.3270},
    "noise": {"psnr": 26.45, "mae": 8.14, "pchi2": 0.2595},
}
PAPER_COLUMNS = (
    *("component", "metric", "paper", "effect", "lower", "upper", "excluded"),
    *("averaged", "averaged_lower", "averaged_upper"),
)


def models_of(
    metrics: Sequence[str],
    means: pd.DataFrame,
    design: Design | None,
    components: Sequence[Component],
    interactions: bool = True,
) -> dict[str, LinearModel | str]:
    """The model of every metric, or why there is none: main effects, blocks, and two-way interactions if asked for.

    An effect is the mean of the runs with a component minus the mean of those without it. `means` is what `run_means`
    gives.
    """
    models: dict[str, LinearModel | str] = {}
    for metric in metrics:
        if design is None or metric not in set(means["metric"]):
            models[metric] = f"no run was scored by {metric}"
            continue
        try:
            runs = oriented(metric, means, design, components)
            models[metric] = fit_effects(runs, design.factors, block="data", interactions=interactions)
        except ValueError as error:
            models[metric] = str(error)
    return models


def why_untold(component: Component, design: Design | None) -> str:
    """Why a design says nothing of a component; empty where it does."""
    if design is None or component.key not in design.factors:
        return "no run goes without it"
    return why_not_compared(component, list(design.cells[component.key].cat.categories))


def oriented(metric: str, means: pd.DataFrame, design: Design, components: Sequence[Component]) -> pd.DataFrame:
    """The runs by a metric, with the level that has the component as the second one of every factor.

    A metric that is best at 0 is replaced by its absolute value.
    """
    runs = means[means["metric"] == metric]
    if metric_of(metric).better is Direction.zero:
        runs = runs.assign(value=runs["value"].abs())
    switched = {component.key: component for component in with_undeclared(components, design.factors)}
    for factor in design.factors:
        levels = list(design.cells[factor].cat.categories)
        last = level_with(switched[factor], levels)
        first = levels[0] if last == levels[1] else levels[1]
        runs = runs.assign(**{factor: runs[factor].cat.set_categories([first, last])})
    return runs


def of_component(component: Component, model: LinearModel, full: bool = False) -> np.ndarray:
    """(terms,) weights of the effect of a component; with `full` where all others are on, else averaged."""
    return np.array([component.key in term and (full or len(term) == 1) for term in model.terms], dtype=np.float64)


def paper_effects(
    means: pd.DataFrame, design: Design | None, components: Sequence[Component], level: float = 0.95
) -> pd.DataFrame:
    """Compare the paper's ablations with the effect of a component where all others are on.

    Parameters
    ----------
    means : DataFrame
        What `run_means` gives.
    design : Design or None
    components : sequence of Component
        Those that the paper ablated are known by their names.
    level : float
        Coverage of the interval.

    Returns
    -------
    DataFrame
        One row a component and metric of the paper that the runs can tell: columns component, metric, paper (SA2H minus
        SA2H without the component), effect (the same of these runs, at the full model), lower, upper, excluded (whether
        the paper's effect lies outside this interval), and the effect averaged over the design with its interval.
    """
    rows = []
    models = models_of(tuple(_FULL), means, design, components)
    for component in components:
        for metric, without in _WITHOUT.get(component.name, {}).items():
            model = models[metric]
            if why_untold(component, design) or isinstance(model, str) or model.dof < 1:
                continue
            claimed = _FULL[metric] - without
            effect, lower, upper = model.interval(of_component(component, model, full=True), level)
            averaged = model.interval(of_component(component, model), level)
            excluded = not lower <= claimed <= upper
            rows.append((component.name, metric, claimed, effect, lower, upper, excluded, *averaged))
    return pd.DataFrame(rows, columns=list(PAPER_COLUMNS))
