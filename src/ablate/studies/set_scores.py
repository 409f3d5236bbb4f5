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


def not_computed(
    metrics: Metrics, mask: np.ndarray, frames: int, inception: InceptionFeatures | None
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Distances that were asked for and that these frames or files do not allow.

    Parameters
    ----------
    metrics : Metrics
    mask : (H, W) bool
        The fan.
    frames : int
        How many there are.
    inception : callable, optional

    Returns
    -------
    names : frozenset of str
    notes : tuple of str
        The reasons, a sentence each.
    """
    size = f"{mask.shape[0]} x {mask.shape[1]} px"
    reasons = {}
    if min(mask.shape) < CENTRE:
        reasons[FID_METRICS] = f"frames of {size} are smaller than the {CENTRE} px centre that they are made of"
    elif inception is None:
        reasons[FID_METRICS] = "no Inception weights were given (evaluation.inception=path/to/file or =download)"
    if patches_inside(mask, PATCH).sum() * frames < 2:
        reasons[SPECKLE_METRICS] = f"fewer than two patches of {PATCH} x {PATCH} px lie inside the fan"
    missing = {name: why for names, why in reasons.items() for name in names if name in metrics.of_set}
    notes = [
        f"{' and '.join(name for name in missing if missing[name] == why)}: not computed, {why}"
        for why in dict.fromkeys(missing.values())
    ]
    if not metrics.of_set.isdisjoint(SPECKLE_METRICS) and any(name in missing for name in FID_METRICS):
        notes[0] += (
            "; fd_speckle and kd_speckle are these distances of a texture descriptor, not of Inception's features"
        )
    return frozenset(missing), tuple(f"{note}." for note in notes)


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
