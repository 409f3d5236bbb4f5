"""What a reader must not conclude from a study, in words."""

import numpy as np
import pandas as pd

from ablate.analysis.scored import REFERENCE, RESIMULATION, ordered_metrics, ordered_variants
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.metrics import METRICS, metric_of

FEW_SITES = 10  # below, intervals over sites are rough
FEWEST_SITES = 6  # below, a signed-rank test over sites cannot reach 5 %
NO_RESIMULATION = "The re-simulation is missing, so floors and levels are unknown."
MOST_NAMED = 6  # of a list; the rest are counted


def cautions(per_image: pd.DataFrame, reference: str = REFERENCE) -> list[str]:
    """Return what a reader must not conclude from this study, one sentence each; empty when nothing is amiss.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    """
    networks = per_image[per_image["variant"] != RESIMULATION]
    return [
        *_about_variants(networks, reference),
        *_about_seeds(networks, reference),
        *([] if RESIMULATION in set(per_image["variant"]) else [NO_RESIMULATION]),
        *_about_frames(networks),
        *_about_values(per_image),
    ]


def listed(names: list[str]) -> str:
    """Names in a sentence, the rest counted where there are many."""
    more = len(names) - MOST_NAMED
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:MOST_NAMED])} and {more} more"


def _about_variants(networks: pd.DataFrame, reference: str) -> list[str]:
    variants = ordered_variants(list(networks["variant"]), reference)
    if not variants:
        return ["There is no network in this study."]
    if reference not in variants:
        return [
            f"The reference {reference} is missing, so there are no paired differences (reference=... names another)."
        ]
    if len(variants) == 1:
        return [f"There is one variant, {variants[0]}: nothing is compared."]
    return []


def _about_seeds(networks: pd.DataFrame, reference: str) -> list[str]:
    seeds = networks.groupby("variant")["seed"].nunique()
    few = [f"{v} ({seeds[v]})" for v in ordered_variants(list(seeds.index), reference) if seeds[v] < FEWEST_SEEDS]
    if not few:
        return []
    return [
        f"Fewer than {FEWEST_SEEDS} seeds for {listed(few)}: from these alone it is not claimable that a variant is "
        "better or worse; the paired differences are between these trained networks only. Verdicts about components "
        "count all runs of a design."
    ]


def _about_frames(networks: pd.DataFrame) -> list[str]:
    texts = []
    sites = networks["site"].nunique()
    if 0 < sites < FEW_SITES:
        text = f"Only {sites} probe site{'' if sites == 1 else 's'}: intervals over sites are rough"
        if sites < FEWEST_SITES:
            text += f", and a test over fewer than {FEWEST_SITES} sites can show nothing"
        texts.append(f"{text}.")
    sites_of = networks.groupby("frame")["site"].nunique()
    if moved := [str(frame) for frame in sites_of.index[sites_of > 1]]:
        texts.append(f"Runs name different probe sites for frame {listed(moved)}: intervals over sites mean nothing.")
    frames: dict[str, int] = {}
    for keys, of_run in networks.groupby(["variant", "seed"]):
        frames["{}/seed{}".format(*keys)] = of_run["frame"].nunique()
    most = max(frames.values(), default=0)
    short = [f"{run} ({count})" for run, count in frames.items() if count < most]
    if short:
        texts.append(f"Not all runs have all {most} test frames: {listed(short)}; pairs are of frames that both have.")
    return texts


def _about_values(per_image: pd.DataFrame) -> list[str]:
    texts = []
    for metric in ordered_metrics(list(per_image["metric"])):
        rows = per_image[per_image["metric"] == metric]
        missing, infinite = rows[rows["value"].isna()], rows[np.isinf(rows["value"])]
        name = metric_of(metric).label
        if len(infinite):
            why = "identical images: " if metric in METRICS else ""  # of the package's, PSNR alone is ever infinite
            texts.append(f"{name}: {len(infinite)} infinite value{_s(infinite)} left out ({why}{_where(infinite)}).")
        if len(missing):
            texts.append(f"{name}: {len(missing)} NaN{_s(missing)} left out ({_where(missing)}).")
    return texts


def _s(rows: pd.DataFrame) -> str:
    return "" if len(rows) == 1 else "s"


def _where(rows: pd.DataFrame) -> str:
    places: dict[str, list[str]] = {}
    for row in rows.to_dict("records"):
        places.setdefault(f"{row['variant']}/seed{row['seed']}", []).append(str(row["frame"]))
    return listed([f"{run} frame {', '.join(f[:3])}{' ...' if len(f) > 3 else ''}" for run, f in places.items()])
