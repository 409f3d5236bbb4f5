"""Spread and CRPS of draws, against closed forms, plain loops and the properties that define them."""

import numpy as np
import pytest
from scipy.stats import norm

from ablate.metrics import Pair, crps, mae, noise_sd

WHOLE = np.ones((120, 160), bool)


def drawn(seed, sd=20.0, mean=120.0, count=1):
    values = np.random.default_rng(seed).normal(mean, sd, (count, *WHOLE.shape))
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def pair_of(draws, target, mask=WHOLE):
    return Pair(draws[0], target, mask, mask, draws=draws)


def test_noise_sd_recovers_a_known_spread():
    rng = np.random.default_rng(0)
    draws = np.clip(np.round(128 + 9 * rng.standard_normal((6, 80, 80))), 0, 255).astype(np.uint8)
    mask = np.zeros((80, 80), bool)
    mask[:40] = True
    assert noise_sd(pair_of(draws, draws[0], mask)) == pytest.approx(np.sqrt(81 + 1 / 12), rel=0.02)
    assert noise_sd(pair_of(np.stack([draws[0]] * 3), draws[0], mask)) == 0
    for measure in (noise_sd, crps):
        assert measure(pair_of(draws, draws[0], mask & ~mask)) is None


@pytest.mark.parametrize("k", [2, 3, 5])
def test_crps_is_that_of_each_pixel_in_plain_loops(k):
    rng = np.random.default_rng(k)
    draws, target = rng.integers(0, 256, (k, 9, 7)).astype(np.uint8), rng.integers(0, 256, (9, 7)).astype(np.uint8)
    mask = rng.random((9, 7)) < 0.6
    values = []
    for i, j in zip(*np.nonzero(mask), strict=True):
        x, t = [int(v) for v in draws[:, i, j]], int(target[i, j])
        between = [abs(a - b) for m, a in enumerate(x) for n, b in enumerate(x) if m != n]
        values.append(abs(x[0] - t) - 0.5 * sum(between) / len(between))
    assert crps(pair_of(draws, target, mask)) == pytest.approx(np.mean(values), abs=1e-12)


def test_crps_of_a_normal_distribution_is_its_closed_form():
    """Gneiting and Raftery 2007, eq. 5, for a target t: sd (z (2 Phi(z) - 1) + 2 phi(z) - 1 / sqrt(pi))."""
    for sd, t in ((20.0, 120), (20.0, 150), (8.0, 100)):
        z = (t - 120) / sd
        expected = sd * (z * (2 * norm.cdf(z) - 1) + 2 * norm.pdf(z) - 1 / np.sqrt(np.pi))
        score = crps(pair_of(drawn(3, sd, count=3), np.full(WHOLE.shape, t, np.uint8)))
        assert score == pytest.approx(expected, rel=0.03)


def test_crps_is_smallest_for_the_distribution_of_the_target():
    """Proper: too little spread, too much, none, and another mean are all worse, and the floor is half of the MAE."""
    target = drawn(0)[0]
    right = crps(pair_of(drawn(1, count=3), target))
    assert right == pytest.approx(20 / np.sqrt(np.pi), rel=0.02)
    for sd, mean in ((10, 120), (40, 120), (1, 120), (20, 110), (20, 140)):
        assert crps(pair_of(drawn(1, sd, mean, count=3), target)) > 1.03 * right
    assert mae(drawn(1)[0], target) / 2 == pytest.approx(right, rel=0.02)


def test_crps_without_noise_is_the_mean_absolute_error_and_of_re_simulation_half_of_it():
    target, image = drawn(0)[0], drawn(1)[0]
    mask = WHOLE & (np.arange(160) < 50)
    error = mae(image, target, mask)
    assert crps(pair_of(np.stack([image] * 2), target, mask)) == pytest.approx(error, abs=1e-12)
    assert crps(pair_of(np.stack([image, target]), target, mask)) == pytest.approx(error / 2, abs=1e-12)
