"""The integral attenuation map A: how much of the pulse's amplitude is left at each point; and A with the time gain."""

import math
from collections.abc import Sequence
from functools import lru_cache, partial

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import compiled, exponential
from ablate.ultrasound.media import time_gain_db
from ablate.ultrasound.probe import fan_mask, pixel_polar
from ablate.ultrasound.settings import Probe
from ablate.ultrasound.stages import Stage, stage

DB_PER_NEPER = 20 / math.log(10)  # 8.686
_LINES_OF_A_PART = 32
_PERCENT = 98.0  # of A, which is made 1
_LEAST = 1e-4  # of A; what is darker is black at any depth
_REACH_DB = 36.0  # levels from minus this to this are 0 to 1


@stage(Stage.attenuation_sum)
def integral_attenuation(labels: np.ndarray, losses_db_mm: np.ndarray, spacing_mm: float) -> np.ndarray:
    """exp(-cumulative sum of mu), mu = alpha f^b dz / 8.686, divided by its 98th percentile, at most 1.

    `labels` and the result, float32, are (scanlines, samples); the losses, (tissues,), are one way.
    The sum stays in the log domain, so thousands of dB neither underflow nor divide by zero.
    """
    nepers = losses_db_mm * (spacing_mm / DB_PER_NEPER)
    total, amplitude = np.empty(labels.shape), np.empty(labels.shape, np.float32)
    in_parts(partial(_add_up, labels, nepers, total), len(labels), _LINES_OF_A_PART)
    position = (1 - _PERCENT / 100) * (total.size - 1)  # of it in the falling order, interpolated as numpy.percentile
    below, after = int(position), min(int(position) + 1, total.size - 1)
    # Lines grow: so many of the first samples are as many as are needed, and none that is needed is larger than all.
    enough = total[:, after // len(total)].max()
    a, b = np.partition(total[total <= enough], (below, after))[[below, after]]  # a <= b: the larger amplitude first
    scale = a - math.log1p((position - below) * math.expm1(a - b))
    in_parts(partial(_fall, total, scale, amplitude), len(labels), _LINES_OF_A_PART)
    return amplitude


@compiled
def _add_up(labels: np.ndarray, nepers: np.ndarray, total: np.ndarray, begin: int, end: int) -> None:
    """Fill the sums, (lines, samples), of some lines."""
    for line in range(begin, end):
        summed = 0.0
        for sample in range(labels.shape[1]):
            summed += nepers[labels[line, sample]]
            total[line, sample] = summed


@compiled
def _fall(total: np.ndarray, scale: float, amplitude: np.ndarray, begin: int, end: int) -> None:
    """Fill exp(min(scale - total, 0)) of some lines."""
    for line in range(begin, end):
        for sample in range(total.shape[1]):
            amplitude[line, sample] = exponential(min(scale - total[line, sample], 0.0))


def compensated_attenuation(attenuation: np.ndarray, probe: Probe, tgc: float | Sequence[float]) -> np.ndarray:
    """The map A as the image has it: in decibels, two ways, plus the gain of the TGC at the depth of each pixel.

    It is (40 log10(max(A, 1e-4)) + g(z) + 36) / 72 with the time gain g(z) in dB, clipped to [0, 1]. At 0.5 (0 dB) the
    gain makes up for the attenuation. How bright a pixel is follows from A and z, and a crop of A does not tell z.

    Parameters
    ----------
    attenuation : (..., H, W) float in [0, 1]
        A, over its 98th percentile, of an image of the fan's bounding box.
    tgc : float or several
        A slope, dB/cm/MHz one way, or the curve of a patient, dB two ways, as `SimulatorSettings.time_gain`.

    Returns
    -------
    (..., H, W) float32 in [0, 1]
        0 outside the fan.

    Examples
    --------
    Where nothing attenuates, the gain makes the image brighter with depth:

    >>> import numpy as np
    >>> from ablate.ultrasound import ConvexProbe, compensated_attenuation
    >>> level = compensated_attenuation(np.ones((100, 139)), ConvexProbe(frequency_mhz=3.0), tgc=0.4)
    >>> [f"{level[row, 69]:.2f}" for row in (10, 50, 90)], float(level[0, 0])
    (['0.53', '0.74', '0.95'], 0.0)
    """
    height, width = attenuation.shape[-2:]
    level_db = 40 * np.log10(np.maximum(attenuation, _LEAST, dtype=np.float32))
    level_db += _gain_db(probe, tuple(tgc) if isinstance(tgc, Sequence) else tgc, (height, width))
    level_db += np.float32(_REACH_DB)
    level_db /= np.float32(2 * _REACH_DB)
    return np.clip(level_db, 0, 1, out=level_db)


@lru_cache(maxsize=4)
def _gain_db(probe: Probe, tgc: float | tuple[float, ...], shape: tuple[int, int]) -> np.ndarray:
    """Gain of the TGC at every pixel, (H, W) float32; minus infinity outside the fan, where the image is black."""
    depth_mm, _ = pixel_polar(probe, shape)
    inside = fan_mask(probe, shape)
    gain = time_gain_db(np.where(inside, depth_mm, 0), probe, tgc)
    return np.where(inside, gain, -np.inf).astype(np.float32)
