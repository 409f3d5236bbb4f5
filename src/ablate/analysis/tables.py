"""The comparison table and the table of paired differences, from per-image values."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ablate.analysis.metric_facts import METRICS, REFERENCE, RESIMULATION, badness
from ablate.analysis.statistics import component_claim, holm, paired_difference

PER_IMAGE_COLUMNS = ("variant", "seed", "frame", "site", "metric", "value")
SCALAR_COLUMNS = ("variant", "seed", "metric", "value")
PAIRED_COLUMNS = ("variant", "reference", "metric", "shift", "low", "high", "p_holm", "effect", "n")


def _require(frame: pd.DataFrame, columns: Sequence[str], name: str) -> None:
    missing = [column for column in columns if column not in frame.columns]
    if missing:
        raise ValueError(f"{name} lacks the columns {missing}, it has {list(frame.columns)}")
    if frame["value"].isna().any():
        row = frame[frame["value"].isna()].iloc[0]
        raise ValueError(f"{name} holds a NaN: metric {row['metric']} of {row['variant']}")


def ordered_variants(variants: Sequence[str], reference: str = REFERENCE) -> list[str]:
    """Variants as they are shown: the re-simulation, the reference, then the others by name.

    Parameters
    ----------
    variants : sequence of str
    reference : str

    Returns
    -------
    list of str
        Without repetitions.
    """
    first = {RESIMULATION: 0, reference: 1}
    return sorted(set(variants), key=lambda name: (first.get(name, 2), name))


def ordered_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics in the order of `METRICS`, unknown ones last by name.

    Parameters
    ----------
    metrics : sequence of str

    Returns
    -------
    list of str
        Without repetitions.
    """
    place = {name: k for k, name in enumerate(METRICS)}
    return sorted(set(metrics), key=lambda name: (place.get(name, len(place)), name))


def comparison_table(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, reference: str = REFERENCE
) -> pd.DataFrame:
    """Mean and spread of every metric for every variant.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value: one row a metric of a frame of a run.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value: one row a metric of a run (fd_speckle, parameters, ms_per_frame).
    reference : str
        Variant shown first after the re-simulation.

    Returns
    -------
    DataFrame
        One row a variant and metric: columns variant, metric, mean, sd (over frames, as the paper has it; over
        seeds for scalars), seed_sd (of the seeds' means; None with one seed), seeds, n, dropped (infinite
        values left out), best (of the networks; the re-simulation does not compete).

    Raises
    ------
    ValueError
        When a column is missing or a value is NaN.
    """
    _require(per_image, PER_IMAGE_COLUMNS, "per_image")
    parts = [per_image[[*SCALAR_COLUMNS]]]
    if scalars is not None and len(scalars):
        _require(scalars, SCALAR_COLUMNS, "scalars")
        parts.append(scalars[[*SCALAR_COLUMNS]])
    values = pd.concat(parts, ignore_index=True)
    rows = []
    for (variant, metric), cell in values.groupby(["variant", "metric"], sort=False):
        finite = cell[np.isfinite(cell["value"])]
        seed_means = finite.groupby("seed")["value"].mean()
        rows.append(
            {
                "variant": variant,
                "metric": metric,
                "mean": float(finite["value"].mean()) if len(finite) else float("inf"),
                "sd": float(finite["value"].std(ddof=1)) if len(finite) > 1 else None,
                "seed_sd": float(seed_means.std(ddof=1)) if len(seed_means) > 1 else None,
                "seeds": int(cell["seed"].nunique()),
                "n": len(finite),
                "dropped": len(cell) - len(finite),
            }
        )
    columns = ["variant", "metric", "mean", "sd", "seed_sd", "seeds", "n", "dropped"]
    table = pd.DataFrame(rows, columns=columns)
    table["best"] = False
    for metric, group in table[table["variant"] != RESIMULATION].groupby("metric"):
        scores = group["mean"].map(lambda value, metric=metric: badness(str(metric), value))
        if scores.notna().any() and len(group) > 1:
            table.loc[scores.index[scores == scores.min()], "best"] = True
    variants = {name: k for k, name in enumerate(ordered_variants(list(table["variant"]), reference))}
    metrics = {name: k for k, name in enumerate(ordered_metrics(list(table["metric"])))}
    keys = table["variant"].map(variants) * (len(metrics) + 1) + table["metric"].map(metrics)
    return table.iloc[np.argsort(keys.to_numpy(), kind="stable")].reset_index(drop=True)


