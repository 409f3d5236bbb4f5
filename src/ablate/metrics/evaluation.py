"""All metrics of one predicted image, from one table: a new metric of the package is a function and a line here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ablate.metrics.fidelity import check_pair, mae, psnr
from ablate.metrics.mechanism import mae_smooth, nyquist_excess, shadow_contrast
from ablate.metrics.patch_histograms import patch_chi2, patches_inside, rms


@dataclass(frozen=True, eq=False)
class Pair:
    """A prediction beside its target, with what is known about the frame.

    Attributes
    ----------
    prediction, target : (H, W) uint8
        Grey levels.
    mask : (H, W) bool
        The fan.
    tissue_mask : (H, W) bool, optional
        Pixels of tissue; fluid, gas and the outside are False. Without it the tissue metrics are left out.
    attenuation : (H, W) float in [0, 1], optional
        The integral attenuation map. Without it there is no shadow contrast.
    depth_mm : (H, W) float, mm, optional
        Distance from the probe's face along the scanline. Without it there is no shadow contrast.
    segmentation : (H, W) uint8, optional
        Tissue labels, for metrics that need them.

    Raises
    ------
    ValueError
        When shapes or dtypes do not fit.
    """

    prediction: np.ndarray
    target: np.ndarray
    mask: np.ndarray
    tissue_mask: np.ndarray | None = None
    attenuation: np.ndarray | None = None
    depth_mm: np.ndarray | None = None
    segmentation: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_pair(self.prediction, self.target)
        for name in ("mask", "tissue_mask", "attenuation", "depth_mm", "segmentation"):
            array = getattr(self, name)
            if array is not None and array.shape != self.target.shape:
                raise ValueError(f"{name} must be {self.target.shape}, got {array.shape}")

    @cached_property
    def chi2_map(self) -> np.ndarray:
        """(H // 20, W // 20) float: patch chi-square map, computed once."""
        return patch_chi2(self.prediction, self.target)


def _inside_fan(metric: Callable[..., float]) -> Callable[[Pair], float | None]:
    return lambda pair: metric(pair.prediction, pair.target, pair.mask) if pair.mask.any() else None


def _pchi2_tissue(pair: Pair) -> float | None:
    if pair.tissue_mask is None:
        return None
    return rms(pair.chi2_map, patches_inside(pair.tissue_mask & pair.mask))


def _shadow_contrast(pair: Pair) -> float | None:
    if pair.attenuation is None or pair.tissue_mask is None or pair.depth_mm is None:
        return None
    return shadow_contrast(pair.prediction, pair.target, pair.attenuation, pair.mask, pair.tissue_mask, pair.depth_mm)


ImageMetric = Callable[[Pair], float | None]

#: Raise it when a metric gives another value for the same images: kept scores of re-simulation are then made anew.
METRICS_VERSION = 1

IMAGE_METRICS: dict[str, ImageMetric] = {
    "psnr": lambda pair: psnr(pair.prediction, pair.target),
    "psnr_fan": _inside_fan(psnr),
    "mae": lambda pair: mae(pair.prediction, pair.target),
    "mae_fan": _inside_fan(mae),
    "pchi2": lambda pair: rms(pair.chi2_map),
    "pchi2_fan": lambda pair: rms(pair.chi2_map, patches_inside(pair.mask)),
    "pchi2_tissue": _pchi2_tissue,
    "shadow_contrast": _shadow_contrast,
    "mae_smooth": _inside_fan(mae_smooth),
    "nyquist_excess": lambda pair: nyquist_excess(pair.prediction, pair.target, pair.mask),
}


def evaluate_image(pair: Pair, metrics: Mapping[str, ImageMetric] = IMAGE_METRICS) -> dict[str, float]:
    """Every metric that this pair allows.

    Parameters
    ----------
    pair : Pair
    metrics : mapping of str to callable
        By name.

    Returns
    -------
    dict of str to float
        Metrics that the frame offers nothing for (no shadow in it, no tissue mask) are left out; `psnr` may be inf.
        No metric of the package is NaN; one of the user's may be.
    """
    found = {}
    for name, metric in metrics.items():
        try:
            value = metric(pair)
            if value is not None:
                found[name] = float(value)
        except Exception as error:
            error.add_note(f"by the metric {name}")
            raise
    return found
