"""What a work-precision table says: the order at which an error falls, and the points that no other one beats."""

import numpy as np
import pandas as pd

from ablate.analysis.scored import RESIMULATION
from ablate.metrics import Shown, shown_in
from ablate.metrics.metric import BOUNDS, FRAME_TIME


def observed_order(n: np.ndarray, error: np.ndarray, metric: str = "") -> tuple[float, float] | None:
    """Fit the order of error = c n^-order on logarithms by least squares; None with fewer than two n.

    Returns the order and its standard error, which is NaN with two points. n are rays, or anything else.
    `n`, (k,), are positive; points whose `error`, (k,), is not positive and finite are left out. Of the metric PSNR it
    is converted to the root-mean-square error, 255 x 10^(-PSNR / 20).
    """
    n = np.asarray(n, float)
    error = np.asarray(error, float)
    if metric.startswith("psnr"):
        error = 255 * 10 ** (-error / 20)
    usable = np.isfinite(error) & (error > 0)
    x = np.log(n[usable])
    y = np.log(error[usable])
    if len(np.unique(x)) < 2:
        return None
    line, covariance = np.polyfit(x, y, 1, cov="unscaled")
    residual = y - np.polyval(line, x)
    free = len(x) - 2
    error_of_slope = float(np.sqrt(residual @ residual / free * covariance[0, 0])) if free else float("nan")
    return -float(line[0]), error_of_slope


def pareto_front(
    ms: np.ndarray, error: np.ndarray, lower: np.ndarray | None = None, upper: np.ndarray | None = None
) -> np.ndarray:
    """Find the points that no other point beats: with a smaller error in no more time, or equal in less.

    Parameters
    ----------
    ms, error : (n,) float
        Smaller is better in both.
    lower, upper : (n,) float, optional
        The spread of the times, `ms` where it is not finite. Another point takes no more time unless its lower bound is
        above this one's upper.

    Returns
    -------
    (k,) int
        Indices of the front, by increasing time; of equal points the first.
    """
    lower = ms if lower is None else np.where(np.isfinite(lower), lower, ms)
    upper = ms if upper is None else np.where(np.isfinite(upper), upper, ms)
    order = np.lexsort((error, ms))
    place = np.argsort(order)
    better = (error[None] < error[:, None]) & (lower[None] <= upper[:, None])
    earlier = (error[None] == error[:, None]) & (place[None] < place[:, None])
    return order[(np.isfinite(error) & ~(better | earlier).any(axis=1))[order]]


def runtime_points(table: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, float]]:
    """Error of every variant against its milliseconds a frame, and the re-simulation's value by metric.

    `table` is what `comparison_table` gives. Columns are those of `error_vs_runtime`, with the spread of the times.
    """
    times = table[table["metric"] == FRAME_TIME].set_index("variant")[["mean", *BOUNDS]].rename(columns={"mean": "ms"})
    scored = table.loc[table["metric"].isin(shown_in(Shown.headline)), ["variant", "metric", "mean"]]
    points = scored.merge(times.astype("float64"), on="variant").sort_values("variant", kind="stable")
    points = points.rename(columns={"variant": "series", "mean": "error"}).assign(setting="")
    resimulated = scored[scored["variant"] == RESIMULATION]
    floors = {str(metric): float(mean) for metric, mean in zip(resimulated["metric"], resimulated["mean"], strict=True)}
    return points[["series", "setting", "ms", *BOUNDS, "metric", "error"]], floors
