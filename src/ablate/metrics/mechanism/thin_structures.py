"""Do thin bright structures stand out? The contrast of bone surfaces with what surrounds them."""

import numpy as np
from scipy.ndimage import distance_transform_edt, find_objects, label, map_coordinates

from ablate.metrics.metric import MECHANISM, Metric, Shown
from ablate.metrics.pair import Pair

BAND_MM = 2.0  # of bone below its surface
RING_MM = (2.0, 5.0)  # from the band, of its surround
FEWEST_MM2 = 4.0  # of a band and of its surround


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
    depth_mm, pixel_mm, bone = pair.depth_mm, pair.pixel_mm, pair.bone_mask & pair.mask
    if min(bone.shape) < 2 or not bone.any():
        return None
    parts, _ = label(surface_band(bone, depth_mm, pixel_mm), np.ones((3, 3)))
    error = np.subtract(pair.prediction, pair.target, dtype=np.int16)
    fewest = FEWEST_MM2 / (pixel_mm[0] * pixel_mm[1])
    reach = [int(np.ceil(RING_MM[1] / size)) for size in pixel_mm]
    errors, weights = [], []
    for number, (rows, columns) in enumerate(find_objects(parts), start=1):
        window = tuple(slice(max(s.start - r, 0), s.stop + r) for s, r in zip((rows, columns), reach, strict=True))
        band = parts[window] == number
        away = distance_transform_edt(~band, pixel_mm)
        around = (away >= RING_MM[0]) & (away <= RING_MM[1]) & pair.mask[window] & ~bone[window]
        around &= depth_mm[window] <= depth_mm[window][band].max()
        if min(band.sum(), around.sum()) >= fewest:
            errors.append(abs(error[window][band].mean() - error[window][around].mean()))
            weights.append(band.sum())
    return float(np.average(errors, weights=weights)) if errors else None


THIN_CONTRAST = Metric(
    "thin_contrast", "Thin contrast", "grey levels", *MECHANISM, 1, Shown.drawn, of_image=thin_contrast, place=70
)
