"""How far two images are from each other, as metrics: PSNR and mean absolute error by pixels, chi-square by patches."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ablate.metrics.metric import Direction, Group, ImageMetric, Metric, Pair, Resimulation, Shown
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
    """Of all pixels of a frame."""
    return lambda pair: measure(pair.prediction, pair.target)


def _in_fan(measure: Callable[..., float]) -> ImageMetric:
    """Of the pixels of the fan."""
    return lambda pair: measure(pair.prediction, pair.target, pair.mask) if pair.mask.any() else None


def _pchi2(pair: Pair) -> float | None:
    return rms(pair.chi2_map)


def _pchi2_fan(pair: Pair) -> float | None:
    return rms(pair.chi2_map, patches_inside(pair.mask))


def _pchi2_tissue(pair: Pair) -> float | None:
    if pair.tissue_mask is None:
        return None
    return rms(pair.chi2_map, patches_inside(pair.tissue_mask & pair.mask))


WHOLE_PSNR = Metric(
    name="psnr",
    label="PSNR",
    unit="dB",
    better=Direction.higher,
    resimulation=Resimulation.level,
    group=Group.pixel,
    decimals=2,
    shown=Shown.everywhere,
    of_image=_whole(psnr),
    place=10,
)
FAN_PSNR = replace(
    WHOLE_PSNR,
    name="psnr_fan",
    label="PSNR in fan",
    shown=Shown.nowhere,
    of_image=_in_fan(psnr),
    place=11,
)
WHOLE_MAE = Metric(
    name="mae",
    label="MAE",
    unit="grey levels",
    better=Direction.lower,
    resimulation=Resimulation.level,
    group=Group.pixel,
    decimals=2,
    shown=Shown.everywhere,
    of_image=_whole(mae),
    place=20,
)
FAN_MAE = replace(
    WHOLE_MAE,
    name="mae_fan",
    label="MAE in fan",
    shown=Shown.nowhere,
    of_image=_in_fan(mae),
    place=21,
)
PCHI2 = Metric(
    name="pchi2",
    label="pχ²",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.patch,
    decimals=3,
    shown=Shown.everywhere,
    of_image=_pchi2,
    place=30,
)
FAN_PCHI2 = replace(
    PCHI2,
    name="pchi2_fan",
    label="pχ² in fan",
    shown=Shown.nowhere,
    of_image=_pchi2_fan,
    place=31,
)
TISSUE_PCHI2 = replace(
    PCHI2,
    name="pchi2_tissue",
    label="pχ² in tissue",
    group=Group.mechanism,
    shown=Shown.nowhere,
    of_image=_pchi2_tissue,
    place=32,
)
