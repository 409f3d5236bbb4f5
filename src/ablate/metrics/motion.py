"""Does grain move with the body? Correlation of speckle before and after a known motion of the probe."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from ablate.metrics.metric import Direction, Group, Metric, MovedPair, Resimulation, Shown

GRAIN_SIGMA_PX = 4.0  # what varies more slowly is structure
FEWEST_PIXELS = 500  # of tissue, for a correlation
BLACK, WHITE = 0, 255


def high_passed(image: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """An image (H, W) uint8 less its Gaussian mean of 4 px within a mask (H, W) bool, float32; 0 outside the mask."""
    return _high_passed(image.tobytes(), mask.tobytes(), image.shape)


@lru_cache(maxsize=4)  # of a frame and its motions: the image before is asked for again and again
def _high_passed(image: bytes, mask: bytes, shape: tuple[int, int]) -> np.ndarray:
    inside = np.frombuffer(mask, bool).reshape(shape).astype(np.float32)
    values = np.frombuffer(image, np.uint8).reshape(shape) * inside
    mean = gaussian_filter(values, GRAIN_SIGMA_PX, truncate=3.0)
    grain: np.ndarray = (values - mean / _share(mask, shape)) * inside
    return grain


@lru_cache(maxsize=2)
def _share(mask: bytes, shape: tuple[int, int]) -> np.ndarray:
    """How much of the Gaussian lies in the mask."""
    inside = np.frombuffer(mask, bool).reshape(shape).astype(np.float32)
    return np.maximum(gaussian_filter(inside, GRAIN_SIGMA_PX, truncate=3.0), np.float32(1e-6))


def _correlation(before: np.ndarray, after: np.ndarray, where: np.ndarray) -> float | None:
    """Pearson's, over some pixels; None of too few, or of images without grain."""
    if np.count_nonzero(where) < FEWEST_PIXELS:
        return None
    first, second = before[where].astype(np.float64), after[where].astype(np.float64)
    if first.std() == 0 or second.std() == 0:
        return None
    return float(np.corrcoef(first, second)[0, 1])


def _shown(moved: MovedPair) -> np.ndarray:
    """Tissue that is neither black nor white, where grain cannot be seen."""
    return moved.tissue_mask & (moved.after > BLACK) & (moved.after < WHITE)


def after_motion(moved: MovedPair) -> float | None:
    """Correlation of the grain after a motion with that before it, of the same points of the body."""
    places = np.stack([moved.rows_before, moved.columns_before])
    fan_before = map_coordinates(moved.mask.astype(np.float32), places, order=1, cval=0.0) > 1 - 1e-3
    before = map_coordinates(high_passed(moved.before, moved.mask), places, order=3, mode="nearest")
    return _correlation(before, high_passed(moved.after, moved.mask), _shown(moved) & fan_before)


def on_screen(moved: MovedPair) -> float | None:
    """Correlation of the grain after a motion with that before it, pixel by pixel."""
    grains = high_passed(moved.before, moved.mask), high_passed(moved.after, moved.mask)
    return _correlation(*grains, _shown(moved))


def motion(moved: Sequence[MovedPair]) -> float | None:
    """Correlation of the grain in soft tissue at the same points of the body, mean over motions in the image plane.

    Grain is the image less its Gaussian mean of 4 px; the image before is resampled by cubic splines. The simulator's
    own frames after the same motions give the level: speckle changes a little as the beam turns.
    """
    return _mean([after_motion(one) for one in moved if one.in_plane])


def motion_screen(moved: Sequence[MovedPair]) -> float | None:
    """Correlation of the grain in soft tissue pixel by pixel, mean over motions: high where grain sticks to the screen.

    See `motion`. Of a motion out of the plane the right value, that of the simulator, is not small.
    """
    return _mean([on_screen(one) for one in moved])


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


MOTION = Metric(
    name="motion",
    label="Grain after a motion",
    unit="correlation",
    better=Direction.higher,
    resimulation=Resimulation.level,
    group=Group.mechanism,
    decimals=2,
    shown=Shown.screen | Shown.report,
    of_motion=motion,
    place=112,
)
MOTION_SCREEN = Metric(
    name="motion_screen",
    label="Grain that stays on the screen",
    unit="correlation",
    resimulation=Resimulation.level,
    group=Group.mechanism,
    decimals=2,
    of_motion=motion_screen,
    place=114,
)
