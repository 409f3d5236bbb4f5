"""Paired differences between two trained networks on the same frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

LATTICE = 512  # levels that a bootstrap's differences are rounded to, over their range
LARGEST = 1e100  # of what is compared: sums and squares of such values stay finite


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
        Wilcoxon signed-rank over frames, two-sided; 1 when nothing differs. It takes frames for independent, so it
        speaks of these frames and not of other sites.
    p_sites : float
        The same test on one mean a cluster: it speaks of sites like these. Below six clusters it cannot reach 5 %.
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
    p_sites: float
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
    one FFT takes the place of n^2 / 2 averages; an exact method up to rounding to range / LATTICE. The estimate is a
    point of the lattice: else ties at it, which many frames without a difference are, would round to beside it, and
    the interval leave it out.
    """
    centre, span = hodges_lehmann(differences), np.ptp(differences)
    if span == 0:
        return np.full(resamples, centre)
    spacing = span / (LATTICE - 2)
    level = np.rint((differences - centre) / spacing).astype(int)
    lowest = level.min()
    level -= lowest
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
        shifts[start : start + len(draws)] = centre + (middle / 2.0 + lowest) * spacing
    return shifts


def _expanded_tail(clusters: int, level: float) -> float:
    reach = stats.t.ppf((1 + level) / 2, clusters - 1) * np.sqrt(clusters / (clusters - 1))
    return float(stats.norm.sf(reach))


def _wilcoxon(differences: np.ndarray) -> float:
    return float(stats.wilcoxon(differences).pvalue) if differences.any() else 1.0


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
        When lengths differ, a value is NaN or finite beyond 1e100, or no pair is finite.

    Notes
    -----
    Percentiles of a bootstrap over few clusters are too narrow; they are taken further out, by what Student's t asks
    for at that number of clusters (Hesterberg 2015, "expanded percentiles").
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
    _check_size("values and reference", values[finite], reference[finite])
    if not finite.any():
        raise ValueError("no pair of finite values to compare")
    differences, labels = values[finite] - reference[finite], labels[finite]
    low, high, groups = -np.inf, np.inf, len(np.unique(labels))
    if groups > 1:
        shifts = _bootstrap_shifts(differences, labels, resamples, np.random.default_rng(seed))
        tail = _expanded_tail(groups, level)
        low, high = np.quantile(shifts, [tail, 1 - tail])
    return PairedDifference(
        shift=hodges_lehmann(differences),
        low=float(low),
        high=float(high),
        p=_wilcoxon(differences),
        p_sites=_wilcoxon(pd.Series(differences).groupby(labels).mean().to_numpy()),
        effect=rank_biserial(differences),
        n=int(differences.size),
        dropped=int(np.count_nonzero(~finite)),
        clusters=groups,
    )


def _check_size(names: str, *values: np.ndarray) -> None:
    """Raise ValueError where a value is so large that what is computed of it would overflow."""
    if any((np.abs(v) > LARGEST).any() for v in values):
        raise ValueError(f"{names} must lie within {LARGEST:g}")


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
