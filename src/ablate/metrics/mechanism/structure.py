"""Is each structure where it belongs and as bright as it should be? The error that is left after a Gaussian."""

from functools import lru_cache

import numpy as np
from scipy.fft import fft, irfft2, next_fast_len, rfft2

from ablate.metrics.metric import Direction, Group, Metric, Resimulation, Shown
from ablate.metrics.pair import Pair

SMOOTH_SIGMA_MM = 1.5
SMOOTH_SIGMA_PX = 4.0  # where the size of a pixel is not known


def mae_smooth(pair: Pair) -> float | None:
    """MAE in grey levels inside the fan after a Gaussian, which averages speckle and keeps structure and level.

    The Gaussian has a standard deviation of 1.5 mm along both axes, or of 4 px without `pixel_mm`, and is normalised
    inside the fan, so the black outside does not count. The value is None where there is no fan.
    """
    mask = pair.mask
    if not mask.any():
        return None
    sigma = tuple(SMOOTH_SIGMA_MM / size for size in pair.pixel_mm) if pair.pixel_mm else (SMOOTH_SIGMA_PX,) * 2
    difference = np.subtract(pair.prediction, pair.target, dtype=np.float32) * mask
    smooth = _smooth(difference, sigma) / _smoothed_mask(mask.tobytes(), mask.shape, sigma)
    return float(np.abs(smooth[mask]).mean(dtype=np.float64))


@lru_cache(maxsize=4)
def _smoothed_mask(mask_bytes: bytes, shape: tuple[int, int], sigma_px: tuple[float, ...]) -> np.ndarray:
    """The mask's own Gaussian average; it is kept because it is the same for all frames of a probe."""
    mask = np.frombuffer(mask_bytes, dtype=np.bool_).reshape(shape)
    return np.maximum(_smooth(mask.astype(np.float32), sigma_px), np.finfo(np.float32).tiny)


def _smooth(image: np.ndarray, sigma_px: tuple[float, ...]) -> np.ndarray:
    """Gaussian cut off at 3 standard deviations, of an image that is 0 outside; by FFT, in half the time of taps."""
    height, width = image.shape
    shape, transfer = _gaussian_transfer((height, width), sigma_px)
    return np.asarray(irfft2(rfft2(image, shape) * transfer, shape)[:height, :width])


@lru_cache(maxsize=4)
def _gaussian_transfer(shape: tuple[int, int], sigma_px: tuple[float, ...]) -> tuple[tuple[int, ...], np.ndarray]:
    """Size of the FFT, with room for the Gaussian's reach, and its transfer function there."""
    lengths, transfers = [], []
    for length, sigma in zip(shape, sigma_px, strict=True):
        reach = int(3.0 * sigma + 0.5)
        offsets = np.arange(-reach, reach + 1)
        taps = np.exp(-0.5 * (offsets / sigma) ** 2)
        lengths.append(next_fast_len(length + reach, real=True))
        transfers.append(fft(np.bincount(offsets % lengths[-1], taps / taps.sum(), lengths[-1])).real)
    return tuple(lengths), np.outer(transfers[0], transfers[1][: lengths[1] // 2 + 1]).astype(np.float32)


MAE_SMOOTH = Metric(
    *("mae_smooth", "Smooth MAE", "grey levels", Direction.lower, Resimulation.level, Group.mechanism, 2, Shown.drawn),
    of_image=mae_smooth,
    place=60,
)
