"""What only a set of images has: Frechet and kernel distances, with their intervals, and why one is missing."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ablate.metrics import (
    FID_METRICS,
    SPECKLE_METRICS,
    InceptionFeatures,
    Metrics,
    bootstrap_interval,
    frechet_distance,
    kernel_distance,
    patches_inside,
)
from ablate.metrics.features import PATCH
from ablate.metrics.inception import CENTRE

_DISTANCES = {  # and how often they are resampled; of 2048 features each takes seconds
    "fid": (frechet_distance, 100),
    "kid": (kernel_distance, 200),
    "fd_speckle": (frechet_distance, 200),
    "kd_speckle": (kernel_distance, 200),
}


def not_computed(metrics: Metrics, mask: np.ndarray, inception: InceptionFeatures | None) -> dict[str, str]:
    """Distances that were asked for and that these frames or files do not allow, each with the reason.

    Parameters
    ----------
    metrics : Metrics
    mask : (H, W) bool
        The fan.
    inception : callable, optional

    Returns
    -------
    dict of str to str
    """
    reasons = {}
    if min(mask.shape) < CENTRE:
        size = f"{mask.shape[0]} x {mask.shape[1]} px"
        reasons |= dict.fromkeys(FID_METRICS, f"frames of {size} are smaller than the {CENTRE} px centre it is made of")
    elif inception is None:
        reasons |= dict.fromkeys(
            FID_METRICS,
            "no Inception weights were given (evaluation.inception=path/to/file or =download); fd_speckle and "
            "kd_speckle are the same distances on a texture descriptor, and do not compare with published values",
        )
    if not patches_inside(mask, PATCH).any():
        reasons |= dict.fromkeys(SPECKLE_METRICS, f"no patch of {PATCH} x {PATCH} px lies inside the fan")
    return {name: why for name, why in reasons.items() if name in metrics.of_set}


def distances(names: Iterable[str], found: np.ndarray, wanted: np.ndarray, sites: np.ndarray) -> dict[str, float]:
    """Distances between the features of images and of their targets, with intervals over probe sites.

    Parameters
    ----------
    names : iterable of str
        Of `FID_METRICS` or `SPECKLE_METRICS`.
    found, wanted : (n k, d) float
        Features of n images and of their targets, k rows each.
    sites : (n,) int
        Probe site of each image.

    Returns
    -------
    dict of str to float
        The distances, and with `_low` and `_high` after their names the ends of their 95 % intervals, which need two
        sites.
    """
    scalars = {}
    for name in names:
        distance, resamples = _DISTANCES[name]
        scalars[name] = distance(found, wanted)
        if len(np.unique(sites)) > 1:
            groups = np.repeat(sites, len(found) // len(sites))
            low, high = bootstrap_interval(distance, found, wanted, groups, resamples=resamples)
            scalars |= {f"{name}_low": low, f"{name}_high": high}
    return scalars
