"""Does the statistics keep its word? Simulated studies, judged by the project's own functions: false claims and power.

python scripts/calibration.py                             # the tables of docs/statistics.md
python scripts/calibration.py --study runs/full_model         # the random effects of a study of yours, and their tables
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pandas as pd
from scipy import stats
from tqdm import trange

import ablate
from ablate.analysis import RESIMULATION, Claim, factorial_effects, paired_difference, seed_claims

VARIANTS, METRICS = 8, 5  # of a study: seven comparisons in five metrics
LEVEL = 0.05


@dataclass(frozen=True)
class Sizes:
    """Standard deviations of what makes two trainings of one network differ, in units of the metric.

    Attributes
    ----------
    run : float
        Of a whole training: the same on all frames.
    run_site : float
        Of a training at a probe site.
    run_frame : float
        Of a training at a frame.
    sites, frames : int
        Probe sites of the test part, and frames at each.
    """

    run: float
    run_site: float
    run_frame: float
    sites: int
    frames: int


# PSNR in dB between seeds of one variant, as `--study` printed them of a study of version 0.1.0.
MEASURED = Sizes(run=0.085, run_site=0.123, run_frame=0.195, sites=16, frames=6)


def sizes_of(values: pd.DataFrame) -> Sizes:
    """Random effects between the seeds of the same variant, by moments (one-way analysis of variance over sites).

    Parameters
    ----------
    values : DataFrame
        Columns variant, seed, site, frame and value: one metric, as in `Study.per_image`.

    Raises
    ------
    ValueError
        When no variant has two seeds.
    """
    found = []
    for _, of_variant in values.groupby("variant", observed=True):
        by_seed = of_variant.pivot(index=["site", "frame"], columns="seed", values="value")
        for a, b in combinations(by_seed, 2):
            difference = (by_seed[a] - by_seed[b]).dropna()
            sites = difference.groupby("site")
            sizes, means, n = sites.size(), sites.mean(), len(difference)
            within = float(((difference - sites.transform("mean")) ** 2).sum() / (n - len(sizes)))
            between = float((sizes * (means - difference.mean()) ** 2).sum() / (len(sizes) - 1))
            weight = (n - float((sizes**2).sum()) / n) / (len(sizes) - 1)
            site = max(0.0, (between - within) / weight)
            run = difference.mean() ** 2 - between / n
            found.append((run / 2, site / 2, within / 2, len(sizes), n / len(sizes)))
    if not found:
        raise ValueError("no variant has two seeds")
    run, site, frame, sites, frames = np.mean(found, axis=0).tolist()
    return Sizes(max(run, 0.0) ** 0.5, site**0.5, frame**0.5, round(sites), round(frames))


def draw_runs(sizes: Sizes, runs: int, rng: np.random.Generator) -> np.ndarray:
    """(runs, sites, frames) deviations of trainings from what their network would score on average."""
    return (
        sizes.run * rng.normal(size=(runs, 1, 1))
        + sizes.run_site * rng.normal(size=(runs, sizes.sites, 1))
        + sizes.run_frame * rng.normal(size=(runs, sizes.sites, sizes.frames))
    )


def study_claims(
    sizes: Sizes, seeds: int, effect: float, rng: np.random.Generator, spread: float = 1.0
) -> pd.DataFrame:
    """`seed_claims` of one simulated study; the first variant differs from the reference by `effect` in every metric.

    Its trainings spread `spread` times as far as those of the others. Frames add their own difficulty, the same for all
    trainings; metrics are independent.
    """
    frames = sizes.sites * sizes.frames
    index = pd.MultiIndex.from_product(
        [
            [f"m{k}" for k in range(METRICS)],
            ["sa2h", *(f"v{k}" for k in range(1, VARIANTS))],
            range(seeds),
            range(frames),
        ],
        names=["metric", "variant", "seed", "frame"],
    )
    values = np.stack([draw_runs(sizes, VARIANTS * seeds, rng) for _ in range(METRICS)])
    values = values.reshape(METRICS, VARIANTS, seeds, frames)
    values[:, 1] = effect + spread * values[:, 1]
    values += rng.normal(size=(METRICS, 1, 1, frames))
    table = pd.DataFrame({"value": values.ravel()}, index=index).reset_index()
    return seed_claims(table.assign(site=table["frame"] // sizes.frames))


def seed_level(sizes: Sizes, seeds: int, effect: float, repetitions: int, spread: float = 1.0) -> dict[str, float]:
    """How often a claim is made at the seed level.

    Returns
    -------
    dict
        `alone`: the first row taken alone has p below 5 %; `differs`: it survives Holm's correction over the study;
        `any_alone`, `any_differs`: some row of the study does.
    """
    counts = dict.fromkeys(("alone", "differs", "any_alone", "any_differs"), 0)
    for k in trange(repetitions, desc=f"{seeds} seeds, effect {effect:g}", leave=False, mininterval=1.0, disable=None):
        claims = study_claims(sizes, seeds, effect, np.random.default_rng(k), spread)
        alone, differs = claims["p"].astype(float) < LEVEL, claims["verdict"] == Claim.differs
        first = (claims["variant"] == "v1") & (claims["metric"] == "m0")
        counts["alone"] += int(alone[first].any())
        counts["differs"] += int(differs[first].any())
        counts["any_alone"] += int(alone.any())
        counts["any_differs"] += int(differs.any())
    return {name: count / repetitions for name, count in counts.items()}


def frame_level(sizes: Sizes, effect: float, repetitions: int) -> dict[str, float]:
    """How often two networks are told apart on frames, and how often the interval holds their difference.

    Parameters
    ----------
    sizes : Sizes
        With `run` 0 the two differ by `effect` over all sites there are.
    effect : float
    repetitions : int

    Returns
    -------
    dict
        Shares below 5 %: `frames`, Wilcoxon over frames; `means`, over the sites' means (what the project uses);
        `medians`, over the sites' medians; `flips`, Wilcoxon's statistic with the signs of whole sites flipped (Rosner,
        Glynn and Lee 2006). And `covered`: the interval over sites holds `effect`.
    """
    counts = dict.fromkeys(("frames", "means", "medians", "flips", "covered"), 0)
    sites = np.repeat(np.arange(sizes.sites), sizes.frames)
    for k in trange(repetitions, desc="frame level", leave=False, mininterval=1.0, disable=None):
        a, b = draw_runs(sizes, 2, np.random.default_rng(k))
        found = paired_difference((a + effect).ravel(), b.ravel(), sites, resamples=1000)
        difference = a + effect - b
        ranks = np.bincount(sites, stats.rankdata(np.abs(difference)) * np.sign(difference.ravel()))
        counts["frames"] += int(found.p < LEVEL)
        counts["means"] += int(found.p_sites < LEVEL)
        counts["medians"] += int(stats.wilcoxon(np.median(difference, axis=1)).pvalue < LEVEL)
        counts["flips"] += int(abs(ranks.sum()) / np.sqrt(np.sum(ranks**2)) > stats.norm.isf(LEVEL / 2))
        counts["covered"] += int(found.lower <= effect <= found.upper)
    return {name: count / repetitions for name, count in counts.items()}


def skewed_level(sites: int, repetitions: int) -> dict[str, float]:
    """How often two networks with equal means are told apart where their differences at sites are skewed.

    Differences are exponential, 0 on average: at few sites a network is much worse, at most a little better.

    Returns
    -------
    dict
        Shares below 5 %: `means`, Wilcoxon over sites; `flips`, all or 1000 changes of the signs of differences, by
        their sum; `student`, Student's t-test.
    """
    counts = dict.fromkeys(("means", "flips", "student"), 0)
    for k in trange(repetitions, desc=f"{sites} skewed sites", leave=False, mininterval=1.0, disable=None):
        difference = np.random.default_rng(k).exponential(size=sites) - 1
        changed = stats.permutation_test(
            (difference,), np.sum, permutation_type="samples", n_resamples=1000, rng=np.random.default_rng(k)
        )
        counts["means"] += int(paired_difference(difference, np.zeros(sites), resamples=1).p_sites < LEVEL)
        counts["flips"] += int(changed.pvalue < LEVEL)
        counts["student"] += int(stats.ttest_1samp(difference, 0).pvalue < LEVEL)
    return {name: count / repetitions for name, count in counts.items()}


def half_fraction(seeds: int) -> pd.DataFrame:
    """The runs of the 16 cells with an even number of five components changed."""
    cells = [cell for cell in product((0, 1), repeat=5) if sum(cell) % 2 == 0]
    table = pd.DataFrame(cells * seeds, columns=list("abcde"))
    return table.apply(lambda column: pd.Categorical(column, [0, 1]))


def factorial_level(sizes: Sizes, seeds: int, effect: float, repetitions: int) -> float:
    """How often the main effect of the first of five components has p below 5 % in the half fraction."""
    runs = half_fraction(seeds)
    changed = runs["a"].astype(int).to_numpy() == 1
    found = 0
    for k in trange(repetitions, desc=f"factorial, {seeds} seeds", leave=False, mininterval=1.0, disable=None):
        values = draw_runs(sizes, len(runs), np.random.default_rng(k)).mean(axis=(1, 2)) + effect * changed
        p = factorial_effects(runs.assign(value=values), list("abcde"))["p"].iloc[0]
        found += int(p < LEVEL)
    return found / repetitions


def spread_of_run_means(sizes: Sizes) -> float:
    """Standard deviation of a run's mean over the test frames: the unit that effects are stated in."""
    frames = sizes.sites * sizes.frames
    return float(np.sqrt(sizes.run**2 + sizes.run_site**2 / sizes.sites + sizes.run_frame**2 / frames))


