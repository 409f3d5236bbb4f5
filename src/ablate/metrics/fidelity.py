"""How far two images are from each other, as metrics: PSNR and mean absolute error by pixels, chi-square by patches."""

import math
from collections.abc import Callable

import numpy as np

from ablate.metrics.metric import Direction, Group, ImageMetric, Metric, Resimulation, Shown
from ablate.metrics.patches import PEAK, check_pair, patches_inside, rms


def _difference(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None) -> np.ndarray:
    check_pair(a, b, mask)
    difference = np.subtract(a, b, dtype=np.int16)
    return difference if mask is None else difference[mask]


def psnr(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Peak signal-to-noise ratio, 10 log10(255^2 / MSE); docs/metrics.md says why the paper's 255 / MSE is a misprint.

    Parameters
    ----------
    a, b : (H, W) uint8
        Grey levels.
    mask : (H, W) bool, optional
        Pixels that count; all when left out.

    Returns
    -------
    float
        dB; `inf` for identical images, never NaN.

    Raises
    ------
    ValueError
        When shapes or dtypes do not fit, or the mask is empty.
    """
    difference = _difference(a, b, mask).astype(np.int32).ravel()
    squares = int(np.sum(difference * difference, dtype=np.int64))
    return math.inf if squares == 0 else 10.0 * math.log10(PEAK**2 * difference.size / squares)


def mae(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean absolute error in grey levels, 0 to 255; arguments and errors as for `psnr`."""
    difference = _difference(a, b, mask)
    return int(np.sum(np.abs(difference), dtype=np.int64)) / difference.size


def _whole(measure: Callable[..., float]) -> ImageMetric:
    return lambda pair: measure(pair.prediction, pair.target)


def _in_fan(measure: Callable[..., float]) -> ImageMetric:
    return lambda pair: measure(pair.prediction, pair.target, pair.mask) if pair.mask.any() else None


_PSNR = ("dB", Direction.higher, Resimulation.level, Group.pixel, 2)
_MAE = ("grey levels", Direction.lower, Resimulation.level, Group.pixel, 2)
WHOLE_PSNR = Metric("psnr", "PSNR", *_PSNR, Shown.everywhere, _whole(psnr), place=10)
FAN_PSNR = Metric("psnr_fan", "PSNR in fan", *_PSNR, of_image=_in_fan(psnr), place=11)
WHOLE_MAE = Metric("mae", "MAE", *_MAE, Shown.everywhere, _whole(mae), place=20)
FAN_MAE = Metric("mae_fan", "MAE in fan", *_MAE, of_image=_in_fan(mae), place=21)
_CHI2 = ("", Direction.lower, Resimulation.floor)
PCHI2 = Metric("pchi2", "pχ²", *_CHI2, Group.patch, 3, Shown.everywhere, lambda pair: rms(pair.chi2_map), place=30)
FAN_PCHI2 = Metric(
    *("pchi2_fan", "pχ² in fan", *_CHI2, Group.patch, 3),
    of_image=lambda pair: rms(pair.chi2_map, patches_inside(pair.mask)),
    place=31,
)
TISSUE_PCHI2 = Metric(
    *("pchi2_tissue", "pχ² in tissue", *_CHI2, Group.mechanism, 3),
    of_image=lambda pair: (
        None if pair.tissue_mask is None else rms(pair.chi2_map, patches_inside(pair.tissue_mask & pair.mask))
    ),
    place=32,
)
