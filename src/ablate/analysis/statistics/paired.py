"""Paired differences on the same frames: of two trained networks, and of every variant to the reference."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.scored import LEVEL, REFERENCE, every_frame, is_network, ordered_metrics, ordered_variants

PAIRED_COLUMNS = (
    "variant",
    "reference",
    "metric",
    "shift",
    "lower",
    "upper",
    "p_holm",
    "effect",
    "n",
    "p_sites_holm",
    "sites",
    "dropped",
)
LATTICE = 512  # levels, at least, that a bootstrap's differences are rounded to, over their range
MOST_EXACT = 50  # differences of which Wilcoxon's test is exact
_FAR, _MOST_FAR = 256, 0.05  # in spreads from the estimate, and how many differences may lie there


@dataclass(frozen=True)
class PairedDifference:
    """How a variant differs from the reference on the same frames.

    Attributes
    ----------
    shift : float
        Hodges' and Lehmann's median shift, variant minus reference.
    lower, upper : float
        Its bootstrap interval over clusters (probe sites), infinite when there is only one.
    p : float
        Of Wilcoxon's signed-rank test over frames, two-sided, and 1 when nothing differs; exact where at most 50
        differ. It takes frames for independent, so it speaks of these frames and not of other sites.
    p_sites : float
        Of the same test on one mean a cluster: it speaks of sites like these. Below six clusters it cannot reach 5 %.
    effect : float
        The matched-pairs rank-biserial correlation, -1 to 1.
    n : int
        Pairs that were used.
    dropped : int
        Pairs that were not, because one value was infinite, as the PSNR of identical frames, or missing.
    clusters : int
        How many there are.
    """

    shift: float
    lower: float
    upper: float
    p: float
    p_sites: float
    effect: float
    n: int
    dropped: int = 0
    clusters: int = 0


def hodges_lehmann(differences: np.ndarray) -> float:
    """Median of the Walsh averages (d_i + d_j) / 2, i <= j, of (n,) differences (Hodges and Lehmann 1963)."""
    i, j = np.triu_indices(len(differences))
    return float(np.median((differences[i] + differences[j]) / 2.0))


def rank_biserial(differences: np.ndarray) -> float:
    """Matched-pairs rank-biserial correlation, (W+ - W-) / (W+ + W-), of (n,) differences (Kerby 2014).

    It is -1 where all are negative and 1 where all are positive; 0 if nothing differs. Zeros are dropped.
    """
    differences = differences[differences != 0]
    ranks = stats.rankdata(np.abs(differences))
    return float(np.sum(np.sign(differences) * ranks) / ranks.sum()) if len(ranks) else 0.0


def _bootstrap_shifts(
    differences: np.ndarray, clusters: np.ndarray, resamples: int, rng: np.random.Generator
) -> np.ndarray:
    """(resamples,) Hodges-Lehmann shifts of resamples of whole clusters.

    On a lattice the counts of all Walsh averages are the autoconvolution of the histogram of differences, so one FFT
    takes the place of n^2 / 2 averages; an exact method up to rounding to range / LATTICE. The estimate is a point of
    the lattice: otherwise ties at the estimate (many frames without a difference) would be rounded to a value beside
    it, and the interval would exclude it. About 32 levels or more lie within the spread of `_spread`, and differences
    are clipped at 256 of it from the estimate.
    """
    centre = hodges_lehmann(differences)
    spread = _spread(differences, centre)
    if spread > 0:
        differences = np.clip(differences, centre - _FAR * spread, centre + _FAR * spread)
    span = np.ptp(differences)
    if span == 0:
        return np.full(resamples, centre)
    levels = LATTICE
    if spread > 0:
        levels *= 2 ** max(0, int(np.ceil(np.log2(span / spread / 16))))
    spacing = span / (levels - 2)
    level = np.rint((differences - centre) / spacing).astype(int)
    lowest = level.min()
    names, member = np.unique(clusters, return_inverse=True)
    histograms = np.zeros((len(names), levels))
    np.add.at(histograms, (member, level - lowest), 1.0)
    shifts = np.empty(resamples)
    uniform = np.full(len(names), 1.0 / len(names))
    batch = 256 * LATTICE // levels
    for start in range(0, resamples, batch):
        draws = rng.multinomial(len(names), uniform, size=min(batch, resamples - start))
        middle = _median_walsh_level(draws @ histograms)
        shifts[start : start + len(draws)] = centre + (middle / 2.0 + lowest) * spacing
    return shifts


def _spread(differences: np.ndarray, centre: float) -> float:
    """The range of the middle half of differences, or of so many more that few lie far outside; 0 where most are tied.

    Where values are nearly tied, as those of a metric in decimals that is computed in single precision, the middle half
    may have a range of 1e-8, and all that decides an interval lies outside.
    """
    for share in (0.5, 0.6, 0.7, 0.8, 0.9, 0.95):
        spread = float(np.ptp(np.quantile(differences, [(1 - share) / 2, (1 + share) / 2])))
        if spread > 0 and np.mean(np.abs(differences - centre) > _FAR * spread) <= _MOST_FAR:
            return spread
    return 0.0


def _median_walsh_level(counts: np.ndarray) -> np.ndarray:
    """(k,) float: twice the median Walsh average of k samples, of how often each has each level, (k, levels) float."""
    levels = counts.shape[1]
    pairs = np.fft.irfft(np.fft.rfft(counts, 2 * levels) ** 2, 2 * levels)
    pairs[:, ::2] += counts  # i = j counts whole, i < j half of the autoconvolution
    total = np.cumsum(np.rint(pairs), axis=1)
    half = total[:, -1:] / 2.0
    return (np.argmax(total >= half, axis=1) + np.argmax(total > half, axis=1)) / 2.0


def _wilcoxon(differences: np.ndarray) -> float:
    """The two-sided p-value of the signed-rank test; zeros are dropped, of few others it is exact, with ties too."""
    differences = differences[differences != 0]
    if len(differences) > MOST_EXACT:
        return float(stats.wilcoxon(differences).pvalue)
    ranks = np.rint(2 * stats.rankdata(np.abs(differences))).astype(int)  # ties have halves
    chance = np.ones(1)  # of each sum of the ranks of positive differences, if all signs are equally likely
    for rank in ranks:
        chance = (np.pad(chance, (0, rank)) + np.pad(chance, (rank, 0))) / 2
    positive = ranks[differences > 0].sum()
    return float(min(1.0, 2 * chance[: positive + 1].sum(), 2 * chance[positive:].sum()))


def _tied(differences: np.ndarray, rounding: np.ndarray) -> np.ndarray:
    """Differences of which those that only rounding tells apart, in size or from zero, are equal; all (n,) float.

    0.3 - 0.2 and 0.2 - 0.1 differ by 3e-17, and means over other numbers of seeds round otherwise.
    """
    order = np.argsort(np.abs(differences))
    sizes, rounding = np.abs(differences)[order], rounding[order]
    begins = np.diff(sizes, prepend=0.0) > np.maximum(rounding, np.append(0.0, rounding[:-1]))
    tied = np.empty_like(sizes)
    tied[order] = np.append(0.0, sizes[begins])[np.cumsum(begins)]
    return np.sign(differences) * tied


def paired_difference(
    values: Sequence[float] | np.ndarray,
    reference: Sequence[float] | np.ndarray,
    clusters: Sequence[object] | np.ndarray | None = None,
    resamples: int = 2000,
) -> PairedDifference:
    """Compare two networks on the same frames: do *these two* differ?

    Percentiles of a bootstrap over few clusters are too narrow; they are taken further out, by what Student's t asks
    for at that number of clusters (Hesterberg 2015, "expanded percentiles").

    Parameters
    ----------
    values, reference : (n,) float
        One value a frame, in the same order; differences are values minus reference.
    clusters : (n,), optional
        Probe site of each frame: neighbouring frames are alike, so intervals resample sites. Without it every frame is
        its own cluster.
    resamples : int
        Of the bootstrap, whose interval aims at a coverage of 95 %.

    Raises
    ------
    ValueError
        When lengths differ, a value is NaN, or no pair is finite.
    """
    values = np.asarray(values, dtype=np.float64)
    reference = np.asarray(reference, dtype=np.float64)
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
    differences = values[finite] - reference[finite]
    labels = labels[finite]
    rounding = 8 * np.finfo(float).eps * np.maximum(np.abs(values[finite]), np.abs(reference[finite]))
    differences = _tied(differences, rounding)
    by_site = pd.DataFrame({"difference": differences, "rounding": rounding}).groupby(labels)
    site_differences = _tied(by_site["difference"].mean().to_numpy(), by_site["rounding"].max().to_numpy())
    lower, upper = -np.inf, np.inf
    groups = len(np.unique(labels))
    if groups > 1:
        shifts = _bootstrap_shifts(differences, labels, resamples, np.random.default_rng(0))
        tail = stats.norm.sf(stats.t.ppf((1 + LEVEL) / 2, groups - 1) * np.sqrt(groups / (groups - 1)))
        lower, upper = np.quantile(shifts, [tail, 1 - tail])
    return PairedDifference(
        shift=hodges_lehmann(differences),
        lower=float(lower),
        upper=float(upper),
        p=_wilcoxon(differences),
        p_sites=_wilcoxon(site_differences),
        effect=rank_biserial(differences),
        n=int(differences.size),
        dropped=int(np.count_nonzero(~finite)),
        clusters=groups,
    )


def holm(p: Sequence[float] | np.ndarray) -> np.ndarray:
    """Holm's step-down adjustment: controls the chance of any false positive in a family (Holm 1979).

    `p` are (k,) float; adjusted values come in the same order. A value outside [0, 1] is a ValueError.
    """
    p = np.asarray(p, dtype=np.float64)
    if not ((p >= 0) & (p <= 1)).all():
        raise ValueError("p-values must lie in [0, 1]")
    order = np.argsort(p)
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1)), 1.0)
    return adjusted


def where_known(adjustment: Callable[[np.ndarray], np.ndarray], p: pd.Series) -> pd.Series:
    """An adjustment for several tests, as `holm`, of the values of a column that are known; None for the others."""
    adjusted = pd.Series(None, p.index, dtype=object)
    if p.notna().any():
        adjusted[p.notna()] = adjustment(p[p.notna()].to_numpy(dtype=np.float64))
    return adjusted


def aligned_differences(per_image: pd.DataFrame, metric: str, reference: str = REFERENCE) -> dict[str, pd.DataFrame]:
    """By variant, a row a frame that it and the reference have: columns site, value, reference.

    Values are means over seeds, infinite where one seed's is missing or not finite.
    """
    chosen = every_frame(per_image, metric)
    chosen = chosen.assign(value=chosen["value"].where(np.isfinite(chosen["value"]), np.inf))
    means = chosen.groupby(["variant", "frame"]).agg(value=("value", "mean"), site=("site", "first"))
    by_variant = {name: means.loc[name] for name in ordered_variants(list(chosen["variant"]), reference)}
    if reference not in by_variant:
        return {}
    base = by_variant.pop(reference)["value"].rename("reference")
    joined = {name: values.join(base, how="inner") for name, values in by_variant.items()}
    return {name: pairs for name, pairs in joined.items() if len(pairs)}


def paired_table(per_image: pd.DataFrame, reference: str = REFERENCE, resamples: int = 2000) -> pd.DataFrame:
    """Paired differences of every variant to the reference, in every metric; empty if it is missing or alone.

    Holm's correction runs over all networks and metrics together; baselines are no networks and have a family of
    their own. Metrics without one finite pair are left out. `per_image` is as for `comparison_table`; `resamples` are
    those of the bootstrap over sites.

    Columns are variant, reference, metric, shift, lower, upper, p_holm (Wilcoxon over frames), effect, n (frames),
    p_sites_holm (Wilcoxon over the sites' means), sites, dropped (frames without two finite values).
    """
    rows = []
    for metric in ordered_metrics(list(per_image["metric"])):
        for variant, pairs in aligned_differences(per_image, metric, reference).items():
            if not np.isfinite(pairs[["value", "reference"]]).all(axis=1).any():
                continue
            difference = paired_difference(
                pairs["value"].to_numpy(),
                pairs["reference"].to_numpy(),
                clusters=pairs["site"].to_numpy(),
                resamples=resamples,
            )
            rows.append({"variant": variant, "reference": reference, "metric": metric, **vars(difference)})
    table = pd.DataFrame(rows, columns=["variant", "reference", "metric", *PairedDifference.__annotations__])
    table = table.rename(columns={"p": "p_holm", "p_sites": "p_sites_holm", "clusters": "sites"})[list(PAIRED_COLUMNS)]
    family = is_network(table["variant"])
    for p in ("p_holm", "p_sites_holm"):
        table[p] = table.groupby(family)[p].transform(lambda values: holm(values.to_numpy()))
    order = ordered_variants(list(table["variant"]), reference)
    return table.sort_values("variant", key=lambda v: v.map(order.index), kind="stable", ignore_index=True)
