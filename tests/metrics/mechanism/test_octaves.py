"""Octave bands of texture, on pictures that are as rough as the target at some scales and not at others."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, zoom

from ablate.metrics import Pair, octave_sd
from ablate.metrics.texture import octave_variances


def test_bands_are_those_of_plain_loops():
    rng = np.random.default_rng(0)
    image, mask = rng.integers(0, 256, (40, 37)).astype(np.uint8), rng.random((40, 37)) < 0.8
    weights, expected = {-2: 1, -1: 4, 0: 6, 1: 4, 2: 1}, []
    values, inside = image.astype(float), mask
    while inside.sum() >= 100:
        average, band = np.zeros_like(values), []
        for i, j in np.ndindex(values.shape):
            total = weight = 0.0
            for a, wa in weights.items():
                for b, wb in weights.items():
                    if 0 <= i + a < values.shape[0] and 0 <= j + b < values.shape[1] and inside[i + a, j + b]:
                        total += wa * wb * values[i + a, j + b]
                        weight += wa * wb
            average[i, j] = total / weight if weight else 0.0
            if inside[i, j]:
                band.append(values[i, j] - average[i, j])
        expected.append(np.var(band))
        values, inside = average[::2, ::2], inside[::2, ::2]
    assert len(expected) == 2
    assert octave_variances(image, mask) == pytest.approx(expected, rel=1e-5)


def test_each_wave_has_its_octave():
    """Waves of 3, 6, 12 and 24 px have more power in bands 0, 1, 2 and 3 than in any other."""
    x = np.arange(256)
    for band, period in enumerate((3, 6, 12, 24)):
        wave = 128 + 80 * np.sin(2 * np.pi * x / period) * np.ones((256, 1))
        variances = octave_variances(wave, np.ones((256, 256), bool))
        assert np.argmax(variances) == band
        assert 0.15 * np.var(wave) < variances[band] < np.var(wave)


def test_smooth_and_coarse_speckle_counts_and_other_speckle_hardly(make_frame):
    target, again = make_frame(0), make_frame(1)
    error = [
        octave_sd(target.pair(image))
        for image in (target.image, again.image, *(gaussian_filter(again.image, sigma) for sigma in (1, 2, 4)))
    ]
    assert error[0] == 0
    assert error[1] < 0.5
    assert 2 < error[2] < error[3] < error[4]
    middle = (slice(80, 160), slice(130, 230))
    large, own = zoom(again.image[middle], 2, order=1)[:80, :100], target.image[middle]
    assert octave_sd(Pair(large, own, target.mask[middle], target.tissue[middle])) > 1.5, "speckle of twice the size"
    assert octave_sd(Pair(again.image[middle], own, target.mask[middle], target.tissue[middle])) < 1


def test_half_the_contrast_is_6_db_and_the_level_does_not_count():
    rng = np.random.default_rng(1)
    target = rng.normal(128, 24, (200, 200)).clip(0, 255).astype(np.uint8)
    maps = [np.ones(target.shape, bool)] * 2
    assert octave_sd(Pair((target // 2).astype(np.uint8), target, *maps)) == pytest.approx(20 * np.log10(2), abs=0.3)
    assert octave_sd(Pair(np.minimum(target, 200) + np.uint8(9), np.minimum(target, 200), *maps)) < 1e-4
    assert octave_sd(Pair(target, target, maps[0], ~maps[0])) is None
