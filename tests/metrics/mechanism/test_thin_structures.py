"""Contrast of bone surfaces, on pictures in which they are right, smooth, displaced or missing."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ablate.metrics import Pair, thin_contrast
from ablate.metrics.structures import surface_band


def contrast(prediction, frame, **changes):
    return thin_contrast(frame.pair(prediction, **changes))


def plain(prediction, frame, parts):
    """The definition in plain loops over pixels; `parts` are the connected bands, each a list of pixels."""
    places = [(i, j) for i in range(frame.mask.shape[0]) for j in range(frame.mask.shape[1]) if frame.mask[i, j]]
    down, right = frame.pixel_mm
    error = prediction.astype(float) - frame.image
    errors, weights = [], []
    for band in parts:
        deepest = max(frame.depth_mm[p] for p in band)
        around = []
        for p in places:
            if frame.bone[p] or frame.depth_mm[p] > deepest:
                continue
            nearest = min(np.hypot((p[0] - q[0]) * down, (p[1] - q[1]) * right) for q in band)
            if 2 <= nearest <= 5:
                around.append(p)
        if min(len(band), len(around)) * down * right >= 4:
            errors.append(abs(np.mean([error[p] for p in band]) - np.mean([error[p] for p in around])))
            weights.append(len(band))
    return np.average(errors, weights=weights)


def test_it_is_that_of_each_rib_in_plain_loops(make_frame):
    target, other = make_frame(0, shape=(70, 110)), make_frame(1, shape=(70, 110))
    x = (np.arange(110) + 0.5) * target.pixel_mm[1] - 108.98  # the probe's axes, as in the frame
    z = (np.arange(70) + 0.5) * target.pixel_mm[0] - 7.234
    at_probe = -40.0  # z of the centre of the face's curvature
    parts = {}
    for i, j in zip(*np.nonzero(target.bone), strict=True):
        towards = np.array([z[i] - at_probe, x[j]]) / np.hypot(z[i] - at_probe, x[j])
        before = (round(i - 2 * towards[0] / target.pixel_mm[0]), round(j - 2 * towards[1] / target.pixel_mm[1]))
        if not target.bone[before]:
            parts.setdefault(-1 if x[j] < -30 else 1 if x[j] > 30 else 0, []).append((i, j))
    band = surface_band(target.bone, target.depth_mm, target.pixel_mm)
    assert {p for part in parts.values() for p in part} == {(i, j) for i, j in zip(*np.nonzero(band), strict=True)}
    assert len(parts) == 3
    expected = plain(other.image, target, parts.values())
    assert contrast(other.image, target) == pytest.approx(expected, abs=1e-9)


def test_bands_are_2_mm_below_the_surface_that_faces_the_probe(make_frame):
    frame = make_frame(0)
    band = surface_band(frame.bone, frame.depth_mm, frame.pixel_mm)
    assert band[frame.bone].mean() < 0.5
    assert frame.image[band].mean() > frame.image[frame.bone & ~band].mean() + 60, "bright in front, dark inside"
    thin = np.zeros_like(frame.bone)
    middle = frame.bone.shape[1] // 2
    rows = np.flatnonzero((frame.depth_mm[:, middle] > 50) & (frame.depth_mm[:, middle] < 51.8))
    thin[rows, middle - 9 : middle + 9] = True
    np.testing.assert_array_equal(surface_band(thin, frame.depth_mm, frame.pixel_mm), thin)


def test_smooth_displaced_and_missing_bone_counts_and_speckle_hardly(make_frame):
    target, again = make_frame(0), make_frame(1)
    floor = contrast(again.image, target)
    assert contrast(target.image, target) == 0
    assert floor < 12
    smooth = [contrast(gaussian_filter(again.image, sigma), target) for sigma in (1, 2, 4)]
    assert floor - 1 < smooth[0] < smooth[1] < smooth[2]
    assert smooth[2] > floor + 20
    moved = [contrast(np.roll(again.image, pixels, axis=1), target) for pixels in (3, 6)]
    assert floor + 3 < moved[0] < moved[1]
    missing = np.where(target.bone, 120, again.image).astype(np.uint8)
    assert contrast(missing, target) > floor + 15
    brighter = np.where(target.mask, np.minimum(target.image.astype(int) + 10, 255), 0).astype(np.uint8)
    assert contrast(brighter, target) < 3, "a constant error is none of contrast"


def test_bone_that_is_too_bright_does_not_make_up_for_bone_that_is_too_dark(make_frame):
    target = make_frame(0)
    left = np.arange(target.image.shape[1]) < target.image.shape[1] // 2
    change = np.where(target.bone, np.where(left, -30, 30), 0)
    changed = np.clip(target.image.astype(int) + change, 0, 255).astype(np.uint8)
    assert contrast(changed, target) > 15


def test_nothing_to_measure_is_none(make_frame):
    frame = make_frame(0)
    none = np.zeros_like(frame.mask)
    assert contrast(frame.image, frame, bone_mask=none) is None
    assert contrast(frame.image, frame, mask=none) is None
    assert contrast(frame.image, frame, bone_mask=frame.mask) is None, "bone without a surround"
    speck = none.copy()
    speck[120, 170] = True
    assert contrast(frame.image, frame, bone_mask=speck) is None, "less than 4 mm^2"
    for shape in ((1, 1), (1, 40), (40, 1)):
        everywhere, image = np.ones(shape, bool), np.zeros(shape, np.uint8)
        maps = {"depth_mm": np.zeros(shape), "pixel_mm": (1.0, 1.0), "bone_mask": everywhere}
        assert thin_contrast(Pair(image, image, everywhere, **maps)) is None
