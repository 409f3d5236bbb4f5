"""What must hold of the statistics on any differences."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from ablate.analysis import PairedDifference, paired_difference
from ablate.analysis.statistics.component_claims import welch
from ablate.analysis.statistics.paired import LATTICE

PROPERTY = settings(max_examples=15, deadline=None, derandomize=True, database=None)
#: Whole numbers are often tied or zero; their sums and halves are exact.
WHOLE = st.integers(-50, 50).map(float)
ROUGH = st.floats(-1e3, 1e3, width=32).map(float)
SEEDS = st.lists(ROUGH, min_size=3, max_size=6)


@st.composite
def compared(draw: st.DrawFn, numbers: st.SearchStrategy[float] = WHOLE) -> tuple[np.ndarray, np.ndarray]:
    """Differences, and the site of each."""
    n = draw(st.integers(1, 40))
    values = draw(st.lists(numbers, min_size=n, max_size=n))
    sites = draw(st.lists(st.integers(0, 7), min_size=n, max_size=n))
    return np.array(values), np.array(sites)


ANY = st.one_of(compared(), compared(ROUGH))


def difference(values: np.ndarray, sites: np.ndarray) -> PairedDifference:
    return paired_difference(values, np.zeros(len(values)), sites, resamples=50)


@PROPERTY
@given(ANY)
def test_figures_are_in_range_and_the_interval_holds_the_estimate(data: tuple[np.ndarray, np.ndarray]) -> None:
    values, sites = data
    figures = difference(values, sites)
    assert figures.lower <= figures.shift <= figures.upper
    assert values.min() <= figures.shift <= values.max()
    assert 0 <= figures.p <= 1
    assert -1 <= figures.effect <= 1
    assert figures.clusters == len(set(sites.tolist()))


@PROPERTY
@given(compared(), st.integers(-1000, 1000))
def test_a_shift_of_all_frames_shifts_the_figures(data: tuple[np.ndarray, np.ndarray], by: int) -> None:
    values, sites = data
    here, there = difference(values, sites), difference(values + by, sites)
    assert there.shift == here.shift + by
    np.testing.assert_allclose([there.lower, there.upper], [here.lower + by, here.upper + by], rtol=0, atol=1e-9)


@PROPERTY
@given(ANY, st.sampled_from([2.0**-900, 0.5, 4.0, 2.0**300]), st.sampled_from([1, -1]))
def test_another_unit_scales_the_figures(data: tuple[np.ndarray, np.ndarray], unit: float, sign: int) -> None:
    """Up to a point of the bootstrap's lattice where the sign turns: it rounds halves to even."""
    values, sites = data
    here, there = difference(values, sites), difference(sign * unit * values, sites)
    assert there.shift == sign * unit * here.shift
    assert there.p == pytest.approx(here.p, abs=1e-12)
    assert there.effect == pytest.approx(sign * here.effect, abs=1e-12)
    ends = sorted((sign * unit * here.lower, sign * unit * here.upper))
    apart = 0 if sign == 1 else 2 * unit * np.ptp(values) / (LATTICE - 2)
    np.testing.assert_allclose([there.lower, there.upper], ends, rtol=1e-12, atol=apart)


@PROPERTY
@given(compared(), st.randoms(use_true_random=False))
def test_frames_have_no_order(data: tuple[np.ndarray, np.ndarray], random: np.random.Generator) -> None:
    values, sites = data
    order = list(range(len(values)))
    random.shuffle(order)
    here, there = difference(values, sites), difference(values[order], sites[order])
    for name in ("shift", "lower", "upper", "p", "effect", "n", "clusters"):
        assert getattr(there, name) == pytest.approx(getattr(here, name), abs=1e-12)


@PROPERTY
@given(SEEDS, SEEDS, st.sampled_from([2.0**-60, 2.0**60]))
def test_claims_scale_and_turn_round(a: list[float], b: list[float], unit: float) -> None:
    assume(max(np.ptp(a), np.ptp(b)) > 0)
    first, second = np.array(a), np.array(b)
    here, back, there = welch(first, second), welch(second, first), welch(unit * first, unit * second)
    assert (there[3], back[3]) == pytest.approx((here[3], here[3]), rel=1e-9, abs=1e-300)
    shift, lower, upper, _ = here
    assert lower <= shift <= upper
    np.testing.assert_allclose(there[:3], [unit * v for v in here[:3]], rtol=1e-9)
    np.testing.assert_allclose(back[:3], [-shift, -upper, -lower], rtol=1e-9, atol=1e-9)
