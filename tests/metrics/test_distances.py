"""Frechet and kernel distance against closed forms and torchmetrics; their intervals hold what they should.

Few, equal and very large or small features are cases of `ablate.numerics.stability`, with SciPy's eigenvalues beside.
"""

import numpy as np
import pytest
import torch
from torchmetrics.image.fid import FrechetInceptionDistance
from torchmetrics.image.kid import KernelInceptionDistance

from ablate.metrics import bootstrap_interval, frechet_distance, kernel_distance
from ablate.metrics.distances import frechet_of_draw, kernel_of_draw


class Identity(torch.nn.Module):
    """Passes feature matrices through torchmetrics, which then supplies an independent formula."""

    def __init__(self, d):
        super().__init__()
        self.num_features = d

    def forward(self, x):
        return x.flatten(1)


def with_moments(mean, covariance, n, rng):
    """A sample whose mean and covariance are exactly these."""
    d = len(mean)
    x = rng.standard_normal((n, d))
    x -= x.mean(axis=0)
    x = x @ np.linalg.inv(np.linalg.cholesky(np.cov(x.T))).T
    return x @ np.linalg.cholesky(covariance).T + mean


@pytest.mark.parametrize("offset", [0.0, 1e4])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_closed_form_of_commuting_gaussians(offset, scale):
    rng = np.random.default_rng(0)
    sd_x, sd_y = np.array([1.0, 2.0, 0.5]), np.array([1.5, 0.1, 0.5])
    shift = np.array([0.3, 0.0, -1.0])
    x = with_moments(np.zeros(3), np.diag(sd_x**2), 50, rng) * scale + offset
    y = with_moments(shift, np.diag(sd_y**2), 70, rng) * scale + offset
    expected = scale**2 * (np.sum(shift**2) + np.sum((sd_x - sd_y) ** 2))
    assert frechet_distance(x, y) == pytest.approx(expected, rel=1e-7 if offset == 0 else 1e-4)


@pytest.mark.filterwarnings("ignore:Metric `Kernel Inception Distance` will save")
def test_both_agree_with_torchmetrics():
    rng = np.random.default_rng(1)
    x, y = rng.standard_normal((64, 12)), rng.gamma(2.0, size=(64, 12))
    fid = FrechetInceptionDistance(Identity(12), normalize=True, input_img_size=(12, 1, 1))
    fid.used_custom_model = True
    kid = KernelInceptionDistance(Identity(12), subsets=1, subset_size=64, normalize=True)
    for metric in (fid, kid):
        metric.set_dtype(torch.float64)
        metric.update(torch.from_numpy(x)[:, :, None, None], real=True)
        metric.update(torch.from_numpy(y)[:, :, None, None], real=False)
    assert frechet_distance(x, y) == pytest.approx(float(fid.compute()), rel=1e-5)
    assert kernel_distance(x, y) == pytest.approx(float(kid.compute()[0]), rel=1e-5)


def test_kernel_distance_is_unbiased_where_frechet_is_not():
    rng = np.random.default_rng(7)
    pairs = [rng.standard_normal((2, 30, 16)) for _ in range(60)]
    kernel = np.array([kernel_distance(x, y) for x, y in pairs])
    frechet = np.array([frechet_distance(x, y) for x, y in pairs])
    assert abs(kernel.mean()) < 3 * kernel.std() / np.sqrt(len(pairs))
    assert frechet.mean() > 20 * frechet.std() / np.sqrt(len(pairs))


@pytest.mark.parametrize("distance", [frechet_distance, kernel_distance])
@pytest.mark.parametrize(
    ("x", "message"),
    [
        (np.ones((1, 3)), "at least 2"),
        (np.ones((0, 3)), "at least 2"),
        (np.ones(3), r"\(n, d\)"),
        (np.ones((4, 2)), "one feature dimension"),
        (np.full((4, 3), np.nan), "not finite"),
        (np.full((4, 2), 1e60), "beyond 1e"),
    ],
)
def test_bad_features_are_refused(distance, x, message):
    with pytest.raises(ValueError, match=message):
        distance(x, np.ones((4, 3)))


