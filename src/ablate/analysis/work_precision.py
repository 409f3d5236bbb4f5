"""What a work-precision table says: the order at which an error falls, and what is best at which budget of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from ablate.analysis.metric_facts import badness

BUDGETS_MS = (10.0, 40.0, 75.0, 200.0, 1000.0)


@dataclass(frozen=True)
class Order:
    """error = c n^-order, fitted on logarithms by least squares.

    Attributes
    ----------
    order : float
    standard_error : float
        Of the fit; NaN with two points.
    """

    order: float
    standard_error: float


def observed_order(n: np.ndarray, error: np.ndarray, metric: str = "") -> Order | None:
    """How fast an error falls with the number of rays, or of anything else.

    Parameters
    ----------
    n : (k,) float, positive
    error : (k,) float
        Points that are not positive and finite are left out.
    metric : str
        PSNR is taken as the root-mean-square error that it stands for, 255 x 10^(-PSNR / 20).

    Returns
    -------
    Order, or None with fewer than two points
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
    residual = y - y.mean() - slope * centred
    free = len(x) - 2
    return Order(-slope, float(np.sqrt(residual @ residual / free / spread)) if free else float("nan"))


def best_within(points: pd.DataFrame, metric: str, budget_ms: float) -> pd.Series | None:
    """The best point of a metric that takes no longer than a budget; of equal ones the fastest.

    Parameters
    ----------
    points : DataFrame
        Columns ms, metric, error, and what else names a point.
    metric : str
    budget_ms : float

    Returns
    -------
    Series, or None where nothing is that fast
    """
    fit = points[(points["metric"] == metric) & (points["ms"] <= budget_ms)]
    fit = fit[np.isfinite(fit["error"])]
    if fit.empty:
        return None
    order = fit.assign(badness=[badness(metric, e) for e in fit["error"]]).sort_values(["badness", "ms"])
    return order.iloc[0]


def budget_table(points: pd.DataFrame, groups: dict[str, list[str]], rivals: tuple[str, str]) -> pd.DataFrame:
    """What to use for a budget of milliseconds a frame.

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
                    scores[group] = badness(metric, float(best["error"]))
            row["better"] = min(scores, key=lambda g: scores[g]) if scores and comparable else ""
            rows.append(row)
    return pd.DataFrame(rows)
