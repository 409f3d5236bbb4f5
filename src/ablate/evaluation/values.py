"""The values of all frames of a part as a table, and their means."""

import logging

import numpy as np
import pandas as pd

from ablate.dataset import Part
from ablate.metrics import METRICS
from ablate.metrics.metric import SCORE_COLUMNS


def values_table(part: Part, frames: np.ndarray, sites: np.ndarray, values: list[dict[str, float]]) -> pd.DataFrame:
    """One row a frame and metric, with the columns `SCORE_COLUMNS`; the log names values that do not count.

    Parameters
    ----------
    part : Part
        Named in the log.
    frames, sites : (k,) int
        Number and probe site of each frame.
    values : list of dict of str to float
        Of each frame by metric.
    """
    rows = [
        (int(frame), int(site), name, value)
        for frame, site, frame_values in zip(frames, sites, values, strict=True)
        for name, value in frame_values.items()
    ]
    table = pd.DataFrame(rows, columns=list(SCORE_COLUMNS)).astype({"value": "float64"})
    infinite = np.isinf(table["value"]) & ~table["metric"].isin(METRICS)  # PSNR of identical images is, by definition
    without = table[table["value"].isna() | infinite]
    for (name, value), same_value in without.groupby(["metric", "value"], dropna=False):
        word = "NaN" if np.isnan(value) else "infinite"
        named = ", ".join(same_value["frame"].astype(str))
        logging.getLogger(__name__).warning("%s is %s on %s frame %s: not in its mean", name, word, part.name, named)
    return table


def means(per_image: pd.DataFrame) -> dict[str, float]:
    """The mean of each metric over its finite values."""
    finite = per_image[np.isfinite(per_image["value"])]
    return {str(name): _mean(values.tolist()) for name, values in finite.groupby("metric")["value"]}


def _mean(values: list[float]) -> float:
    """The mean by Kahan's compensated sum: that of pandas, which adds otherwise where a group is alone in its table."""
    total = lost = 0.0
    for value in values:
        term = value - lost
        raised = total + term
        lost = raised - total - term
        total = raised
    return total / len(values)
