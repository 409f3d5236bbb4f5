"""How far two images are from each other, pixel by pixel: PSNR and mean absolute error."""

import math

import numpy as np

from ablate.metrics.metric import Direction, Group, Metric, Resimulation, Shown

PEAK = 255.0


def check_pair(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> None:
    """Raise ValueError unless `a` and `b` are (H, W) uint8 and `mask`, (H, W) bool, leaves a pixel to compare."""
    for name, image in (("a", a), ("b", b)):
        if image.dtype != np.uint8 or image.ndim != 2:
            raise ValueError(f"image {name} must be (H, W) uint8, got {image.shape} {image.dtype}")
    if a.shape != b.shape:
        raise ValueError(f"images must have one shape, got {a.shape} and {b.shape}")
    if mask is not None and (mask.dtype != np.bool_ or mask.shape != a.shape):
        raise ValueError(f"mask must be {a.shape} bool, got {mask.shape} {mask.dtype}")
    if a.size == 0 or (mask is not None and not mask.any()):
        raise ValueError("no pixel to compare: the image or the mask is empty")


def check_shapes(target: np.ndarray, /, **maps: np.ndarray | None) -> None:
    """Raise ValueError unless every map that is given has the shape of `target`."""
    for name, array in maps.items():
        if array is not None and array.shape != target.shape:
            raise ValueError(f"{name} must be {target.shape}, got {array.shape}")


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

    Examples
    --------
    >>> import numpy as np
    >>> from ablate.metrics import psnr
    >>> target = np.zeros((4, 4), np.uint8)
    >>> round(psnr(target + np.uint8(16), target), 2)
    24.05
    >>> psnr(target, target)
    inf
    """
    difference = _difference(a, b, mask).astype(np.int32).ravel()
    squares = int(np.sum(difference * difference, dtype=np.int64))
    return math.inf if squares == 0 else 10.0 * math.log10(PEAK**2 * difference.size / squares)


def mae(a: np.ndarray, b: np.ndarray, mask: np.ndarray | None = None) -> float:
    """Mean absolute error in grey levels, 0 to 255; arguments and errors as for `psnr`.

    Examples
    --------
    >>> import numpy as np
    >>> from ablate.metrics import mae
    >>> target = np.zeros((4, 4), np.uint8)
    >>> mae(target + np.uint8(16), target)
    16.0
    """
    difference = _difference(a, b, mask)
    return int(np.sum(np.abs(difference), dtype=np.int64)) / difference.size


_PSNR = ("dB", Direction.higher, Resimulation.level, Group.pixel, 2)
_MAE = ("grey levels", Direction.lower, Resimulation.level, Group.pixel, 2)
WHOLE_PSNR = Metric(
    *("psnr", "PSNR", *_PSNR, Shown.everywhere), of_image=lambda pair: psnr(pair.prediction, pair.target), place=10
)
FAN_PSNR = Metric(
    *("psnr_fan", "PSNR in fan", *_PSNR),
    of_image=lambda pair: psnr(pair.prediction, pair.target, pair.mask) if pair.mask.any() else None,
    place=11,
)
WHOLE_MAE = Metric(
    *("mae", "MAE", *_MAE, Shown.everywhere), of_image=lambda pair: mae(pair.prediction, pair.target), place=20
)
FAN_MAE = Metric(
    *("mae_fan", "MAE in fan", *_MAE),
    of_image=lambda pair: mae(pair.prediction, pair.target, pair.mask) if pair.mask.any() else None,
    place=21,
)
