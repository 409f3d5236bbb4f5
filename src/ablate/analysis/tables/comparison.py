"""The comparison table: mean and spread of every metric for every variant."""

import numpy as np
import pandas as pd

from ablate.analysis.order import REFERENCE, RESIMULATION, ordered_metrics, ordered_variants
from ablate.analysis.values import require_columns
from ablate.metrics import metric_of
from ablate.metrics.stored_names import BOUNDS, FRAME_TIME, PER_IMAGE_COLUMNS, SCALAR_COLUMNS


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
        Variant shown first after the re-simulation.

    Returns
    -------
    DataFrame
        One row a variant and metric: columns variant, metric, mean (NaN without one finite value), sd (over frames, as
        the paper has it; over seeds for scalars; half of upper minus lower for times), seed_sd (of the seeds' means;
        None with one seed, and for times), seeds, n, dropped (values left out: infinite ones, of identical images, and
        NaN), lower, upper (where runs carry an interval of their own: the mean of its bounds), best (of the networks;
        the re-simulation does not compete; all times that the fastest one's spread reaches are best).

    Raises
    ------
    ValueError
        When a column is missing.
    """
    require_columns(per_image, PER_IMAGE_COLUMNS, "per_image")
    parts = [per_image[[*SCALAR_COLUMNS]]]
    if scalars is not None and len(scalars):
        require_columns(scalars, SCALAR_COLUMNS, "scalars")
        parts.append(scalars[[c for c in (*SCALAR_COLUMNS, *BOUNDS) if c in scalars]])
    values = pd.concat(parts, ignore_index=True)
    rows = []
    for (variant, metric), cell in values.groupby(["variant", "metric"], sort=False):
        finite = cell[np.isfinite(cell["value"])]
        seed_means = finite.groupby("seed")["value"].mean()
        lower, upper = (_mean_bound(cell, side) for side in BOUNDS)
        rows.append(
            {
                "variant": variant,
                "metric": metric,
                "mean": float(finite["value"].mean()) if len(finite) else float("nan"),
                "sd": float(finite["value"].std(ddof=1)) if len(finite) > 1 else None,
                "seed_sd": float(seed_means.std(ddof=1)) if len(seed_means) > 1 else None,
                "seeds": int(cell["seed"].nunique()),
                "n": len(finite),
                "dropped": len(cell) - len(finite),
                "lower": lower,
                "upper": upper,
            }
        )
        if metric == FRAME_TIME and lower is not None and upper is not None:
            rows[-1] |= {"sd": (upper - lower) / 2, "seed_sd": None}
    columns = ["variant", "metric", "mean", "sd", "seed_sd", "seeds", "n", "dropped", *BOUNDS]
    table = pd.DataFrame(rows, columns=columns)
    table["best"] = False
    for metric, group in table[table["variant"] != RESIMULATION].groupby("metric"):
        scores = group["mean"].map(lambda value, metric=metric: metric_of(str(metric)).badness(value))
        if scores.notna().any() and len(group) > 1:
            best = scores == scores.min()
            if metric == FRAME_TIME:
                best |= group["lower"].astype(float) <= group.loc[best, "upper"].astype(float).max()
            table.loc[scores.index[best], "best"] = True
    variants = {name: k for k, name in enumerate(ordered_variants(list(table["variant"]), reference))}
    metrics = {name: k for k, name in enumerate(ordered_metrics(list(table["metric"])))}
    keys = table["variant"].map(variants) * (len(metrics) + 1) + table["metric"].map(metrics)
    return table.iloc[np.argsort(keys.to_numpy(), kind="stable")].reset_index(drop=True)


def _mean_bound(cell: pd.DataFrame, side: str) -> float | None:
    """Mean over runs of a bound of their intervals."""
    known = side in cell and cell[side].notna().any()
    return float(cell[side].mean()) if known else None
