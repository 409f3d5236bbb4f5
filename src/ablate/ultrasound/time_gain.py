"""The time gain: at the depths of samples, and of the attenuation map A."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.interpolate import PchipInterpolator

from ablate.ultrasound.probe import fan_mask, pixel_polar, sample_depths_mm
from ablate.ultrasound.settings import LimitedGain, Probe

Gain = float | Sequence[float] | np.ndarray | LimitedGain  # as `SimulatorSettings.time_gain`
_LEAST = 1e-4  # of A; what is darker is black at any depth
_REACH_DB = 36.0  # levels from minus this to this are 0 to 1


def time_gain_db(depth_mm: np.ndarray, probe: Probe, tgc: Gain) -> np.ndarray:
    """Two-way time gain at some depths, (...) to (...) dB.

    A number is the attenuation of a tissue, dB/cm/MHz: the gain is what it takes on the way there and back. Several are
    the gain itself at equal distances from the face to the imaging depth; between them it is a monotone cubic (Fritsch
    and Carlson, SIAM J. Numer. Anal. 17, 1980). A `LimitedGain` is no larger than its limit anywhere.
    """
    if isinstance(tgc, LimitedGain):
        return np.minimum(time_gain_db(depth_mm, probe, tgc.gain), tgc.most_db)
    if np.ndim(tgc):
        gain_db: np.ndarray = PchipInterpolator(np.linspace(0, probe.depth_mm, np.size(tgc)), tgc)(depth_mm)
        return gain_db
    return 2 * np.asarray(tgc).item() * probe.frequency_mhz * (depth_mm / 10)


def compensated_attenuation(attenuation: np.ndarray, probe: Probe, tgc: Gain) -> np.ndarray:
    """The map A as the image has it: in decibels, two ways, plus the gain of the TGC at the depth of each pixel.

    It is (40 log10(max(A, 1e-4)) + g(z) + 36) / 72 with the time gain g(z) in dB, clipped to [0, 1]. At 0.5 (0 dB) the
    gain makes up for the attenuation. How bright a pixel is follows from A and z, and a crop of A does not tell z.

    Parameters
    ----------
    attenuation : (..., H, W) float in [0, 1]
        A, over its 98th percentile, of an image of the fan's bounding box.
    tgc : float or several
        A slope, dB/cm/MHz one way, or the curve of a patient, dB two ways, as `SimulatorSettings.time_gain`; or one of
        both with its limit.

    Returns
    -------
    (..., H, W) float32 in [0, 1]
        0 outside the fan.
    """
    height, width = attenuation.shape[-2:]
    if not isinstance(tgc, LimitedGain):  # which can be a key of a cache
        values = np.asarray(tgc).tolist()
        tgc = tuple(values) if np.ndim(tgc) else values
    return _compensated(attenuation, _gain_db(probe, tgc, (height, width)))


def compensated_beam(attenuation: np.ndarray, probe: Probe, tgc: Gain) -> np.ndarray:
    """`compensated_attenuation` of A in beam space, (..., rows, scanlines) float32 in [0, 1]."""
    gain_db = time_gain_db(sample_depths_mm(probe, attenuation.shape[-2]), probe, tgc)
    return _compensated(attenuation, gain_db[:, None].astype(np.float32))


def _compensated(attenuation: np.ndarray, gain_db: np.ndarray) -> np.ndarray:
    level_db = 40 * np.log10(np.maximum(attenuation, _LEAST, dtype=np.float32))
    level_db += gain_db
    level_db += np.float32(_REACH_DB)
    level_db /= np.float32(2 * _REACH_DB)
    return np.clip(level_db, 0, 1, out=level_db)


@lru_cache(maxsize=4)
def _gain_db(probe: Probe, tgc: float | tuple[float, ...] | LimitedGain, shape: tuple[int, int]) -> np.ndarray:
    """Gain of the TGC at every pixel, (H, W) float32; minus infinity outside the fan, where the image is black."""
    depth_mm, _ = pixel_polar(probe, shape)
    inside = fan_mask(probe, shape)
    gain = time_gain_db(np.where(inside, depth_mm, 0), probe, tgc)
    return np.where(inside, gain, -np.inf).astype(np.float32)
