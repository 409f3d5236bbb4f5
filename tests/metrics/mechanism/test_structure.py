"""Smooth MAE against a convolution in float64, a closed form, and pictures with and without an error of structure."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from ablate.metrics import Pair, mae_smooth


def test_it_sees_structure_and_not_speckle(make_frame):
    target, again = make_frame(0), make_frame(1)
    offset = np.where(target.mask, np.minimum(target.image.astype(int) + 8, 255), 0).astype(np.uint8)
    assert mae_smooth(target.pair(target.image)) == 0
    pixel_error = np.abs(again.image.astype(float) - target.image)[target.mask].mean()
    assert mae_smooth(target.pair(again.image)) < 0.45 * pixel_error
    difference = (offset.astype(float) - target.image)[target.mask]
    assert mae_smooth(target.pair(offset)) == pytest.approx(difference.mean(), abs=0.05)


@pytest.mark.parametrize(
    ("pixel_mm", "sigma"),
    [(None, (4.0, 4.0)), ((0.5, 0.5), (3.0, 3.0)), ((1.0, 0.25), (1.5, 6.0)), ((9.0, 9.0), 1 / 6)],
)
def test_it_equals_a_normalised_convolution_in_double(make_frame, pixel_mm, sigma):
    a, b = make_frame(0, shape=(60, 80)), make_frame(1, shape=(60, 80))
    mask = a.mask
    smooth = [gaussian_filter(x.image * mask.astype(float), sigma, mode="constant", truncate=3.0) for x in (a, b)]
    weight = gaussian_filter(mask.astype(float), sigma, mode="constant", truncate=3.0)
    expected = np.abs((smooth[0] - smooth[1])[mask] / weight[mask]).mean()
    assert mae_smooth(b.pair(a.image, pixel_mm=pixel_mm)) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("pixel_mm", [(0.2, 0.2), (0.6, 0.6), (0.3, 0.7)])
@pytest.mark.parametrize("along", [0, 1])
def test_a_structure_weighs_the_same_at_any_resolution(pixel_mm, along):
    """Of stripes a sin(2 pi x / w) a Gaussian leaves exp(-2 (pi sigma / w)^2), and the mean of |sin| is 2 / pi."""
    shape = tuple(round(120 / size) for size in pixel_mm)
    x = (np.indices(shape)[along] + 0.5) * pixel_mm[along]
    target = np.round(128 + 100 * np.sin(2 * np.pi * x / 10.0)).astype(np.uint8)
    error = mae_smooth(Pair(np.full_like(target, 128), target, np.ones(shape, bool), pixel_mm=pixel_mm))
    assert error == pytest.approx(100 * 2 / np.pi * np.exp(-2 * (np.pi * 1.5 / 10.0) ** 2), rel=0.04)
