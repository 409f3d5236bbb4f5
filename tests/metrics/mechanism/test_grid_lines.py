"""The line excess of up-sampling, on pictures with and without a grid."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ablate.metrics import Pair, nyquist_excess
from ablate.metrics.texture import line_power


def checkered(frame, grey):
    pattern = np.where(np.indices(frame.image.shape).sum(axis=0) % 2, grey, -grey)
    return np.where(frame.mask, np.clip(frame.image.astype(int) + pattern, 0, 255), 0).astype(np.uint8)


def test_a_checkerboard_is_seen(make_frame):
    target, again = make_frame(0), make_frame(1)
    clean = nyquist_excess(target.pair(again.image))
    assert 0 <= clean < 0.5
    assert nyquist_excess(target.pair(checkered(again, 15))) > clean + 3
    assert nyquist_excess(target.pair(target.image)) == 0


@pytest.mark.parametrize("sigma", [0.7, 1.5, 3.0])
def test_a_smooth_picture_is_not_punished_and_its_grid_counts_as_much(make_frame, sigma):
    """Against its own faint surround the same grid would have many dB more in the smooth picture."""
    target, again = make_frame(0), make_frame(1)
    smooth = np.where(again.mask, gaussian_filter(again.image, sigma), 0).astype(np.uint8)
    assert nyquist_excess(target.pair(smooth)) < 0.5
    on_smooth = nyquist_excess(target.pair(checkered(replace(again, image=smooth), 6)))
    assert on_smooth == pytest.approx(nyquist_excess(target.pair(checkered(again, 6))), abs=1.5)


def test_contrast_and_level_are_no_checkerboard(make_frame):
    target = make_frame(0)
    brighter = np.where(target.mask, np.minimum(target.image.astype(int) + 20, 255), 0).astype(np.uint8)
    for harmless in (target.image // 2, brighter):
        assert nyquist_excess(target.pair(harmless)) < 0.5
    assert nyquist_excess(target.pair(target.image, mask=np.zeros_like(target.mask))) is None


def test_a_grid_of_the_target_that_is_missing_counts_too(make_frame):
    target, again = make_frame(0), make_frame(1)
    with_grid = checkered(target, 15)
    assert nyquist_excess(target.pair(again.image, target=with_grid)) > 3
    assert nyquist_excess(target.pair(checkered(again, 15), target=with_grid)) < 0.5


def test_it_is_that_of_whole_spectra_block_by_block():
    """Against numpy's full transform of each block, and a loop over the lines and their neighbours."""
    rng = np.random.default_rng(2)
    board = (-1) ** np.indices((64, 96)).sum(0)
    images = [np.clip(rng.normal(120, 20, (64, 96)) + a * board, 0, 255).astype(np.uint8) for a in (8, 2)]
    window = np.outer(np.hanning(32), np.hanning(32))
    spectra = []
    for image in images:
        blocks = [image[i : i + 32, j : j + 32].astype(float) for i in (0, 32) for j in (0, 32, 64)]
        power = np.mean([np.abs(np.fft.fft2((b - b.mean()) * window)) ** 2 for b in blocks], axis=0)
        spectra.append(power / np.square(window).sum() + 1 / 12)
    on, around = np.zeros((2, 3)), np.zeros((2, 3))
    for k, power in enumerate(spectra):
        for line, (row, column) in enumerate(((0, 16), (16, 0), (16, 16))):
            here = np.roll(power, (3 - row, 3 - column), axis=(0, 1))[:7, :7]
            on[k, line] = here[2:5, 2:5].mean()
            here[2:5, 2:5] = np.nan
            around[k, line] = np.nanmedian(here)
        np.testing.assert_allclose(line_power(images[k], np.ones((2, 3), bool)), (on[k], around[k]), rtol=1e-4)
    added = (np.maximum(on - around, 0) / around[1]).mean(axis=1)
    expected = abs(10 * np.log10((1 + added[0]) / (1 + added[1])))
    assert nyquist_excess(Pair(*images, np.ones((64, 96), bool))) == pytest.approx(expected, abs=1e-4)
