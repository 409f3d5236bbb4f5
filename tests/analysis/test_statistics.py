"""Paired statistics against scipy, brute force, and their own promises under simulation."""

import itertools
import math

import numpy as np
import pytest
from scipy import stats

from ablate.analysis import holm, paired_difference
from ablate.analysis.statistics.component_claims import welch
from ablate.analysis.statistics.paired import LATTICE, _bootstrap_shifts


def brute_hodges_lehmann(d):
    return np.median([(d[i] + d[j]) / 2 for i in range(len(d)) for j in range(i, len(d))])


@pytest.mark.parametrize("n", [1, 2, 7, 30])
def test_shift_p_and_effect_agree_with_independent_formulas(n):
    rng = np.random.default_rng(n)
    value, base = rng.normal(0.4, 1, n), rng.normal(size=n)
    result = paired_difference(value, base)
    d = value - base
    assert result.shift == pytest.approx(brute_hodges_lehmann(d))
    assert result.p == pytest.approx(stats.wilcoxon(value, base).pvalue)
    ranks = stats.rankdata(np.abs(d))
    assert result.effect == pytest.approx((ranks[d > 0].sum() - ranks[d < 0].sum()) / ranks.sum())
    assert result.n == n
    swapped = paired_difference(base, value)
    assert (swapped.shift, swapped.effect) == pytest.approx((-result.shift, -result.effect))


@pytest.mark.parametrize("far", [0, 3])  # frames of the first cluster that are far from all others, or a cluster is
def test_bootstrap_on_the_lattice_equals_brute_force(far):
    rng = np.random.default_rng(0)
    d, clusters = rng.normal(size=24), np.repeat(np.arange(8), 3)
    d[:far] += 300.0
    fast = _bootstrap_shifts(d, clusters, 300, np.random.default_rng(5))
    draws = np.random.default_rng(5).multinomial(8, np.full(8, 1 / 8), size=256)
    draws = np.vstack((draws, np.random.default_rng(5).multinomial(8, np.full(8, 1 / 8), size=300)[256:]))
    slow = [brute_hodges_lehmann(np.repeat(d, np.repeat(weights, 3))) for weights in draws]
    np.testing.assert_allclose(fast, slow, atol=min(np.ptp(d) / (LATTICE - 1), 0.05))
    assert far == 0 or max(slow) > 50, "a resample has it often enough to move the median"


def test_sites_are_judged_by_one_mean_each_and_by_expanded_percentiles():
    rng = np.random.default_rng(3)
    sites = np.repeat(np.arange(9), [1, 2, 3, 4, 5, 4, 3, 2, 1])
    d = 0.3 + rng.normal(size=9)[sites] + 0.2 * rng.normal(size=25)
    result = paired_difference(d, np.zeros(25), sites)
    assert result.p_sites == pytest.approx(stats.wilcoxon([d[sites == k].mean() for k in range(9)]).pvalue)
    assert result.p == pytest.approx(stats.wilcoxon(d).pvalue)
    shifts = _bootstrap_shifts(d, sites, 2000, np.random.default_rng(0))
    tail = stats.norm.cdf(stats.t.ppf(0.025, 8) * np.sqrt(9 / 8))
    assert (result.lower, result.upper) == pytest.approx(tuple(np.quantile(shifts, [tail, 1 - tail])))
    assert tail < 0.025
    alone = paired_difference(d, np.zeros(25))
    assert alone.p_sites == alone.p, "without sites every frame is its own"


