"""The integral attenuation map A: how much of the pulse's amplitude is left at each point, one way."""

import math

import numpy as np

from ablate.ultrasound.stages import Stage, stage

DB_PER_NEPER = 20 / math.log(10)  # 8.686
_DOUBLE_FROM_NEPERS = 1e3  # float32 is 6e-5 apart there, less than a sample of soft tissue takes


@stage(Stage.attenuation_sum)
def integral_attenuation(labels: np.ndarray, losses_db_mm: np.ndarray, spacing_mm: float) -> np.ndarray:
    """exp(-cumulative sum of mu), mu = alpha f^b dz / 8.686, divided by its 98th percentile, at most 1.

    `labels` and the result, float32, are (scanlines, samples); the losses, (tissues,), are one way.
    The sum stays in the log domain, so thousands of dB neither underflow nor divide by zero.
    """
    nepers = (losses_db_mm * spacing_mm / DB_PER_NEPER).astype(np.float32)
    large = nepers.max() * labels.shape[1] > _DOUBLE_FROM_NEPERS
    total: np.ndarray = np.cumsum(nepers[labels], axis=1, dtype=np.float64 if large else np.float32)
    scale = _percentile_of_decay(total, 98.0)
    return np.exp(np.minimum(scale - total, 0)).astype(np.float32, copy=False)


def _percentile_of_decay(total: np.ndarray, percent: float) -> float:
    """-log of the percentile of exp(-total), interpolated as `numpy.percentile` does."""
    position = (1 - percent / 100) * (total.size - 1)
    below = int(position)
    above = min(below + 1, total.size - 1)
    ordered = np.partition(total, (below, above), axis=None)
    a, b = float(ordered[below]), float(ordered[above])  # a <= b: the larger and the smaller amplitude
    return a - math.log1p((position - below) * math.expm1(a - b))
