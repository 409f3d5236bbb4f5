"""Mean and spread of every metric of every variant."""

from collections.abc import Collection

import numpy as np
import pandas as pd

from ablate.analysis.scored import REFERENCE, every_frame, is_network, ordered_metrics, ordered_variants
from ablate.metrics import Direction, metric_of
from ablate.metrics.metric import BOUNDS, FRAME_TIME, SCALAR_COLUMNS

_SUMMARY = ("mean", "sd", "seed_sd", "seeds", "n", "dropped", *BOUNDS, "badness")


def comparison_table(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, reference: str = REFERENCE
) -> pd.DataFrame:
    """Mean and spread of every metric for every variant.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value: one row a metric of a frame of a run.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value and perhaps lower, upper: one row a metric of a run, as fd_speckle or
        parameters.
    reference : str
        Variant shown first after the baselines.

    Returns
    -------
    DataFrame
        One row a variant and metric: columns variant, metric, mean (NaN without one finite value), sd (over frames, as
        the paper has it; over seeds for scalars; half of upper minus lower for times), seed_sd (of the seeds' means;
        None with one seed, and for times), seeds, n, dropped (frames without a finite value), lower, upper (where runs
        carry an interval of their own: the mean of its bounds), best (of the networks, by the mean; where 0 is best, by
        the mean size of the seeds' means; baselines do not compete; all times that the fastest one's spread
        reaches are best).
    """
    values = every_frame(per_image)[[*SCALAR_COLUMNS]]
    if scalars is not None and len(scalars):
        columns = [name for name in (*SCALAR_COLUMNS, *BOUNDS) if name in scalars]
        values = pd.concat([values, scalars[columns]], ignore_index=True)
    rows = [
        {"variant": variant, "metric": metric, **_summary(str(metric), cell)}
        for (variant, metric), cell in values.groupby(["variant", "metric"], sort=False)
    ]
    table = pd.DataFrame(rows, columns=["variant", "metric", *_SUMMARY])
    badness = table.pop("badness")
    table["best"] = _best_networks(table, badness)
    order = [*ordered_variants(list(table["variant"]), reference), *ordered_metrics(list(table["metric"]))]
    return table.sort_values(["variant", "metric"], key=lambda names: names.map(order.index), ignore_index=True)


def _summary(metric: str, values: pd.DataFrame) -> dict[str, object]:
    """What a comparison table has of the values of one metric of one variant; `badness` decides which is best."""
    finite = values[np.isfinite(values["value"])]
    seed_means = finite.groupby("seed")["value"].mean()
    mean = float(finite["value"].mean())
    judge = metric_of(metric)
    judged = float(seed_means.abs().mean()) if judge.better is Direction.zero else mean
    # The mean over runs of the bounds of their intervals, where runs carry some.
    lower, upper = (float(values[b].mean()) if b in values and values[b].notna().any() else None for b in BOUNDS)
    sd = _sd(finite["value"])
    seed_sd = _sd(seed_means)
    if metric == FRAME_TIME and lower is not None and upper is not None:
        sd = (upper - lower) / 2
        seed_sd = None
    return {
        "mean": mean,
        "sd": sd,
        "seed_sd": seed_sd,
        "seeds": int(values["seed"].nunique()),
        "n": len(finite),
        "dropped": len(values) - len(finite),
        "lower": lower,
        "upper": upper,
        "badness": judge.badness(judged),
    }


def _sd(values: pd.Series) -> float | None:
    return float(values.std()) if len(values) > 1 else None


def _best_networks(table: pd.DataFrame, badness: pd.Series) -> pd.Series:
    """Which rows are best in their metric; none where a network is alone. Of times, all that its spread reaches."""
    best = pd.Series(False, index=table.index)
    for metric, rows in table[is_network(table["variant"])].groupby("metric"):
        scores = badness[rows.index]
        if len(rows) < 2 or scores.isna().all():
            continue
        is_best = scores == scores.min()
        if metric == FRAME_TIME:
            is_best |= rows["lower"].astype(float) <= rows.loc[is_best, "upper"].astype(float).max()
        best[rows.index] = is_best
    return best


def partly_scored(runs: pd.DataFrame, metrics: Collection[str]) -> list[str]:
    """One sentence on the metrics that only some runs of a variant have, of a table with a row a run; or none."""
    by_variant = runs.groupby("variant")
    trained = by_variant.size()
    texts = []
    for metric in sorted(set(metrics) & set(runs)):
        for (variant, count), all_runs in zip(by_variant[metric].count().items(), trained, strict=True):
            if 0 < count < all_runs:
                texts.append(f"{metric_of(metric).label} of {variant} ({count} of {all_runs})")
    again = "means and tests are over the runs that have it; the command of the others scores them, if they can be"
    return [f"Not all runs have each metric: {', '.join(texts)}; {again}."] if texts else []


def wide_table(table: pd.DataFrame) -> pd.DataFrame:
    """A `comparison_table` with one row a variant, for `table.csv`.

    Its columns are variant, seeds, `<metric>_mean`, `_sd`, `_seed_sd`, `_lower`, `_upper`; those without a value are
    left out.
    """
    parts = ["mean", "sd", "seed_sd", *BOUNDS]
    wide = table.pivot(index="variant", columns="metric", values=parts).swaplevel(axis="columns")
    columns = [(metric, part) for metric in table["metric"].unique() for part in parts]
    wide = wide.reindex(table["variant"].unique()).reindex(columns=columns)
    wide.columns = pd.Index(["_".join(pair) for pair in wide.columns])
    wide.insert(0, "seeds", table.groupby("variant")["seeds"].max())
    return wide.rename_axis("variant").reset_index().dropna(axis="columns", how="all")
