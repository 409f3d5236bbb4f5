"""Mechanism metrics on pictures made to have, and to lack, what each looks for."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ablate.metrics import mae_smooth, noise_sd, nyquist_excess, shadow_contrast
from ablate.metrics.mechanism import line_excess_db, relative_attenuation


def contrast(prediction, frame):
    return shadow_contrast(prediction, frame.image, frame.attenuation, frame.mask, frame.tissue, frame.depth_mm)


def shifted(image, mask, grey):
    return np.where(mask, np.clip(image.astype(int) + grey, 0, 255), image).astype(np.uint8)


def test_relative_attenuation_is_over_the_median_of_each_depth(make_frame):
    frame = make_frame(shape=(90, 120))
    relative = relative_attenuation(frame.attenuation, frame.mask, frame.depth_mm, bin_mm=3.0)
    bins = (frame.depth_mm / 3.0).astype(int)
    for k in np.unique(bins[frame.mask]):
        here = frame.mask & (bins == k)
        expected = frame.attenuation[here] / np.median(frame.attenuation[here])
        np.testing.assert_allclose(relative[here], expected, rtol=1e-6)
    assert np.isnan(relative[~frame.mask]).all()


def test_shadow_contrast_is_the_difference_of_two_means(make_frame):
    """Pixel by pixel, depth by depth, in plain loops."""
    target, other = make_frame(0, shape=(90, 120)), make_frame(1, shape=(90, 120), shadow_grey=-20.0)
    millimetre = target.depth_mm.astype(int)
    errors = {"shadow": [], "enhanced": []}
    for k in np.unique(millimetre[target.mask]):
        here = target.mask & (millimetre == k)
        median = np.median(target.attenuation[here])
        for i, j in zip(*np.nonzero(here & target.tissue), strict=True):
            kind = "shadow" if target.attenuation[i, j] < 0.6 * median else "enhanced"
            if kind == "shadow" or target.attenuation[i, j] > 1.4 * median:
                errors[kind].append(int(other.image[i, j]) - int(target.image[i, j]))
    expected = np.mean(errors["shadow"]) - np.mean(errors["enhanced"])
    assert contrast(other.image, target) == pytest.approx(expected, abs=1e-9)


def test_missing_shadows_are_measured_in_grey_levels(make_frame):
    target = make_frame(0)
    flat = make_frame(0, shadow_grey=0.0, enhanced_grey=0.0)
    deep = flat.image[target.shadow & target.tissue].astype(float)
    expected = np.mean(deep - target.image[target.shadow & target.tissue])
    found = contrast(flat.image, target)
    assert found > 80, "a renderer without shadows must stand out"
    assert found == pytest.approx(expected + 40, abs=4)
    assert abs(contrast(make_frame(1).image, target)) < 4, "other speckle is not another shadow"


def test_a_global_offset_cancels_in_shadow_contrast(make_frame):
    target = make_frame(0, shadow_grey=-30.0, enhanced_grey=20.0)
    assert contrast(shifted(target.image, target.mask, 12), target) == pytest.approx(0, abs=2)


def test_nothing_to_measure_is_none_and_not_nan(make_frame):
    frame = make_frame(0)
    none = np.zeros_like(frame.mask)
    level = np.full_like(frame.attenuation, 0.5)
    for attenuation, mask, tissue in (
        (level, frame.mask, frame.tissue),
        (np.zeros_like(level), frame.mask, frame.tissue),
        (frame.attenuation, frame.mask, none),
        (frame.attenuation, none, frame.tissue),
    ):
        assert shadow_contrast(frame.image, frame.image, attenuation, mask, tissue, frame.depth_mm) is None
    assert nyquist_excess(frame.image, frame.image, none) is None
    assert noise_sd(np.stack([frame.image] * 2), none) is None


def test_smooth_error_sees_structure_and_not_speckle(make_frame):
    target, again = make_frame(0), make_frame(1)
    offset = shifted(target.image, target.mask, 8)
    assert mae_smooth(target.image, target.image, target.mask) == 0
    pixel_error = np.abs(again.image.astype(float) - target.image)[target.mask].mean()
    assert mae_smooth(again.image, target.image, target.mask) < 0.45 * pixel_error
    difference = (offset.astype(float) - target.image)[target.mask]
    assert mae_smooth(offset, target.image, target.mask) == pytest.approx(difference.mean(), abs=0.05)


def test_smooth_error_equals_normalised_convolution_in_double(make_frame):
    a, b = make_frame(0, shape=(60, 80)), make_frame(1, shape=(60, 80))
    mask = a.mask
    smooth = [gaussian_filter(x.image * mask.astype(float), 4, mode="constant", truncate=3.0) for x in (a, b)]
    weight = gaussian_filter(mask.astype(float), 4, mode="constant", truncate=3.0)
    expected = np.abs((smooth[0] - smooth[1])[mask] / weight[mask]).mean()
    assert mae_smooth(a.image, b.image, mask) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("period", [2, 4])
def test_a_checkerboard_is_seen_at_its_period(make_frame, period):
    target, again = make_frame(0), make_frame(1)
    rows, columns = np.indices(target.image.shape) % period < period // 2
    checkered = shifted(again.image, again.mask, np.where(rows ^ columns, 15, -15))
    clean = nyquist_excess(again.image, target.image, target.mask, period)
    assert abs(clean) < 1.0
    assert nyquist_excess(checkered, target.image, target.mask, period) > clean + 3


def test_excess_is_that_of_whole_spectra_block_by_block():
    """Against numpy's full transform of each block, and a loop over the lines and their neighbours."""
    rng = np.random.default_rng(2)
    image = np.clip(rng.normal(120, 20, (64, 96)) + 8 * (-1) ** np.indices((64, 96)).sum(0), 0, 255).astype(np.uint8)
    window = np.outer(np.hanning(32), np.hanning(32))
    blocks = [image[i : i + 32, j : j + 32].astype(float) for i in (0, 32) for j in (0, 32, 64)]
    power = np.mean([np.abs(np.fft.fft2((b - b.mean()) * window)) ** 2 for b in blocks], axis=0)
    power = power / np.square(window).sum() + 1 / 12
    for period in (2, 4):
        ratios = []
        lines = range(0, 32, 32 // period)
        for row, column in ((r, c) for r in lines for c in lines if r or c):
            on, around = [], []
            for i in range(-3, 4):
                for j in range(-3, 4):
                    near = max(abs(i), abs(j)) <= 1
                    (on if near else around).append(power[(row + i) % 32, (column + j) % 32])
            ratios.append(np.mean(on) / np.median(around))
        expected = 10 * np.log10(np.mean(ratios))
        assert line_excess_db(image, np.ones((2, 3), bool), period) == pytest.approx(expected, abs=1e-4)


def test_blur_contrast_and_level_are_no_checkerboard(make_frame):
    target = make_frame(0)
    blurred = gaussian_filter(target.image, 0.7)
    for harmless in (blurred, target.image // 2, shifted(target.image, target.mask, 20)):
        assert abs(nyquist_excess(harmless, target.image, target.mask)) < 1.5
    assert nyquist_excess(np.zeros_like(target.image), np.full_like(target.image, 255), target.mask) == 0


def test_noise_sd_recovers_a_known_spread():
    rng = np.random.default_rng(0)
    draws = np.clip(np.round(128 + 9 * rng.standard_normal((6, 80, 80))), 0, 255).astype(np.uint8)
    mask = np.zeros((80, 80), bool)
    mask[:40] = True
    assert noise_sd(draws, mask) == pytest.approx(np.sqrt(81 + 1 / 12), rel=0.02)
    assert noise_sd(np.stack([draws[0]] * 3), mask) == 0
    with pytest.raises(ValueError, match="k >= 2"):
        noise_sd(draws[:1], mask)
