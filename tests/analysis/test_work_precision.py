"""Orders and Pareto fronts, against what they were made from."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ablate.analysis import observed_order, pareto_front

N = np.array([1, 2, 4, 8, 16, 32, 64, 128])


@given(order=st.floats(-3, 3), factor=st.floats(1e-6, 1e6))
def test_the_order_of_a_power_law_is_found(order: float, factor: float) -> None:
    fit = observed_order(N, factor * N**-order)
    assert fit is not None
    assert fit[0] == pytest.approx(order, abs=1e-9)
    assert fit[1] == pytest.approx(0, abs=1e-6)


def test_the_standard_error_is_that_of_a_linear_fit() -> None:
    error = N**-0.5 * np.exp(np.random.default_rng(0).normal(0, 0.1, len(N)))
    fit = observed_order(N, error)
    slope, covariance = np.polyfit(np.log(N), np.log(error), 1, cov=True)
    assert fit is not None
    assert fit == pytest.approx((-slope[0], covariance[0, 0] ** 0.5))


def test_decibels_are_taken_as_the_error_that_they_stand_for() -> None:
    fit = observed_order(N, 20 * np.log10(255 / (30 * N**-0.5)), "psnr")
    assert fit is not None
    assert fit[0] == pytest.approx(0.5)


def test_no_order_without_two_errors() -> None:
    assert observed_order(N, np.zeros(len(N))) is None
    assert observed_order(np.array([4.0]), np.array([1.0])) is None
    assert observed_order(np.array([4.0, 4.0]), np.array([1.0, 2.0])) is None
    fit = observed_order(N, np.where(N > 2, np.inf, 1 / N))
    assert fit is not None
    assert fit[0] == pytest.approx(1)
    assert np.isnan(fit[1])


def test_pareto_front_against_brute_force() -> None:
    rng = np.random.default_rng(0)
    for n in (0, 1, 30):
        ms, error = rng.integers(1, 12, (2, n)).astype(float)
        points = set(zip(ms, error, strict=True))
        expected = {p for p in points if not any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)}
        front = pareto_front(ms, error)
        assert {(ms[k], error[k]) for k in front} == expected
        assert len(front) == len(expected)


def test_a_point_without_an_error_is_not_on_the_front() -> None:
    assert pareto_front(np.array([1.0, 2.0, 3.0]), np.array([np.nan, 5.0, 4.0])).tolist() == [1, 2]
    ms, unknown = np.array([10.0, 20.0, 30.0]), np.array([10.0, np.nan, 30.0])
    assert pareto_front(ms, np.array([1.0, 2.0, 3.0]), unknown, unknown).tolist() == [0]
