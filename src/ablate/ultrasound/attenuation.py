"""The integral attenuation map A: how much of the pulse's amplitude is left at each point, one way."""

from __future__ import annotations

import math

import numpy as np

from ablate.anatomy import Tissue

DB_PER_NEPER = 20 / math.log(10)  # 8.686
_STIFF_NEPERS = 1e3  # float32 is 6e-5 apart there, less than a sample of soft tissue takes


def loss_db_mm(tissue: Tissue, frequency_mhz: float) -> float:
    """Amplitude lost one way, alpha f^b, dB/mm."""
    return tissue.attenuation_db_cm_mhz * frequency_mhz**tissue.attenuation_power / 10


def integral_attenuation(labels: np.ndarray, losses_db_mm: np.ndarray, spacing_mm: float) -> np.ndarray:
    """exp(-cumulative sum of mu), mu = alpha f^b dz / 8.686, divided by its 98th percentile, at most 1.

    The sum stays in the log domain, so thousands of dB neither underflow nor divide by zero.

    Parameters
    ----------
    labels : (scanlines, samples) uint8
        Index of the tissue of each sample.
    losses_db_mm : (tissues,) float
        One way.
    spacing_mm : float
        Between samples.

    Returns
    -------
    (scanlines, samples) float32 in [0, 1]
    """
    nepers = (losses_db_mm * spacing_mm / DB_PER_NEPER).astype(np.float32)
    stiff = nepers.max() * labels.shape[1] > _STIFF_NEPERS
    total: np.ndarray = np.cumsum(nepers[labels], axis=1, dtype=np.float64 if stiff else np.float32)
    scale = _percentile_of_decay(total, 98.0)
    return np.exp(np.minimum(scale - total, 0)).astype(np.float32, copy=False)


def _percentile_of_decay(total: np.ndarray, percent: float) -> float:
    """-log of the percentile of exp(-total), interpolated as `numpy.percentile` does."""
    position = (1 - percent / 100) * (total.size - 1)
    low = int(position)
    high = min(low + 1, total.size - 1)
    ordered = np.partition(total, (low, high), axis=None)
    a, b = float(ordered[low]), float(ordered[high])  # a <= b: the larger and the smaller amplitude
    between = position - low
    return a - math.log1p(between * math.expm1(a - b))
