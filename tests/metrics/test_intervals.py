"""Intervals: a resample is what it says, they cover what they should, and sites widen them."""

import numpy as np
import pytest

from ablate.metrics import bootstrap_interval, frechet_distance, kernel_distance
from ablate.metrics.distances import _frechet_of_draw, kernel_of_draw


@pytest.mark.parametrize(("d", "rows"), [(3, 300), (6, 20), (30, 10)])
def test_a_resample_by_group_is_the_distance_of_the_rows_drawn(d, rows):
    """Against the distances of the rows themselves, for groups of many rows and of few, and for more features."""
    rng = np.random.default_rng(d)
    owner = np.sort(np.arange(rows) % 5)
    x, y = rng.standard_normal((rows, d)) + 5, rng.gamma(2.0, size=(rows, d))
    times = np.array([2, 0, 1, 3, 0])
    drawn = np.concatenate([np.flatnonzero(owner == k) for k in range(5) for _ in range(times[k])])
    found = _frechet_of_draw(x, y, owner, owner)(times, times)
    assert found == pytest.approx(frechet_distance(x[drawn], y[drawn]), rel=1e-6)
    found = kernel_of_draw(x, y, owner, owner)(times, times)
    assert found == pytest.approx(kernel_distance(x[drawn], y[drawn]), rel=1e-9)


def test_interval_covers_the_value_expected_at_this_size():
    """At fixed n the estimator has an expectation; about 90 % of intervals should hold it."""
    d, n, runs = 4, 60, 60
    draws = [np.random.default_rng(k).standard_normal((2, n, d)) * [[[1.0]], [[1.5]]] for k in range(400)]
    expected = np.mean([frechet_distance(x, y) for x, y in draws])
    hits = 0
    for x, y in draws[:runs]:
        lower, upper = bootstrap_interval(frechet_distance, x, y, level=0.9, resamples=100)
        assert lower < upper
        hits += lower <= expected <= upper
    assert hits / runs > 0.78


def test_interval_by_groups_is_wider_when_rows_of_a_group_are_alike():
    rng = np.random.default_rng(9)
    groups = np.repeat(np.arange(10), 8)
    x = (rng.standard_normal((10, 3)))[groups] + 0.1 * rng.standard_normal((80, 3))
    y = 1.0 + rng.standard_normal((10, 3))[groups] + 0.1 * rng.standard_normal((80, 3))
    free = bootstrap_interval(frechet_distance, x, y)
    grouped = bootstrap_interval(frechet_distance, x, y, groups=groups)
    assert grouped == bootstrap_interval(frechet_distance, x, y, groups=groups), "same seed, same interval"
    assert np.ptp(grouped) > 1.5 * np.ptp(free)
    with pytest.raises(ValueError, match="at least 2 groups"):
        bootstrap_interval(frechet_distance, x, y, groups=np.zeros(80))
    with pytest.raises(ValueError, match="one label a row"):
        bootstrap_interval(frechet_distance, x, y, groups=groups[:-1])
    with pytest.raises(ValueError, match="no bootstrap of"):
        bootstrap_interval(max, x, y)
