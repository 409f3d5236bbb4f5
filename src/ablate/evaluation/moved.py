"""The metrics that need frames after a motion of the probe."""

from collections.abc import Callable, Collection

import numpy as np

from ablate.anatomy import Tissue, TissueKind
from ablate.dataset.motion import Motion, Moved, places_before
from ablate.evaluation.known import tissue_labels
from ablate.metrics import Metric, MovedPair, apart, is_own

_Images = Callable[[np.ndarray, int], np.ndarray]


def motion_values(
    metrics: Collection[Metric],
    moved: Moved,
    tissues: tuple[Tissue, ...],
    images_before: _Images,
    images_after: _Images,
) -> dict[int, dict[str, float]]:
    """Values of the metrics with `of_motion`, by frame of the data set and name, where it offers something to measure.

    Parameters
    ----------
    metrics : collection of Metric
        Those that are asked for.
    moved : Moved
        Which frames were moved, and how.
    tissues : tuple of Tissue
        Behind the labels 1, 2, ... of the segmentation.
    images_before, images_after : callable
        Render frames of the data set, and frames of `moved.pairs`: numbers (k,), draw -> (k, H, W) uint8.
    """
    asked = [(metric, metric.of_motion) for metric in metrics if metric.of_motion is not None]
    if not asked:
        return {}
    pairs = moved.pairs
    soft = tissue_labels(tissues, [TissueKind.soft])
    mask = pairs.mask()
    assert pairs.probe is not None  # they were simulated
    places = {motion: places_before(motion, pairs.probe, pairs.beam_shape[1], pairs.shape) for motion in Motion}
    values: dict[int, dict[str, float]] = {}
    for frame in np.unique(moved.before):
        numbers = np.flatnonzero(moved.before == frame)
        (before,) = images_before(np.array([frame]), 0)
        seen = []
        for number, after in zip(numbers, images_after(numbers, 0), strict=True):
            motion = moved.motions[number]
            tissue = np.isin(pairs.stored("segmentation", int(number)), soft) & mask
            seen.append(MovedPair(before, after, mask, tissue, *places[motion], in_plane=motion is not Motion.lift))
        frame_values = {
            metric.name: measure([apart(pair) for pair in seen] if is_own(metric) else seen)
            for metric, measure in asked
        }
        values[int(frame)] = {name: float(value) for name, value in frame_values.items() if value is not None}
    return values