def test_kernel_distance_of_many_rows_is_that_of_all_pairs():
    rng = np.random.default_rng(8)
    x, y = rng.standard_normal((700, 3)), rng.gamma(2.0, size=(500, 3))

    def kernel(a, b):
        return (a @ b.T / 3 + 1) ** 3

    def within(a):
        k = kernel(a, a)
        return (k.sum() - np.trace(k)) / (len(a) * (len(a) - 1))

    expected = within(x) + within(y) - 2 * kernel(x, y).mean()
    assert kernel_distance(x, y) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(("d", "rows"), [(3, 300), (6, 20), (30, 10)])
def test_a_resample_by_group_is_the_distance_of_the_rows_drawn(d, rows):
    """Against the distances of the rows themselves, for groups of many rows and of few, and for more features."""
    rng = np.random.default_rng(d)
    owner = np.sort(np.arange(rows) % 5)
    x, y = rng.standard_normal((rows, d)) + 5, rng.gamma(2.0, size=(rows, d))
    times = np.array([2, 0, 1, 3, 0])
    drawn = np.concatenate([np.flatnonzero(owner == k) for k in range(5) for _ in range(times[k])])
    resampled = frechet_of_draw(x, y, owner)(times)
    assert resampled == pytest.approx(frechet_distance(x[drawn], y[drawn]), rel=1e-6)
    resampled = kernel_of_draw(x, y, owner, owner)(times)
    assert resampled == pytest.approx(kernel_distance(x[drawn], y[drawn]), rel=1e-9)


def test_interval_covers_the_value_expected_at_this_size():
    """At fixed n the estimator has an expectation; about 95 % of intervals should hold it."""
    d, n, runs = 4, 60, 40
    draws = [np.random.default_rng(k).standard_normal((2, n, d)) * [[[1.0]], [[1.5]]] for k in range(200)]
    expected = np.mean([frechet_distance(x, y) for x, y in draws])
    hits = 0
    for x, y in draws[:runs]:
        lower, upper = bootstrap_interval(frechet_distance, x, y, np.arange(n), resamples=100)
        assert lower < upper
        hits += lower <= expected <= upper
    assert hits / runs > 0.85


def test_interval_by_groups_is_wider_when_rows_of_a_group_are_alike():
    rng = np.random.default_rng(9)
    groups = np.repeat(np.arange(10), 8)
    x = (rng.standard_normal((10, 3)))[groups] + 0.1 * rng.standard_normal((80, 3))
    y = 1.0 + rng.standard_normal((10, 3))[groups] + 0.1 * rng.standard_normal((80, 3))
    free = bootstrap_interval(frechet_distance, x, y, np.arange(80))
    grouped = bootstrap_interval(frechet_distance, x, y, groups)
    assert grouped == bootstrap_interval(frechet_distance, x, y, groups), "same seed, same interval"
    assert np.ptp(grouped) > 1.5 * np.ptp(free)
    assert bootstrap_interval(frechet_distance, x, y, np.zeros(80, int)) == (-np.inf, np.inf), "one group tells none"


@pytest.mark.parametrize("distance", [frechet_distance, kernel_distance])
def test_the_interval_of_a_distance_of_ones_own_is_that_of_its_own_resamples(distance):
    rng = np.random.default_rng(0)
    x, y, groups = rng.normal(size=(60, 3)), rng.gamma(2.0, size=(60, 3)), np.arange(60) // 5
    known = bootstrap_interval(distance, x, y, groups)
    assert bootstrap_interval(lambda a, b: distance(a, b), x, y, groups) == pytest.approx(known, rel=1e-5)
    doubled = bootstrap_interval(lambda a, b: 2 * distance(a, b), x, y, groups)
    assert doubled == pytest.approx(2 * np.array(known), rel=1e-5)