@pytest.mark.parametrize("value", [0.0, 2.0, -1e-12, 1e12])
def test_a_constant_difference_is_its_own_interval(value):
    result = paired_difference(np.full(12, value), np.zeros(12), np.arange(12) // 2)
    assert (result.shift, result.lower, result.upper, result.effect) == (value, value, value, np.sign(value))
    assert (result.p, result.p_sites) == (1, 1) if value == 0 else (result.p < 0.01, result.p_sites > 0.01)


def test_many_ties_do_not_move_the_interval_off_the_estimate():
    result = paired_difference(np.array([0.0] * 60 + [-1.0, np.pi]), np.zeros(62))
    assert (result.shift, result.lower, result.upper) == (0, 0, 0), "every resample has the same median"
    for d in (np.array([1.0] * 1000 + [0.0, np.pi]), np.repeat([0.0, 1.0], 15), np.array([0.0] * 99 + [1.0])):
        result = paired_difference(d, np.zeros(len(d)))
        assert result.lower <= result.shift <= result.upper


def test_an_outlier_does_not_narrow_the_interval():
    sites = np.repeat(np.arange(16), 3)
    d = np.random.default_rng(1).normal(0.0, 0.05, size=48)
    plain = paired_difference(d, np.zeros(48), sites)
    for far in (60.0, -60.0, 1e6):
        with_one = paired_difference(np.append(d, far), np.zeros(49), np.append(sites, 7))
        wide = plain.upper - plain.lower
        assert (with_one.lower, with_one.upper) == pytest.approx((plain.lower, plain.upper), abs=0.2 * wide)
        assert with_one.shift == pytest.approx(brute_hodges_lehmann(np.append(d, far)))


def test_infinite_pairs_are_dropped_and_one_cluster_has_no_interval():
    result = paired_difference([1.0, math.inf, 3.0, 4.0], [0.0, 1.0, math.inf, 3.5], clusters=["a"] * 4)
    assert (result.n, result.dropped, result.shift) == (2, 2, 0.75)
    assert (result.lower, result.upper, result.clusters) == (-math.inf, math.inf, 1)


@pytest.mark.parametrize(
    ("value", "base", "clusters", "message"),
    [
        ([1.0, 2.0], [1.0], None, "alike"),
        ([1.0, 2.0], [1.0, 2.0], [0], "alike"),
        ([1.0, math.nan], [1.0, 2.0], None, "NaN"),
        ([math.inf], [1.0], None, "no pair"),
        ([], [], None, "no pair"),
    ],
)
def test_what_cannot_be_compared_is_refused(value, base, clusters, message):
    with pytest.raises(ValueError, match=message):
        paired_difference(value, base, clusters)


def test_holm_by_hand():
    np.testing.assert_allclose(holm([0.01, 0.04, 0.03, 0.005]), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm([0.6, 0.5]), [1.0, 1.0])
    assert holm([]).size == 0
    for wrong in (1.2, -1e-300, math.nan):
        with pytest.raises(ValueError, match=r"\[0, 1\]"):
            holm([wrong])


def test_holm_is_closed_testing_with_bonferroni():
    p = np.random.default_rng(1).random(6) ** 2
    subsets = [list(s) for size in range(1, 7) for s in itertools.combinations(range(6), size)]
    closed = [max(min(1.0, len(s) * p[s].min()) for s in subsets if i in s) for i in range(6)]
    np.testing.assert_allclose(holm(p), closed)


def test_welchs_interval_is_scipys():
    a, b = np.array([1.0, 1.1, 1.2, 0.9]), np.array([2.0, 2.2, 2.1, 1.7])
    shift, *ends, p = welch(a, b)
    interval = stats.ttest_ind(a, b, equal_var=False).confidence_interval(0.95)
    assert ends == pytest.approx((interval.low, interval.high))
    assert p == pytest.approx(stats.ttest_ind(a, b, equal_var=False).pvalue)
    assert ends[0] < shift < ends[1] < 0
    constant = welch(np.zeros(3), np.array([1.0, 1.1, 1.3]))
    assert constant[3] == pytest.approx(stats.ttest_1samp([1.0, 1.1, 1.3], 0.0).pvalue), "one side has no spread"


@pytest.mark.parametrize(
    ("a", "b"),
    [
        ([1.0, 1.0, 1 + 2e-16], [1.0, 1 + 2e-16, 1.0]),
        ([1e8, 1e8 + 1e-7, 1e8], [1e8, 1e8, 1e8 + 1e-7]),
        ([1e-150, 2e-150, 3e-150], [1e-150, 5e-150, 2e-150]),
        ([1e90, 2e90, 3e90], [1e90, 5e90, 2e90]),
    ],
)
def test_seeds_that_hardly_vary_claim_nothing(a, b):
    figures = welch(np.array(a), np.array(b))
    assert np.isfinite(figures).all()
    assert figures[3] > 0.05


def test_rounding_is_no_difference():
    """Equal scores of metrics with few levels, averaged over two seeds and over seven."""
    scores = np.random.default_rng(0).integers(1, 20, 60) / 19
    two, many = (np.cumsum(np.full((seeds, 60), scores), axis=0)[-1] / seeds for seeds in (2, 7))
    assert np.count_nonzero(two != many) > 5
    result = paired_difference(many, two, np.arange(60) // 6)
    assert (result.p, result.p_sites, result.effect, result.shift) == (1.0, 1.0, 0.0, 0.0)


@pytest.mark.parametrize("kind", [float, np.float32])
@pytest.mark.parametrize("unit", [0.1, 0.01, 1 / 3, 1e-9, 7e5])
def test_the_unit_of_a_metric_with_few_levels_does_not_move_its_interval(unit, kind):
    """Levels that are no binary fractions tie up to rounding; whole numbers tie exactly."""
    sites = np.repeat(np.arange(16), 3)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        base = rng.integers(0, 7, 48)
        value = np.clip(base + np.where(rng.random(48) < 0.6, 1, rng.integers(-2, 4, 48)), 0, 10)
        whole = paired_difference(value, base, sites, resamples=500)
        scaled = paired_difference((value * unit).astype(kind), (base * unit).astype(kind), sites, resamples=500)
        ends = np.array([scaled.lower, scaled.upper, scaled.shift]) / unit
        np.testing.assert_allclose(ends, [whole.lower, whole.upper, whole.shift], atol=0.02)
        if kind is float:
            assert (scaled.p, scaled.p_sites, scaled.effect) == pytest.approx((whole.p, whole.p_sites, whole.effect))


@pytest.mark.parametrize("differing", [1, 5, 10])
@pytest.mark.parametrize("sites", [10, 14, 20, 48])
def test_p_of_few_differing_sites_is_that_of_all_signs(sites, differing):
    """Whatever the sites that do not differ, and whether sizes are tied or not."""
    for sizes in (np.arange(1.0, differing + 1), np.arange(1.0, differing + 1) // 3 + 1):
        signs = np.where(np.arange(differing) == 1, -1, 1)
        ranks = stats.rankdata(sizes)
        sums = [ranks[np.array(up, bool)].sum() for up in itertools.product((0, 1), repeat=differing)]
        sums, seen = np.array(sums), ranks[signs > 0].sum()
        exact = min(1.0, 2 * np.mean(sums <= seen), 2 * np.mean(sums >= seen))
        d = np.append(sizes * signs, np.zeros(sites - differing))
        assert paired_difference(d, np.zeros(sites), np.arange(sites)).p_sites == pytest.approx(exact)


def test_p_of_many_differing_frames_is_nearly_that_of_all_signs():
    for n in (49, 50, 51, 52):  # exact, and by the normal distribution
        d = np.random.default_rng(n).normal(0.2, 1, n)
        assert paired_difference(d, np.zeros(n)).p == pytest.approx(stats.wilcoxon(d, method="exact").pvalue, rel=0.02)
