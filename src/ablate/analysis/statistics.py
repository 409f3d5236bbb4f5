"""Paired differences between two trained networks, and what may be claimed about a component."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy import stats

LATTICE = 2048  # levels that a bootstrap's differences are rounded to, over their range
FEWEST_SEEDS = 3


@dataclass(frozen=True)
class PairedDifference:
    """How a variant differs from the reference on the same frames.

    Attributes
    ----------
    shift : float
        Hodges-Lehmann median shift, variant minus reference.
    low, high : float
        Bootstrap interval of the shift over clusters; infinite when there is only one cluster.
    p : float
        Wilcoxon signed-rank, two-sided; 1 when nothing differs.
    effect : float
        Matched-pairs rank-biserial correlation, -1 to 1.
    n : int
        Pairs used.
    dropped : int
        Pairs left out because one value was infinite (identical frames have an infinite PSNR).
    clusters : int
        Clusters (probe sites) resampled for the interval.
    """

    shift: float
    low: float
    high: float
    p: float
    effect: float
    n: int
    dropped: int = 0
    clusters: int = 0


def hodges_lehmann(differences: np.ndarray) -> float:
    """Median of the Walsh averages (d_i + d_j) / 2, i <= j (Hodges and Lehmann 1963).

    Parameters
    ----------
    differences : (n,) float

    Returns
    -------
    float
    """
    i, j = np.triu_indices(len(differences))
    return float(np.median((differences[i] + differences[j]) / 2.0))


def rank_biserial(differences: np.ndarray) -> float:
    """Matched-pairs rank-biserial correlation, (W+ - W-) / (W+ + W-) (Kerby 2014); 0 if nothing differs.

    Parameters
    ----------
    differences : (n,) float
        Zeros are dropped, as by Wilcoxon.

    Returns
    -------
    float
        -1 (all negative) to 1 (all positive).
    """
    differences = differences[differences != 0]
    if not differences.size:
        return 0.0
    ranks = stats.rankdata(np.abs(differences))
    return float(np.sum(np.sign(differences) * ranks) / ranks.sum())


def _bootstrap_shifts(
    differences: np.ndarray, clusters: np.ndarray, resamples: int, rng: np.random.Generator
) -> np.ndarray:
    """(resamples,) Hodges-Lehmann shifts of resamples of whole clusters.

    On a lattice the counts of all Walsh averages are the autoconvolution of the histogram of differences, so
    one FFT takes the place of n^2 / 2 averages; an exact method up to rounding to range / LATTICE.
    """
    low, span = differences.min(), np.ptp(differences)
    if span == 0:
        return np.full(resamples, low)
    level = np.rint((differences - low) / span * (LATTICE - 1)).astype(int)
    names, member = np.unique(clusters, return_inverse=True)
    histograms = np.zeros((len(names), LATTICE))
    np.add.at(histograms, (member, level), 1.0)
    shifts = np.empty(resamples)
    uniform = np.full(len(names), 1.0 / len(names))
    for start in range(0, resamples, 256):
        draws = rng.multinomial(len(names), uniform, size=min(256, resamples - start))
        counts = draws @ histograms
        pairs = np.fft.irfft(np.fft.rfft(counts, 2 * LATTICE) ** 2, 2 * LATTICE)
        pairs[:, ::2] += counts  # i = j counts whole, i < j half of the autoconvolution
        total = np.cumsum(np.rint(pairs), axis=1)
        half = total[:, -1:] / 2.0
        middle = (np.argmax(total >= half, axis=1) + np.argmax(total > half, axis=1)) / 2.0
        shifts[start : start + len(draws)] = low + middle / 2.0 * span / (LATTICE - 1)
    return shifts


def paired_difference(
    values: Sequence[float] | np.ndarray,
    reference: Sequence[float] | np.ndarray,
    clusters: Sequence[object] | np.ndarray | None = None,
    level: float = 0.95,
    resamples: int = 2000,
    seed: int = 0,
) -> PairedDifference:
    """Compare two networks on the same frames: do *these two* differ?

    Parameters
    ----------
    values, reference : (n,) float
        One value a frame, in the same order; differences are values minus reference.
    clusters : (n,), optional
        Probe site of each frame: neighbouring frames are alike, so intervals resample sites. Without it every
        frame is its own cluster.
    level : float
        Coverage aimed at by the interval.
    resamples, seed : int
        Bootstrap resamples, and the seed of their draws.

    Returns
    -------
    PairedDifference

    Raises
    ------
    ValueError
        When lengths differ, a value is NaN, or no pair is finite.
    """
    values, reference = np.asarray(values, dtype=np.float64), np.asarray(reference, dtype=np.float64)
    labels = np.arange(values.size) if clusters is None else np.asarray(clusters)
    if values.ndim != 1 or values.shape != reference.shape or labels.shape != values.shape:
        raise ValueError(
            "values, reference and clusters must be (n,) alike, "
            f"got {values.shape}, {reference.shape} and {labels.shape}"
        )
    if np.isnan(values).any() or np.isnan(reference).any():
        raise ValueError("values and reference may not hold NaN")
    finite = np.isfinite(values) & np.isfinite(reference)
    if not finite.any():
        raise ValueError("no pair of finite values to compare")
    differences, labels = values[finite] - reference[finite], labels[finite]
    low, high, groups = -np.inf, np.inf, len(np.unique(labels))
    if groups > 1:
        shifts = _bootstrap_shifts(differences, labels, resamples, np.random.default_rng(seed))
        low, high = np.quantile(shifts, [(1 - level) / 2, (1 + level) / 2])
    return PairedDifference(
        shift=hodges_lehmann(differences),
        low=float(low),
        high=float(high),
        p=float(stats.wilcoxon(differences).pvalue) if differences.any() else 1.0,
        effect=rank_biserial(differences),
        n=int(differences.size),
        dropped=int(np.count_nonzero(~finite)),
        clusters=groups,
    )


def holm(p: Sequence[float] | np.ndarray) -> np.ndarray:
    """Holm's step-down adjustment: controls the chance of any false positive in a family (Holm 1979).

    Parameters
    ----------
    p : (k,) float in [0, 1]

    Returns
    -------
    (k,) float
        Adjusted values, in the order given.

    Raises
    ------
    ValueError
        When a value lies outside [0, 1].
    """
    p = np.asarray(p, dtype=np.float64)
    if not ((p >= 0) & (p <= 1)).all():
        raise ValueError("p-values must lie in [0, 1]")
    order = np.argsort(p)
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    return adjusted


class Verdict(StrEnum):
    """What seeds allow to be said about a component."""

    not_claimable = "not claimable"
    no_difference_found = "no difference found"
    differs = "differs"


@dataclass(frozen=True)
class ComponentClaim:
    """Whether a component matters, judged on seeds rather than frames.

    `shift`, `low`, `high` are the difference of the seeds' means (variant minus reference) and its Welch
    interval; they and `p` are None when nothing can be claimed.
    """

    verdict: Verdict
    seeds: int
    shift: float | None = None
    low: float | None = None
    high: float | None = None
    p: float | None = None

    def __str__(self) -> str:
        if self.p is None:
            return f"{self.verdict}, {self.seeds} seed{'' if self.seeds == 1 else 's'}"
        return f"{self.verdict} (p = {self.p:.2g}, {self.seeds} seeds)"


def component_claim(
    values: Sequence[float] | np.ndarray, reference: Sequence[float] | np.ndarray, level: float = 0.95
) -> ComponentClaim:
    """Judge a component by Welch's test on one mean a seed.

    Frames cannot answer this: two trainings of one network differ on them with p down to 1e-12.

    Parameters
    ----------
    values, reference : (k,) and (l,) float
        Test mean of each seed, with and without the change.
    level : float
        Coverage of the interval; `differs` when it excludes 0.

    Returns
    -------
    ComponentClaim
        `not_claimable` below three finite seeds on either side, or when no seed changes anything.
    """
    sides = [np.asarray(side, dtype=np.float64) for side in (values, reference)]
    a, b = (side[np.isfinite(side)] for side in sides)
    seeds = min(len(a), len(b))
    if seeds < FEWEST_SEEDS or (np.ptp(a) == 0 and np.ptp(b) == 0):
        return ComponentClaim(Verdict.not_claimable, seeds)
    result = stats.ttest_ind(a, b, equal_var=False)
    interval = result.confidence_interval(level)
    p = float(result.pvalue)
    return ComponentClaim(
        Verdict.differs if p < 1 - level else Verdict.no_difference_found,
        seeds,
        float(a.mean() - b.mean()),
        float(interval.low),
        float(interval.high),
        p,
    )
