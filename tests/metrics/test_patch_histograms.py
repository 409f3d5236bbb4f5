"""Patch chi-square against a loop of numpy.histogram, and its limits."""

import numpy as np
import pytest

from ablate.metrics import patch_chi2, patches_inside, rms
from ablate.metrics.patch_histograms import patch_counts


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
    found = patch_chi2(a, b, patch, bins)
    assert found.shape == (47 // patch, 66 // patch)
    np.testing.assert_allclose(found, chi2_by_loops(a, b, patch, bins), atol=1e-14)


def test_every_grey_level_falls_in_numpys_bin():
    levels = np.arange(256, dtype=np.uint8)[:, None]
    for bins in range(1, 257):
        expected = np.stack([np.histogram(v, np.linspace(0, 255, bins + 1))[0] for v in levels[::17]])
        np.testing.assert_array_equal(patch_counts(levels, 1, bins)[::17, 0], expected)


def test_limits():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (40, 60)).astype(np.uint8)
    black, white = np.zeros((40, 60), np.uint8), np.full((40, 60), 255, np.uint8)
    assert not patch_chi2(image, image).any()
    assert (patch_chi2(black, white) == 1).all()
    assert not patch_chi2(image, np.random.default_rng(1).permuted(image, axis=1), 60).size
    shuffled = image.copy()
    shuffled[:20, :20] = rng.permuted(shuffled[:20, :20].ravel()).reshape(20, 20)
    assert not patch_chi2(image, shuffled).any(), "only the histogram of a patch may matter"


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
    with pytest.raises(ValueError, match="as the map"):
        rms(chi2, inside[:1])


@pytest.mark.parametrize(("options", "message"), [({"patch": 0}, "patch"), ({"bins": 0}, "bins")])
def test_refuses_what_makes_no_sense(options, message):
    image = np.zeros((40, 40), np.uint8)
    with pytest.raises(ValueError, match=message):
        patch_chi2(image, image, **options)
