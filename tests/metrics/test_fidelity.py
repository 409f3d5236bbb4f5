"""PSNR and MAE against scikit-image, closed forms and the degenerate cases."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.metrics import peak_signal_noise_ratio

from ablate.metrics import mae, psnr

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)


@settings(deadline=None)
@given(shape=SHAPES, data=st.data())
def test_psnr_and_mae_agree_with_others_and_are_symmetric(shape, data):
    a, b = (data.draw(hnp.arrays(np.uint8, shape)) for _ in range(2))
    if np.array_equal(a, b):
        assert psnr(a, b) == math.inf
        assert mae(a, b) == 0.0
    else:
        assert psnr(a, b) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=255), abs=1e-9)
        assert psnr(a, b) == psnr(b, a)
        # RMSE >= MAE bounds the PSNR: the argument that the paper's printed formula is a misprint.
        assert psnr(a, b) <= 20 * math.log10(255 / mae(a, b)) + 1e-9
    assert mae(a, b) == pytest.approx(np.abs(a.astype(float) - b).mean())


def test_zeros_outside_the_fan_raise_psnr_by_its_share():
    rng = np.random.default_rng(0)
    mask = np.zeros((40, 40), bool)
    mask[:20] = True
    a, b = (rng.integers(0, 256, (40, 40)).astype(np.uint8) * mask for _ in range(2))
    assert psnr(a, b) - psnr(a, b, mask) == pytest.approx(10 * math.log10(2), abs=1e-9)
    assert mae(a, b, mask) == pytest.approx(2 * mae(a, b))
    assert psnr(a, b, ~mask) == math.inf


def test_in_the_fan_both_are_those_of_its_pixels_alone(make_frame):
    a, b = make_frame(0), make_frame(1)
    found = psnr(a.image, b.image, a.mask)
    assert found == pytest.approx(peak_signal_noise_ratio(a.image[a.mask], b.image[a.mask], data_range=255), abs=1e-9)
    difference = a.image[a.mask].astype(float) - b.image[a.mask]
    assert mae(a.image, b.image, a.mask) == pytest.approx(np.abs(difference).mean(), rel=1e-12)


@pytest.mark.parametrize("metric", [psnr, mae])
@pytest.mark.parametrize(
    ("a", "b", "mask", "message"),
    [
        (np.zeros((2, 3), np.uint8), np.zeros((3, 2), np.uint8), None, "one shape"),
        (np.zeros((2, 3)), np.zeros((2, 3), np.uint8), None, "uint8"),
        (np.zeros((1, 2, 3), np.uint8), np.zeros((1, 2, 3), np.uint8), None, "uint8"),
        (np.zeros((0, 3), np.uint8), np.zeros((0, 3), np.uint8), None, "no pixel"),
        (np.zeros((2, 3), np.uint8), np.zeros((2, 3), np.uint8), np.zeros((2, 3), bool), "no pixel"),
        (np.zeros((2, 3), np.uint8), np.zeros((2, 3), np.uint8), np.ones((2, 3), np.uint8), "bool"),
    ],
)
def test_what_cannot_be_compared_is_refused(metric, a, b, mask, message):
    with pytest.raises(ValueError, match=message):
        metric(a, b, mask)