def report(sizes: Sizes, repetitions: int) -> Iterator[str]:
    """The tables in Markdown, line by line."""
    unit = spread_of_run_means(sizes)
    yield (
        f"Random effects (PSNR, dB): training {sizes.run:.3f}, training x site {sizes.run_site:.3f}, training x frame "
        f"{sizes.run_frame:.3f}; {sizes.sites} sites of {sizes.frames} frames; sd of a run's mean {unit:.3f}. "
        f"{repetitions} repetitions."
    )
    tests = ("test over frames", "test over site means", "test over site medians", "test with signs changed per site")
    yield f"\n| two networks | {' | '.join(tests)} | interval contains the true difference |"
    yield "| --- | --- | --- | --- | --- | --- |"
    same = replace(sizes, run=0.0)
    for name, of, effect in (
        ("two networks with equal means over all possible sites", same, 0.0),
        (f"two networks whose means over all possible sites differ by {unit:.2f} dB", same, unit),
        ("two trainings of one network", sizes, 0.0),
    ):
        rate = frame_level(of, effect, repetitions)
        yield f"| {name} | {' | '.join(f'{value:.3f}' for value in rate.values())} |"
    yield "\n| skewed differences | test over site means | signs of the sites changed, their mean | Student's t-test |"
    yield "| --- | --- | --- | --- |"
    for sites in (6, 10, 16, 30):
        shares = skewed_level(sites, repetitions).values()
        yield f"| {sites} sites | {' | '.join(f'{share:.3f}' for share in shares)} |"
    claims = [
        f"{claim} in {place}" for claim in ("p < 0.05", "`differs`") for place in ("the chosen row", "at least one row")
    ]
    yield f"\n| simulated study | {' | '.join(claims)} |"
    yield "| --- | --- | --- | --- | --- |"
    for seeds, spread in ((3, 1.0), (5, 1.0), (3, 3.0), (5, 3.0)):
        rate = seed_level(sizes, seeds, 0.0, repetitions, spread)
        shares = (f"{rate[name]:.3f}" for name in ("alone", "any_alone", "differs", "any_differs"))
        more = "" if spread == 1 else ", one variant with three times the spread"
        yield f"| {seeds} seeds{more} | {' | '.join(shares)} |"
    effects = (0.0, 1.0, 2.0, 3.0, 5.0, 8.0)
    sizes_shown = " | ".join(f"{e:g}" for e in effects[1:])
    yield f"\n| size of the effect, in standard deviations of a run's mean | {sizes_shown} |"
    yield f"| --- |{' --- |' * len(effects[1:])}"
    for seeds in (3, 5, 10):
        rates = [seed_level(sizes, seeds, e * unit, max(repetitions // 5, 1)) for e in effects[1:]]
        for name, verdict in (("alone", "`suggested` or `differs`"), ("differs", "`differs`")):
            yield f"| {seeds} seeds, verdict {verdict} | {' | '.join(f'{rate[name]:.2f}' for rate in rates)} |"
    none = []
    for seeds in (2, 3):
        found = [factorial_level(sizes, seeds, e * unit, repetitions) for e in effects]
        cells = " | ".join(f"{rate:.2f}" for rate in found[1:])
        none.append(f"{found[0]:.3f} with {seeds} seeds")
        yield f"| half factorial, 16 cells with {seeds} seeds each, p < 0.05 | {cells} |"
    yield f"\nShare of p < 0.05 in the half factorial without an effect: {', '.join(none)}."


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--study", type=Path, default=None, help="take the random effects from this study")
    parser.add_argument("--repetitions", type=int, default=1000)
    args = parser.parse_args()
    sizes = MEASURED
    if args.study:
        values = ablate.open_study(args.study).per_image
        sizes = sizes_of(values[(values["metric"] == "psnr") & (values["variant"] != RESIMULATION)])
    for line in report(sizes, args.repetitions):
        print(line, flush=True)


if __name__ == "__main__":
    main()
