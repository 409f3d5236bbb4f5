"""What must hold of the metrics on any images and features."""

import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from ablate.metrics import (
    Pair,
    evaluate_image,
    frechet_distance,
    kernel_distance,
    mae_smooth,
    patch_chi2,
    rms,
    shadow_contrast,
)

PROPERTY = settings(max_examples=60, deadline=None, derandomize=True, database=None)
GREY = st.integers(0, 255)


@st.composite
def pairs(draw: st.DrawFn, least: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Two images of one size; few grey levels, so that ties and equal patches occur."""
    shape = draw(array_shapes(min_dims=2, max_dims=2, min_side=least, max_side=70))
    seed, levels = draw(st.integers(0, 2**32 - 1)), draw(st.integers(1, 256))
    random = np.random.default_rng(seed)
    a, b = (255 - random.integers(0, levels, (2, *shape))).astype(np.uint8)
    return a, b


@st.composite
def feature_sets(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    d = draw(st.integers(1, 6))
    numbers = st.floats(-1e3, 1e3, width=32)
    x, y = (draw(arrays(np.float64, (draw(st.integers(2, 8)), d), elements=numbers)) for _ in range(2))
    return x, y


@PROPERTY
@given(pairs())
def test_chi_square_has_a_range_and_is_symmetric(images: tuple[np.ndarray, np.ndarray]) -> None:
    a, b = images
    chi2 = patch_chi2(a, b)
    np.testing.assert_array_equal(chi2, patch_chi2(b, a))
    assert ((chi2 >= 0) & (chi2 <= 1)).all()
    assert not patch_chi2(a, a).any()


@PROPERTY
@given(pairs(least=20), st.integers(1, 256))
def test_chi_square_knows_histograms_only(images: tuple[np.ndarray, np.ndarray], bins: int) -> None:
    """Pixels of a patch may change places; grey levels turned upside down trade one bin for its mirror image."""
    a, b = (image[:20, :20] for image in images)
    chi2 = patch_chi2(a, b, bins=bins)
    np.testing.assert_allclose(patch_chi2(a, np.ascontiguousarray(b.T), bins=bins), chi2, atol=1e-15)
    if bins in (1, 51, 256):  # whose edges are no grey levels, or all of them
        np.testing.assert_allclose(patch_chi2(255 - a, 255 - b, bins=bins), chi2, atol=1e-15)
    assert rms(chi2) == chi2[0, 0]


@PROPERTY
@given(pairs(), st.integers(0, 2**32 - 1))
def test_every_score_is_a_number(images: tuple[np.ndarray, np.ndarray], seed: int) -> None:
    a, b = images
    random = np.random.default_rng(seed)
    mask, tissue = random.random((2, *a.shape)) < random.random()
    attenuation, depth = random.random(a.shape).astype(np.float32), 150 * random.random(a.shape)
    labels = random.integers(0, 4, a.shape).astype(np.uint8)
    pixel_mm = (random.uniform(0.05, 5), random.uniform(0.05, 5))
    scores = evaluate_image(
        Pair(a, b, mask, tissue, attenuation, depth, labels, labels == 3, pixel_mm, np.stack([a, b, a]))
    )
    assert not any(math.isnan(value) for value in scores.values())
    assert all(abs(value) < math.inf or name.startswith("psnr") for name, value in scores.items())


@PROPERTY
@given(GREY, GREY, st.integers(0, 2**32 - 1))
def test_a_uniform_error_is_what_it_is(a: int, b: int, seed: int) -> None:
    """A constant offset survives smoothing in a fan of any shape, and cancels in the contrast of shadows."""
    shape = (60, 50)
    random = np.random.default_rng(seed)
    mask = random.random(shape) < 0.7
    mask[0, 0] = True
    prediction, target = np.full(shape, a, np.uint8), np.full(shape, b, np.uint8)
    attenuation = np.where(np.arange(50) < 20, 0.1, 0.9).astype(np.float32) * np.ones(shape, np.float32)
    pair = Pair(prediction, target, mask, mask, attenuation, np.zeros(shape), np.ones(shape, np.uint8))
    assert abs(mae_smooth(pair) - abs(a - b)) <= 255 * 64 * 2**-24 / 0.01
    assert shadow_contrast(pair) in (None, 0.0)


@PROPERTY
@given(feature_sets())
def test_distances_are_symmetric_and_frechet_is_a_distance(sets: tuple[np.ndarray, np.ndarray]) -> None:
    x, y = sets
    size = max(np.square(x).sum(), np.square(y).sum(), 1.0)
    assert abs(frechet_distance(x, y) - frechet_distance(y, x)) <= 1e-12 * size
    assert frechet_distance(x, y) >= 0
    assert frechet_distance(x, x) <= 1e-12 * size
    kernels = max(np.abs(x @ x.T).max(), np.abs(y @ y.T).max(), 1.0) + 1
    assert abs(kernel_distance(x, y) - kernel_distance(y, x)) <= 1e-12 * kernels**3


@PROPERTY
@given(feature_sets(), st.integers(0, 2**32 - 1))
def test_distances_know_neither_order_nor_axes(sets: tuple[np.ndarray, np.ndarray], seed: int) -> None:
    """Rows in another order, features in a rotated frame, both shifted (Frechet), both scaled by two (Frechet)."""
    x, y = sets
    random = np.random.default_rng(seed)
    q, _ = np.linalg.qr(random.normal(size=(x.shape[1],) * 2))
    size = max(np.square(x).sum(), np.square(y).sum(), 1.0)
    kernels = (max(np.abs(x @ x.T).max(), np.abs(y @ y.T).max(), 1.0) + 1) ** 3
    changed = random.permutation(x) @ q, random.permutation(y) @ q
    assert abs(frechet_distance(*changed) - frechet_distance(x, y)) <= 1e-11 * size
    assert abs(kernel_distance(*changed) - kernel_distance(x, y)) <= 1e-11 * kernels
    shift = random.normal(size=x.shape[1])
    assert abs(frechet_distance(x + shift, y + shift) - frechet_distance(x, y)) <= 1e-11 * (size + 1)
    assert frechet_distance(2 * x, 2 * y) == 4 * frechet_distance(x, y)
