"""What a work-precision table says: the order at which an error falls, and the best point within a budget of time."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ablate.metrics import metric_of

BUDGETS_MS = (10.0, 40.0, 75.0, 200.0, 1000.0)


@dataclass(frozen=True)
class Order:
    """error = c n^-order, fitted on logarithms by least squares; the standard error is NaN with two points."""

    order: float
    standard_error: float


def observed_order(n: np.ndarray, error: np.ndarray, metric: str = "") -> Order | None:
    """Fit the order at which an error falls with the number of rays, or of anything else; None with fewer than two n.

    Parameters
    ----------
    n : (k,) float, positive
    error : (k,) float
        Points that are not positive and finite are left out.
    metric : str
        PSNR is converted to the root-mean-square error, 255 x 10^(-PSNR / 20).
    """
    n, error = np.asarray(n, float), np.asarray(error, float)
    if metric.startswith("psnr"):
        error = 255 * 10 ** (-error / 20)
    usable = np.isfinite(error) & (error > 0)
    x, y = np.log(n[usable]), np.log(error[usable])
    if len(np.unique(x)) < 2:
        return None
    centred = x - x.mean()
    spread = float(centred @ centred)
    slope = float(centred @ y) / spread
    residual = y - y.mean() - slope * centred  # scipy's linregress, from 1 - r^2, loses digits where the fit is exact
    free = len(x) - 2
    return Order(-slope, float(np.sqrt(residual @ residual / free / spread)) if free else float("nan"))


def pareto_front(
    ms: np.ndarray, error: np.ndarray, lower: np.ndarray | None = None, upper: np.ndarray | None = None
) -> np.ndarray:
    """Find the points that no other point beats: with a smaller error in no more time, or equal in less.

    Parameters
    ----------
    ms, error : (n,) float
        Smaller is better in both.
    lower, upper : (n,) float, optional
        The spread of the times. Another point takes no more time unless its lower bound is above this one's upper.

    Returns
    -------
    (k,) int
        Indices of the front, by increasing time; of equal points the first.

    Examples
    --------
    >>> import numpy as np
    >>> from ablate.analysis import pareto_front
    >>> pareto_front(np.array([10.0, 20.0, 30.0]), np.array([0.5, 0.6, 0.2])).tolist()
    [0, 2]
    """
    lower, upper = ms if lower is None else lower, ms if upper is None else upper
    order = np.lexsort((error, ms))
    place = np.argsort(order)
    better = (error[None] < error[:, None]) & (lower[None] <= upper[:, None])
    earlier = (error[None] == error[:, None]) & (place[None] < place[:, None])
    return order[~(better | earlier).any(axis=1)[order]]


def best_within(points: pd.DataFrame, metric: str, budget_ms: float) -> pd.Series | None:
    """Find the best point of a metric within a budget of time, and the fastest of equal ones; None if none is so fast.

    `points` has the columns ms, metric and error, and those that name a point.
    """
    fit = points[(points["metric"] == metric) & (points["ms"] <= budget_ms)]
    fit = fit[np.isfinite(fit["error"])]
    if fit.empty:
        return None
    order = fit.assign(badness=[metric_of(metric).badness(e) for e in fit["error"]]).sort_values(["badness", "ms"])
    return order.iloc[0]


def budget_table(points: pd.DataFrame, groups: dict[str, list[str]], rivals: tuple[str, str]) -> pd.DataFrame:
    """Tabulate what to use for a budget of milliseconds a frame.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error.
    groups : dict of str to list of str
        Series by the name of the column that they share.
    rivals : two of the groups
        Between which `better` decides.

    Returns
    -------
    DataFrame
        Columns metric, budget_ms; then for each group its best point as text, `<group>_error` and `<group>_ms`; and
        better: one of the rivals; empty where neither is fast enough, or where one has no such error at any time.
    """
    rows = []
    for metric in dict.fromkeys(points["metric"]):
        measured = set(points.loc[points["metric"] == metric, "series"])
        comparable = all(measured.intersection(groups[rival]) for rival in rivals)
        for budget in BUDGETS_MS:
            row: dict[str, object] = {"metric": metric, "budget_ms": budget}
            scores: dict[str, float] = {}
            for group, series in groups.items():
                best = best_within(points[points["series"].isin(series)], metric, budget)
                row[group] = "" if best is None else f"{best['series']}: {best['setting']}"
                row[f"{group}_error"] = float("nan") if best is None else float(best["error"])
                row[f"{group}_ms"] = float("nan") if best is None else float(best["ms"])
                if best is not None and group in rivals:
                    scores[group] = metric_of(metric).badness(float(best["error"]))
            row["better"] = min(scores, key=lambda g: scores[g]) if scores and comparable else ""
            rows.append(row)
    return pd.DataFrame(rows)
