"""What the paper's Table II says that a component does, beside what the runs of a study say."""

import pandas as pd
from scipy import stats

from ablate.analysis.statistics.component_models import models_of, of_component, why_untold
from ablate.analysis.statistics.designs import Design
from ablate.networks import COMPONENTS

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


def paper_effects(means: pd.DataFrame, design: Design | None, level: float = 0.95) -> pd.DataFrame:
    """Compare the paper's ablations with the effect of a component where all others are on.

    Parameters
    ----------
    means : DataFrame
        What `run_means` gives.
    design : Design or None
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
    models = models_of(tuple(_FULL), means, design)
    for component in COMPONENTS:
        for metric, without in _WITHOUT.get(component.name, {}).items():
            model = models[metric]
            if why_untold(component, design) or isinstance(model, str) or model.dof < 1:
                continue
            claimed = _FULL[metric] - without
            (effect, lower, upper), averaged = (
                _interval(*model.contrast(of_component(component, model, full=full)), model.dof, level)
                for full in (True, False)
            )
            excluded = not lower <= claimed <= upper
            rows.append((component.name, metric, claimed, effect, lower, upper, excluded, *averaged))
    return pd.DataFrame(rows, columns=list(PAPER_COLUMNS))


def _interval(effect: float, error: float, dof: int, level: float) -> tuple[float, float, float]:
    """An effect with the ends of its interval."""
    reach = float(stats.t.ppf((1 + level) / 2, dof)) * error
    return effect, effect - reach, effect + reach
