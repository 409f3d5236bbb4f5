"""Frechet and kernel distances between a set of images and their targets, with intervals and reasons for gaps."""

from collections.abc import Collection, Iterable, Mapping

import numpy as np

from ablate.metrics import (
    METRICS,
    FeatureKind,
    InceptionFeatures,
    Metric,
    bootstrap_interval,
    inception_file,
    load_inception,
    needs_inception,
    patches_inside,
)
from ablate.metrics.features import PATCH
from ablate.metrics.inception import CENTRE
from ablate.metrics.stored_names import BOUNDS


def inception_for(
    metrics: Mapping[str, Metric], shape: tuple[int, int], where: str | None, device: str
) -> InceptionFeatures | None:
    """The network of FID and KID, None where no metric needs it, frames are too small, or none was given.

    `shape` is (H, W) of a frame in px, `where` is `EvaluationSettings.inception`.
    """
    if where is None or min(shape) < CENTRE or not needs_inception(metrics):
        return None
    return load_inception(inception_file(where), device)


def not_computed(
    metrics: Collection[Metric], mask: np.ndarray, frames: int, inception: InceptionFeatures | None
) -> tuple[frozenset[str], tuple[str, ...]]:
    """Return the names of distances that cannot be computed, and the reasons, a sentence each.

    `mask`, (H, W) bool, is the fan of each of `frames` frames.
    """
    inception_kind, speckle_kind = FeatureKind.inception, FeatureKind.speckle
    size = f"{mask.shape[0]} x {mask.shape[1]} px"
    reasons = {}
    if min(mask.shape) < CENTRE:
        reasons[inception_kind] = f"frames of {size} are smaller than the {CENTRE} px centre that they are made of"
    elif inception is None:
        reasons[inception_kind] = "no Inception weights were given (evaluation.inception=path/to/file or =download)"
    if patches_inside(mask, PATCH).sum() * frames < 2:
        reasons[speckle_kind] = f"fewer than two patches of {PATCH} x {PATCH} px lie inside the fan"
    asked = {features: [m.name for m in metrics if m.uses(features)] for features in FeatureKind}
    missing = {features: why for features, why in reasons.items() if asked[features]}
    notes = {features: f"{' and '.join(asked[features])}: not computed, {why}" for features, why in missing.items()}
    if inception_kind in notes and asked[speckle_kind]:
        others = " and ".join(m.name for m in METRICS.values() if m.uses(speckle_kind))
        notes[inception_kind] += f"; {others} are these distances of a texture descriptor, not of Inception's features"
    return frozenset(name for features in missing for name in asked[features]), tuple(f"{n}." for n in notes.values())


def distances(metrics: Iterable[Metric], found: np.ndarray, wanted: np.ndarray, sites: np.ndarray) -> dict[str, float]:
    """Distances between features of n images and of their targets, both (n k, d) float with k rows an image.

    Names with `_lower` and `_upper` are the ends of 95 % intervals over `sites`, (n,) int, the probe site of each
    image.
    They need two sites.
    """
    scalars = {}
    for metric in metrics:
        if metric.of_set is None:
            continue
        name, distance = metric.name, metric.of_set.distance
        scalars[name] = distance(found, wanted)
        if len(np.unique(sites)) > 1:
            groups = np.repeat(sites, len(found) // len(sites))
            ends = bootstrap_interval(distance, found, wanted, groups, resamples=metric.of_set.resamples)
            scalars |= {f"{name}_{side}": end for side, end in zip(BOUNDS, ends, strict=True)}
    return scalars