def _frame_means(per_image: pd.DataFrame) -> pd.DataFrame:
    """One value a variant, metric and frame: the mean over seeds."""
    keys = ["variant", "metric", "frame"]
    return per_image.groupby(keys, as_index=False, sort=False).agg(value=("value", "mean"), site=("site", "first"))


def aligned_differences(per_image: pd.DataFrame, metric: str, reference: str = REFERENCE) -> dict[str, pd.DataFrame]:
    """Per-frame values of every other variant beside the reference's.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    metric : str
    reference : str

    Returns
    -------
    dict of str to DataFrame
        For each variant but the reference: columns frame, site, value, reference, on the frames both have;
        values are means over seeds.
    """
    means = _frame_means(per_image[per_image["metric"] == metric])
    base = means[means["variant"] == reference][["frame", "value"]]
    base = base.rename(columns={"value": "reference"})
    result = {}
    for variant in ordered_variants(list(means["variant"]), reference):
        joined = means[means["variant"] == variant].merge(base, on="frame", validate="one_to_one")
        if variant != reference and len(joined):
            result[variant] = joined[["frame", "site", "value", "reference"]]
    return result


def paired_table(
    per_image: pd.DataFrame, reference: str = REFERENCE, resamples: int = 2000, seed: int = 0
) -> pd.DataFrame:
    """Paired differences of every variant to the reference, in every metric.

    Holm's correction runs over all networks and metrics together; the re-simulation is no network and has a
    family of its own. Metrics without one finite pair are left out.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    reference : str
    resamples, seed : int
        Of the bootstrap over sites.

    Returns
    -------
    DataFrame
        Columns variant, reference, metric, shift, low, high, p_holm, effect, n; empty when the reference is
        missing or alone.

    Raises
    ------
    ValueError
        When a column is missing or a value is NaN.
    """
    _require(per_image, PER_IMAGE_COLUMNS, "per_image")
    rows = []
    for metric in ordered_metrics(list(per_image["metric"])):
        for variant, pairs in aligned_differences(per_image, metric, reference).items():
            value, base = pairs["value"].to_numpy(), pairs["reference"].to_numpy()
            if not (np.isfinite(value) & np.isfinite(base)).any():
                continue
            found = paired_difference(value, base, pairs["site"].to_numpy(), resamples=resamples, seed=seed)
            rows.append(
                {
                    "variant": variant,
                    "reference": reference,
                    "metric": metric,
                    "shift": found.shift,
                    "low": found.low,
                    "high": found.high,
                    "p_holm": found.p,
                    "effect": found.effect,
                    "n": found.n,
                }
            )
    table = pd.DataFrame(rows, columns=list(PAIRED_COLUMNS))
    for family in (table["variant"] == RESIMULATION, table["variant"] != RESIMULATION):
        if family.any():
            table.loc[family, "p_holm"] = holm(table.loc[family, "p_holm"].to_numpy())
    order = {name: k for k, name in enumerate(ordered_variants(list(table["variant"]), reference))}
    return table.sort_values("variant", key=lambda v: v.map(order), kind="stable").reset_index(drop=True)


def seed_claims(per_image: pd.DataFrame, reference: str = REFERENCE) -> pd.DataFrame:
    """Which components may be said to matter: `component_claim` on the seeds' means.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value; or scalars without frame and site.
    reference : str

    Returns
    -------
    DataFrame
        Columns variant, metric, verdict, seeds, shift, low, high, p.
    """
    finite = per_image[np.isfinite(per_image["value"])]
    means = finite.groupby(["metric", "variant", "seed"])["value"].mean()
    rows = []
    for metric in ordered_metrics(list(finite["metric"])):
        of_metric = means.loc[metric]
        variants = ordered_variants(list(of_metric.index.get_level_values("variant")), reference)
        if reference not in variants:
            continue
        for variant in variants:
            if variant not in (reference, RESIMULATION):
                claim = component_claim(of_metric.loc[variant].to_numpy(), of_metric.loc[reference].to_numpy())
                rows.append({"variant": variant, "metric": metric, **vars(claim)})
    columns = ["variant", "metric", "verdict", "seeds", "shift", "low", "high", "p"]
    return pd.DataFrame(rows, columns=columns)
