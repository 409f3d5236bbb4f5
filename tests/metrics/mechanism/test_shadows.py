"""Shadow contrast on pictures made to have, and to lack, shadows and enhancement."""

import numpy as np
import pytest

from ablate.metrics import shadow_contrast
from ablate.metrics.structures import relative_attenuation


def contrast(prediction, frame, **changes):
    return shadow_contrast(frame.pair(prediction, **changes))


def shifted(image, mask, grey):
    return np.where(mask, np.clip(image.astype(int) + grey, 0, 255), image).astype(np.uint8)


def test_relative_attenuation_is_over_the_median_of_each_depth(make_frame):
    frame = make_frame(shape=(90, 120))
    relative = relative_attenuation(frame.attenuation, frame.mask, frame.depth_mm)
    bins = frame.depth_mm.astype(int)
    for k in np.unique(bins[frame.mask]):
        here = frame.mask & (bins == k)
        expected = frame.attenuation[here] / np.median(frame.attenuation[here])
        np.testing.assert_allclose(relative[here], expected, rtol=1e-6)
    assert np.isnan(relative[~frame.mask]).all()


@pytest.mark.parametrize("shadow_grey", [-20.0, -120.0])
def test_it_is_that_of_each_tissue_and_depth_in_plain_loops(make_frame, shadow_grey):
    target, other = make_frame(0, shape=(90, 120)), make_frame(1, shape=(90, 120), shadow_grey=shadow_grey)
    median = {}
    for k in range(150):
        here = target.mask & (target.depth_mm.astype(int) == k)
        median[k] = np.median(target.attenuation[here]) if here.any() else np.nan
    errors = {}
    for i, j in zip(*np.nonzero(target.mask & target.tissue), strict=True):
        relative = target.attenuation[i, j] / median[int(target.depth_mm[i, j])]
        if relative < 0.6 or relative > 1.4:
            kept = errors.setdefault((target.labels[i, j], target.depth_mm[i, j] // 10), ([], []))
            kept[0 if relative < 0.6 else 1].append(int(other.image[i, j]) - int(target.image[i, j]))
    together = [(np.array(a), np.array(b)) for a, b in errors.values() if a and b]
    assert len({label for label, _ in errors}) == 2
    weights = [len(a) * len(b) / (len(a) + len(b)) for a, b in together]
    expected = sum(w * (a.mean() - b.mean()) for w, (a, b) in zip(weights, together, strict=True)) / sum(weights)
    assert np.sign(expected) == (1 if shadow_grey == -20 else -1), "too bright and too dark count alike"
    assert contrast(other.image, target) == pytest.approx(abs(expected), abs=1e-9)


def test_missing_shadows_are_measured_in_grey_levels(make_frame):
    target = make_frame(0)
    flat = make_frame(0, shadow_grey=0.0, enhanced_grey=0.0)
    deep = flat.image[target.shadow & target.tissue].astype(float)
    expected = np.mean(deep - target.image[target.shadow & target.tissue])
    error = contrast(flat.image, target)
    assert error > 80, "a renderer without shadows must stand out"
    assert error == pytest.approx(expected + 40, abs=4)
    assert contrast(make_frame(1).image, target) < 4, "other speckle is not another shadow"
    assert contrast(target.image, target) == 0


def test_an_error_of_a_tissue_or_a_depth_is_no_error_of_shadow(make_frame):
    target = make_frame(0, shadow_grey=-30.0, enhanced_grey=20.0)
    assert contrast(shifted(target.image, target.mask, 12), target) == pytest.approx(0, abs=2)
    by_tissue = np.where(target.labels == 3, 25, -10)
    assert contrast(shifted(target.image, target.mask, by_tissue), target) == pytest.approx(0, abs=2)
    by_depth = (target.depth_mm // 10).astype(int) - 7
    assert contrast(shifted(target.image, target.mask, by_depth), target) == pytest.approx(0, abs=2)


def test_nothing_to_measure_is_none(make_frame):
    frame = make_frame(0)
    level = np.full_like(frame.attenuation, 0.5)
    none = np.zeros_like(frame.mask)
    for changes in (
        {"attenuation": level},
        {"attenuation": np.zeros_like(level)},
        {"attenuation": None},
        {"tissue_mask": none},
        {"mask": none},
        {"segmentation": np.where(frame.shadow, 1, 2).astype(np.uint8)},
    ):
        assert contrast(frame.image, frame, **changes) is None
