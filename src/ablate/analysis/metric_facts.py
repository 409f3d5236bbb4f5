"""What a reader must know of each metric: its name, which way is better, what re-simulation means for it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

REFERENCE = "sa2h"
RESIMULATION = "re-simulation"


class Better(StrEnum):
    """Which values are better."""

    larger = "larger"
    smaller = "smaller"
    nearest_zero = "nearest zero"
    unjudged = "unjudged"


class Resimulation(StrEnum):
    """What the same frame with other scatterers tells about a metric."""

    floor = "floor"  # nothing stochastic can do better
    level = "level"  # a perfect stochastic renderer scores this; beating it means smoothing
    none = "none"


@dataclass(frozen=True)
class MetricFacts:
    """How a metric is printed and judged."""

    label: str
    unit: str = ""
    better: Better = Better.smaller
    resimulation: Resimulation = Resimulation.none
    decimals: int = 2

    @property
    def title(self) -> str:
        """Label with its unit."""
        return f"{self.label} ({self.unit})" if self.unit else self.label


METRICS: dict[str, MetricFacts] = {
    "psnr": MetricFacts("PSNR", "dB", Better.larger, Resimulation.level),
    "psnr_fan": MetricFacts("PSNR in fan", "dB", Better.larger, Resimulation.level),
    "mae": MetricFacts("MAE", "grey levels", Better.smaller, Resimulation.level),
    "mae_fan": MetricFacts("MAE in fan", "grey levels", Better.smaller, Resimulation.level),
    "pchi2": MetricFacts("pχ²", "", Better.smaller, Resimulation.floor, 3),
    "pchi2_fan": MetricFacts("pχ² in fan", "", Better.smaller, Resimulation.floor, 3),
    "pchi2_tissue": MetricFacts("pχ² in tissue", "", Better.smaller, Resimulation.floor, 3),
    "fd_speckle": MetricFacts("FD speckle", "", Better.smaller, Resimulation.floor),
    "kd_speckle": MetricFacts("KD speckle", "", Better.smaller, Resimulation.floor, 3),
    "fid": MetricFacts("FID", "", Better.smaller, Resimulation.floor),
    "kid": MetricFacts("KID", "", Better.smaller, Resimulation.floor, 3),
    "shadow_contrast": MetricFacts("Shadow contrast", "grey levels", Better.nearest_zero, Resimulation.floor, 1),
    "mae_smooth": MetricFacts("Smooth MAE", "grey levels", Better.smaller, Resimulation.level),
    "nyquist_excess": MetricFacts("Nyquist excess", "dB", Better.nearest_zero, Resimulation.floor),
    "noise_sd": MetricFacts("Noise sd", "grey levels", Better.unjudged, Resimulation.level, 1),
    "envelope_rms": MetricFacts("Envelope error", "relative RMS", Better.smaller, Resimulation.level, 4),
    "ms_per_frame": MetricFacts("Time", "ms/frame", Better.smaller, Resimulation.none, 1),
    "parameters": MetricFacts("Parameters", "", Better.unjudged, Resimulation.none, 0),
}

COSTS = ("ms_per_frame", "parameters")  # what a network costs, not what it scores


def facts_of(metric: str) -> MetricFacts:
    """Facts of a metric; one that is not in `METRICS` is shown under its own name and not judged.

    Parameters
    ----------
    metric : str
        Name as logged, without `test/`.

    Returns
    -------
    MetricFacts
    """
    return METRICS.get(metric, MetricFacts(metric, better=Better.unjudged, decimals=3))


def badness(metric: str, value: float) -> float:
    """A number that is smaller the better the value; NaN when the metric is not judged.

    Parameters
    ----------
    metric : str
    value : float

    Returns
    -------
    float
    """
    signs = {Better.larger: -value, Better.smaller: value, Better.nearest_zero: abs(value)}
    return signs.get(facts_of(metric).better, float("nan"))
