"""Are structures where they belong, and as bright? Shadows, smooth errors, and surfaces of bone."""

from functools import lru_cache, partial

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects, gaussian_filter, label, map_coordinates

from ablate.metrics.metric import Direction, Group, Metric, Pair, Resimulation, Shown

SHADOW, ENHANCEMENT = 0.6, 1.4  # of the median attenuation at a depth
MEDIAN_BIN_MM = 1.0  # of depth, in which that median is taken
COMPARED_BIN_MM = 10.0  # of depth, in which shadow and enhancement of one tissue are compared
FEWEST_PIXELS = 100  # speckle of 22 grey levels then leaves 2 in a mean
SMOOTH_SIGMA_MM = 1.5
SMOOTH_SIGMA_PX = 4.0  # where the size of a pixel is not known
BAND_MM = 2.0  # of bone below its surface
RING_MM = (2.0, 5.0)  # from the band, of its surround
FEWEST_MM2 = 4.0  # of a band and of its surround
_smooth = partial(gaussian_filter, mode="constant", truncate=3.0)  # of an image that is 0 outside


def relative_attenuation(attenuation: np.ndarray, mask: np.ndarray, depth_mm: np.ndarray) -> np.ndarray:
    """Attenuation map over its median in the fan at the same depth, (H, W) float32; the arrays are those of `Pair`.

    It is under 1 in shadow, and NaN outside the fan and where the median is 0.
    """
    depth_bin = np.clip(depth_mm[mask] / MEDIAN_BIN_MM, 0, np.iinfo(np.uint16).max).astype(np.uint16)
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
    m = np.bincount(bins[in_shadow], minlength=256 * 256).astype(np.float64)
    n = np.bincount(bins[~in_shadow], minlength=256 * 256).astype(np.float64)
    shadow = np.bincount(bins[in_shadow], error[in_shadow], minlength=256 * 256)
    enhanced = np.bincount(bins[~in_shadow], error[~in_shadow], minlength=256 * 256)
    both = (m > 0) & (n > 0)
    m, n = m[both], n[both]
    if min(m.sum(), n.sum()) < FEWEST_PIXELS:
        return None
    difference = shadow[both] / m - enhanced[both] / n
    return float(abs(np.average(difference, weights=m * n / (m + n))))


SHADOW_CONTRAST = Metric(
    name="shadow_contrast",
    label="Shadow contrast error",
    unit="grey levels",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.mechanism,
    decimals=1,
    shown=Shown.screen | Shown.report,
    of_image=shadow_contrast,
    place=50,
)


def mae_smooth(pair: Pair) -> float | None:
    """MAE in grey levels inside the fan after a Gaussian, which averages speckle and keeps structure and level.

    The Gaussian has a standard deviation of 1.5 mm along both axes, or of 4 px without `pixel_mm`, and is normalised
    inside the fan, so the black outside does not count. The value is None where there is no fan.
    """
    mask = pair.mask
    if not mask.any():
        return None
    sigma = (SMOOTH_SIGMA_PX, SMOOTH_SIGMA_PX)
    if pair.pixel_mm:
        sigma = (SMOOTH_SIGMA_MM / pair.pixel_mm[0], SMOOTH_SIGMA_MM / pair.pixel_mm[1])
    difference = np.subtract(pair.prediction, pair.target, dtype=np.float32) * mask
    smooth = _smooth(difference, sigma) / _smoothed_mask(mask.tobytes(), mask.shape, sigma)
    return float(np.abs(smooth[mask]).mean(dtype=np.float64))


@lru_cache(maxsize=4)
def _smoothed_mask(mask_bytes: bytes, shape: tuple[int, int], sigma_px: tuple[float, float]) -> np.ndarray:
    """The mask's own Gaussian average; it is kept because it is the same for all frames of a probe."""
    mask = np.frombuffer(mask_bytes, dtype=np.bool_).reshape(shape)
    return np.maximum(_smooth(mask.astype(np.float32), sigma_px), np.finfo(np.float32).tiny)


MAE_SMOOTH = Metric(
    name="mae_smooth",
    label="Smooth MAE",
    unit="grey levels",
    better=Direction.lower,
    resimulation=Resimulation.level,
    group=Group.mechanism,
    decimals=2,
    shown=Shown.screen | Shown.report,
    of_image=mae_smooth,
    place=60,
)


def surface_band(bone: np.ndarray, depth_mm: np.ndarray, pixel_mm: tuple[float, float]) -> np.ndarray:
    """Bone at most 2 mm below a surface that faces the probe, (H, W) bool; thinner bone is in it as a whole.

    A pixel belongs to it if the point 2 mm before it, along its scanline, is no bone. The arrays are those of
    `Pair`.
    """
    down_and_right = np.gradient(depth_mm, *pixel_mm)  # away from the probe
    pixels = np.nonzero(bone)
    steps = [BAND_MM * slope[pixels] / size for slope, size in zip(down_and_right, pixel_mm, strict=True)]
    before = np.rint(np.subtract(pixels, steps))
    band = np.zeros_like(bone)
    band[pixels] = map_coordinates(bone.astype(np.uint8), before, order=0) == 0  # beyond the image is no bone
    return band


def thin_contrast(pair: Pair) -> float | None:
    """Error of the contrast of bone surfaces with their surround, grey levels.

    The contrast of a structure is the mean of its surface band minus the mean of its surround. The value is the mean
    over structures, weighted by the pixels of their bands, of |contrast in the prediction - contrast in the target|.
    A structure is a connected part of the bands of `surface_band`, with diagonal neighbours. Its surround lies 2 to
    5 mm from it, is no bone, and is not deeper than its deepest pixel, so that the shadow below is left out. Bands and
    surrounds of less than 4 mm^2 are left out.

    It is at least 0, which is right. It is None where there is no such structure, or the pair has no bone, depth or
    size of a pixel.
    """
    if pair.bone_mask is None or pair.depth_mm is None or pair.pixel_mm is None:
        return None
    depth_mm = pair.depth_mm
    pixel_mm = pair.pixel_mm
    bone = pair.bone_mask & pair.mask
    if min(bone.shape) < 2 or not bone.any():
        return None
    parts, _ = label(surface_band(bone, depth_mm, pixel_mm), np.ones((3, 3)))
    error = np.subtract(pair.prediction, pair.target, dtype=np.int16)
    fewest = FEWEST_MM2 / (pixel_mm[0] * pixel_mm[1])
    reach = [int(np.ceil(RING_MM[1] / size)) for size in pixel_mm]
    errors = []
    weights = []
    for number, extent in enumerate(find_objects(parts), start=1):
        window = tuple(slice(max(s.start - r, 0), s.stop + r) for s, r in zip(extent, reach, strict=True))
        band = parts[window] == number
        away = distance_transform_edt(~band, pixel_mm)
        around = (away >= RING_MM[0]) & (away <= RING_MM[1]) & pair.mask[window] & ~bone[window]
        around &= depth_mm[window] <= depth_mm[window][band].max()
        if min(band.sum(), around.sum()) >= fewest:
            errors.append(abs(error[window][band].mean() - error[window][around].mean()))
            weights.append(band.sum())
    return float(np.average(errors, weights=weights)) if errors else None


THIN_CONTRAST = Metric(
    name="thin_contrast",
    label="Thin contrast error",
    unit="grey levels",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.mechanism,
    decimals=1,
    shown=Shown.screen,
    of_image=thin_contrast,
    place=70,
)
