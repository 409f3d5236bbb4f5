"""The two tables that every comparison starts from, and the order in which variants and metrics are shown."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ablate.metrics import METRICS, Group, metric_of
from ablate.metrics.metric import FORMULA, RESIMULATED, SCALAR_COLUMNS

REFERENCE = "sa2h"
RESIMULATION = "re-simulation"  # shown among the variants, as FORMULA is
#: Renderers without weights by the source of their scores, as they are called among the variants; they do not compete.
BASELINES = {RESIMULATED: RESIMULATION, FORMULA: FORMULA}
BASELINE_NAMES = tuple(BASELINES.values())
CHANGED = 4
LEVEL = 0.95  # coverage of the intervals of all tables


def ordered_variants(variants: Sequence[str], reference: str = REFERENCE) -> list[str]:
    """Re-simulation, formula, reference, the other variants by name, then `sa2h.depth-8` and the like; each once."""
    return sorted(set(variants), key=lambda name: (variant_group(name, reference), name.replace(".", " ")))


def variant_group(name: str, reference: str = REFERENCE) -> int:
    """Block of rows: 0 re-simulation, 1 formula, 2 reference, 3 variants, `CHANGED` what was changed beside one."""
    return {RESIMULATION: 0, FORMULA: 1, reference: 2}.get(name, CHANGED if "." in name else 3)


def is_network(names: pd.Series) -> pd.Series:
    """Which of some variants are networks, and no baseline."""
    return ~names.isin(BASELINE_NAMES)


def ordered_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics in the order of `METRICS`, unknown ones last by name; each once."""
    place = {name: k for k, name in enumerate(METRICS)}
    return sorted(set(metrics), key=lambda name: (place.get(name, len(place)), name))


def judged_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics that claims are made about, in the same order: all but what a network costs."""
    return [name for name in ordered_metrics(metrics) if metric_of(name).group is not Group.cost]


def every_frame(per_image: pd.DataFrame, metric: str | None = None) -> pd.DataFrame:
    """The values of all metrics or of one, with NaN for each frame of a run of which a metric of the run has none.

    The column `stored` is "left_only" in these rows.
    """
    run = ["variant", "seed", *_data_column(per_image)]
    chosen = per_image if metric is None else per_image[per_image["metric"] == metric]
    frames = per_image[[*run, "frame", "site"]].drop_duplicates()
    metrics = chosen[[*run, "metric"]].drop_duplicates()
    return frames.merge(metrics, on=run).merge(chosen, how="left", indicator="stored")


def _data_column(table: pd.DataFrame) -> list[str]:
    return ["data"] if "data" in table else []


def finite_values(per_image: pd.DataFrame, scalars: pd.DataFrame | None = None) -> pd.DataFrame:
    """The finite values of both tables, with the columns variant, seed, metric, value, and data where they have it.

    They are those of frames of which all runs of networks have one, or means of runs would be over different frames. A
    run without one finite value of a metric does not count.
    """
    data = _data_column(per_image)
    columns = [*SCALAR_COLUMNS, *data]
    finite = per_image[np.isfinite(per_image["value"])]
    run = finite["variant"] + " " + finite["seed"].astype(str)
    trained = is_network(finite["variant"])
    compared = [trained, *(finite[name] for name in ("metric", *data))]
    runs_with_frame = run.groupby([*compared, finite["frame"]]).transform("nunique")
    runs_with_metric = run.groupby(compared).transform("nunique")
    networks = finite[(runs_with_frame == runs_with_metric) & trained]
    frame = ["metric", *data, "frame"]
    baselines = finite[~trained].merge(networks[frame].drop_duplicates(), on=frame)
    shared = pd.concat([networks, baselines], ignore_index=True)[columns]
    if scalars is None:
        return shared
    return pd.concat([shared, scalars.loc[np.isfinite(scalars["value"]), columns]])
