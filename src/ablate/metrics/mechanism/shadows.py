"""Are shadows dark and enhancement bright? The error between them, within one tissue and depth at a time."""

import numpy as np

from ablate.metrics.metric import MECHANISM, Metric, Shown
from ablate.metrics.pair import Pair

SHADOW, ENHANCEMENT = 0.6, 1.4  # of the median attenuation at a depth
MEDIAN_BIN_MM = 1.0  # of depth, in which that median is taken
COMPARED_BIN_MM = 10.0  # of depth, in which shadow and enhancement of one tissue are compared
FEWEST_PIXELS = 100  # speckle of 22 grey levels then leaves 2 in a mean


def relative_attenuation(
    attenuation: np.ndarray, mask: np.ndarray, depth_mm: np.ndarray, bin_mm: float = MEDIAN_BIN_MM
) -> np.ndarray:
    """Attenuation map over its median in the fan at the same depth, (H, W) float32: under 1 in shadow.

    It is NaN outside the fan and where the median is 0. The arrays are those of `Pair`.
    """
    depth_bin = np.clip(depth_mm[mask] / bin_mm, 0, np.iinfo(np.uint16).max).astype(np.uint16)
    values = np.ascontiguousarray(attenuation[mask], dtype=np.float32)
    by_depth = np.split(values[np.argsort(depth_bin, kind="stable")], np.cumsum(np.bincount(depth_bin))[:-1])
    median = np.array([np.median(level) if level.size else np.nan for level in by_depth], dtype=np.float32)
    relative = np.full(attenuation.shape, np.nan, dtype=np.float32)
    at_pixel = median[depth_bin]
    relative[mask] = np.divide(values, at_pixel, out=np.full_like(values, np.nan), where=at_pixel > 0)
    return relative


def shadow_contrast(pair: Pair) -> float | None:
    """Error of the contrast between shadow and enhancement of the same tissue at the same depth, grey levels.

    Shadow is where the attenuation map is under 0.6 of its median in the fan at the same depth, enhancement where it
    is over 1.4 of it. In each bin of one label and 10 mm of depth, the mean error in shadow minus the mean error in
    enhancement is taken. The value is the magnitude of the mean over bins with the weights m n / (m + n), where m and n
    are the numbers of pixels in shadow and in enhancement: these weights are the inverse variance of the difference of
    two means. A constant error of a tissue, of a depth or of the whole image cancels.

    It is at least 0, which is right. It is None when the bins that hold both have fewer than 100 pixels of either, or
    the pair has no tissue, attenuation, depth or labels.
    """
    if pair.attenuation is None or pair.tissue_mask is None or pair.segmentation is None or pair.depth_mm is None:
        return None
    relative = relative_attenuation(pair.attenuation, pair.mask, pair.depth_mm)
    labelled = pair.mask & pair.tissue_mask & (pair.segmentation > 0)
    compared = labelled & ((relative < SHADOW) | (relative > ENHANCEMENT))
    depth_bin = np.clip(pair.depth_mm[compared] / COMPARED_BIN_MM, 0, np.iinfo(np.uint8).max).astype(np.intp)
    bins = depth_bin * 256 + pair.segmentation[compared]
    in_shadow = relative[compared] < SHADOW
    error = np.subtract(pair.prediction, pair.target, dtype=np.int16)[compared]
    sums, counts = [], []
    for chosen in (in_shadow, ~in_shadow):
        sums.append(np.bincount(bins[chosen], error[chosen], minlength=256 * 256))
        counts.append(np.bincount(bins[chosen], minlength=256 * 256).astype(np.float64))
    both = (counts[0] > 0) & (counts[1] > 0)
    (shadow, enhanced), (m, n) = ([values[both] for values in pair] for pair in (sums, counts))
    if min(m.sum(), n.sum()) < FEWEST_PIXELS:
        return None
    return float(abs(np.average(shadow / m - enhanced / n, weights=m * n / (m + n))))


SHADOW_CONTRAST = Metric(
    *("shadow_contrast", "Shadow contrast", "grey levels", *MECHANISM, 1, Shown.drawn | Shown.report),
    of_image=shadow_contrast,
    place=50,
)
