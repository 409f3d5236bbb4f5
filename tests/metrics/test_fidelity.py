"""PSNR and MAE against scikit-image, patch chi-square against a loop of numpy.histogram; their limits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from skimage.metrics import peak_signal_noise_ratio

from ablate.metrics import mae, patch_chi2, patches_inside, psnr, rms
from ablate.metrics.patches import patch_counts

SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=9)


@settings(deadline=None)
@given(shape=SHAPES, data=st.data())
def test_psnr_and_mae_agree_with_others_and_are_symmetric(shape, data):
    a, b = (data.draw(hnp.arrays(np.uint8, shape)) for _ in range(2))
    mask = data.draw(hnp.arrays(np.bool_, shape).filter(np.any))
    if np.array_equal(a, b):
        assert psnr(a, b) == math.inf
        assert mae(a, b) == 0.0
    else:
        assert psnr(a, b) == pytest.approx(peak_signal_noise_ratio(a, b, data_range=255), abs=1e-9)
        assert psnr(a, b) == psnr(b, a)
        # RMSE >= MAE bounds the PSNR: the argument that the paper's printed formula is a misprint.
        assert psnr(a, b) <= 20 * math.log10(255 / mae(a, b)) + 1e-9
    assert mae(a, b) == pytest.approx(np.abs(a.astype(float) - b).mean())
    for metric in (psnr, mae):
        assert metric(a, b, mask) == metric(a[mask][None], b[mask][None])


def test_zeros_outside_the_fan_raise_psnr_by_its_share():
    rng = np.random.default_rng(0)
    mask = np.zeros((40, 40), bool)
    mask[:20] = True
    a, b = (rng.integers(0, 256, (40, 40)).astype(np.uint8) * mask for _ in range(2))
    assert psnr(a, b) - psnr(a, b, mask) == pytest.approx(10 * math.log10(2), abs=1e-9)
    assert mae(a, b, mask) == pytest.approx(2 * mae(a, b))
    assert psnr(a, b, ~mask) == math.inf


IMAGE = np.zeros((2, 3), np.uint8)


@pytest.mark.parametrize("metric", [psnr, mae])
@pytest.mark.parametrize(
    ("a", "b", "mask", "message"),
    [
        (IMAGE, IMAGE.T, None, "one shape"),
        (IMAGE.astype(float), IMAGE, None, "uint8"),
        (IMAGE[None], IMAGE[None], None, "uint8"),
        (IMAGE[:0], IMAGE[:0], None, "no pixel"),
        (IMAGE, IMAGE, IMAGE > 0, "no pixel"),
        (IMAGE, IMAGE, IMAGE, "bool"),
    ],
)
def test_what_cannot_be_compared_is_refused(metric, a, b, mask, message):
    with pytest.raises(ValueError, match=message):
        metric(a, b, mask)


def chi2_by_loops(a, b, patch, bins):
    edges = np.linspace(0, 255, bins + 1)
    rows, columns = a.shape[0] // patch, a.shape[1] // patch
    result = np.zeros((rows, columns))
    for i in range(rows):
        for j in range(columns):
            window = (slice(i * patch, (i + 1) * patch), slice(j * patch, (j + 1) * patch))
            h, k = (np.histogram(x[window], edges)[0] / patch**2 for x in (a, b))
            for p, q in zip(h, k, strict=True):
                result[i, j] += 0.5 * (p - q) ** 2 / (p + q) if p + q > 0 else 0.0
    return result


@pytest.mark.parametrize(("patch", "bins"), [(20, 50), (7, 50), (20, 256), (5, 1), (1, 13)])
def test_equals_a_loop_over_numpy_histogram(patch, bins):
    rng = np.random.default_rng(patch)
    a, b = rng.integers(0, 256, (2, 47, 66)).astype(np.uint8)
    chi2 = patch_chi2(a, b, patch, bins)
    assert chi2.shape == (47 // patch, 66 // patch)
    np.testing.assert_allclose(chi2, chi2_by_loops(a, b, patch, bins), atol=1e-14)


def test_every_grey_level_falls_in_numpys_bin():
    levels = np.arange(256, dtype=np.uint8)[:, None]
    for bins in range(1, 257):
        expected = np.stack([np.histogram(v, np.linspace(0, 255, bins + 1))[0] for v in levels[::17]])
        np.testing.assert_array_equal(patch_counts(levels, 1, bins)[::17, 0], expected)


def test_floor_of_two_draws_of_one_distribution():
    """Two independent samples do not score 0: K / (2 n) for K equally filled bins and n pixels a patch."""
    rng = np.random.default_rng(3)
    levels = (np.arange(50) * 5.1 + 2.5).astype(np.uint8)
    a, b = rng.choice(levels, (2, 400, 400))
    assert patch_chi2(a, b).mean() == pytest.approx(50 / (2 * 400), rel=0.05)


def test_masks_and_the_figure():
    mask = np.zeros((45, 65), bool)
    mask[:40, 19:] = True
    inside = patches_inside(mask)
    np.testing.assert_array_equal(inside, [[False, True, True]] * 2)
    chi2 = np.array([[1.0, 0.3, 0.4], [1.0, 0.0, 0.0]])
    assert rms(chi2, inside) == pytest.approx(0.25)
    assert rms(chi2) == pytest.approx(np.sqrt(2.25 / 6))
    assert rms(chi2, np.zeros_like(inside)) is None


@pytest.mark.parametrize("metric", [psnr, mae])
def test_a_masked_array_is_refused_because_its_masked_pixels_would_count(metric) -> None:
    image = np.zeros((8, 8), np.uint8)
    with pytest.raises(ValueError, match=r"b must be \(H, W\) uint8, got \(8, 8\) MaskedArray uint8"):
        metric(image, np.ma.masked_array(image, image == 0))
