"""Error against run time: what a millisecond buys, for the simulator and for every network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from ablate.analysis.figure_style import FLOOR_COLOUR, MARKERS, PAGE_IN, colour_of, house_style, new_figure, save_figure
from ablate.analysis.metric_facts import Better, Resimulation, facts_of

PAPER_ANCHORS_MS = {"simulated": 75.0, "generated": 40.0}


def pareto_front(ms: np.ndarray, error: np.ndarray) -> np.ndarray:
    """Which points no other beats in both time and error.

    Parameters
    ----------
    ms, error : (n,) float
        Smaller is better in both.

    Returns
    -------
    (k,) int
        Indices of the front, by increasing time; of equal points the first.
    """
    order = np.lexsort((error, ms))
    best = np.minimum.accumulate(error[order])
    return order[np.concatenate(([True], best[1:] < best[:-1]))] if len(order) else order


def _panel(axes: Axes, points: pd.DataFrame, metric: str, floor: float | None) -> None:
    series = list(dict.fromkeys(points["series"]))
    for k, name in enumerate(series):
        of = points[points["series"] == name].sort_values("ms")
        style = "-" if len(of) > 1 else "none"
        marker = MARKERS[k % len(MARKERS)]
        axes.plot(
            of["ms"], of["error"], marker=marker, ls=style, ms=4, lw=0.7, color=colour_of(name, series), label=name
        )
        # Numbers label themselves beside their marker; words are tilted, or they run into each other.
        tilt = 0 if of["setting"].astype(str).str.isnumeric().all() else 40
        for point in of.to_dict("records"):
            where = (point["ms"], point["error"])
            offset: dict[str, Any] = {"xytext": (3, 3), "textcoords": "offset points", "rotation": tilt}
            axes.annotate(str(point["setting"]), where, fontsize=6, color="#333333", **offset)
    draw_background(axes, points["ms"].to_numpy(float), points["error"].to_numpy(float), metric, floor)


def draw_background(axes: Axes, ms: np.ndarray, error: np.ndarray, metric: str, floor: float | None) -> None:
    """Pareto front, re-simulation, the paper's anchors, and a logarithmic axis of time.

    Parameters
    ----------
    axes : Axes
    ms, error : (n,) float
        Of all points, for the front.
    metric : str
    floor : float or None
        Re-simulation's value.
    """
    sign = -1.0 if facts_of(metric).better is Better.larger else 1.0
    front = pareto_front(ms, sign * error)
    axes.step(ms[front], error[front], where="post", color="#BBBBBB", lw=3, zorder=0, label="Pareto front")
    if floor is not None:
        word = "floor" if facts_of(metric).resimulation is Resimulation.floor else "level"
        axes.axhline(floor, color=FLOOR_COLOUR, ls="--", lw=0.9, label=f"re-simulation ({word})")
    for (name, anchor), style in zip(PAPER_ANCHORS_MS.items(), (":", "-."), strict=True):
        label = f"paper, {name}: {anchor:.0f} ms, unknown GPU"
        axes.axvline(anchor, color="#999999", ls=style, lw=0.9, label=label)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.set_xlabel("median time, ms/frame")
    axes.set_ylabel(facts_of(metric).title)


def error_vs_runtime(
    points: pd.DataFrame, stem: Path, floors: dict[str, float] | None = None, hardware: str = ""
) -> list[Path]:
    """Scatter of error against milliseconds a frame, a panel a metric, with the Pareto front.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error (as `precision.csv`).
    stem : Path
        Path without suffix, for instance `error_vs_runtime`.
    floors : dict of str to float, optional
        Re-simulation's value by metric.
    hardware : str
        Device that the times were measured on; it is written on the figure.

    Returns
    -------
    list of Path
        PNG and PDF.

    Raises
    ------
    ValueError
        When a column is missing, or there is no finite point with a positive time.
    """
    missing = [name for name in ("series", "setting", "ms", "metric", "error") if name not in points.columns]
    if missing:
        raise ValueError(f"points lack the columns {missing}, they have {list(points.columns)}")
    points = points[np.isfinite(points["error"]) & np.isfinite(points["ms"]) & (points["ms"] > 0)]
    metrics = list(dict.fromkeys(points["metric"]))
    if not metrics:
        raise ValueError("no finite point with a positive time to draw")
    across = min(len(metrics), 2)
    down = -(-len(metrics) // across)
    with house_style():
        figure = new_figure(PAGE_IN if across == 2 else PAGE_IN * 0.62, 2.5 * down + 0.6)
        grid = figure.subplots(down, across, squeeze=False).ravel()
        for axes, metric in zip(grid, metrics, strict=False):
            _panel(axes, points[points["metric"] == metric], metric, (floors or {}).get(metric))
        for axes in grid[len(metrics) :]:
            axes.set_axis_off()
        handles: dict[str, Artist] = {}
        for axes in grid[: len(metrics)]:
            handles |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
        figure.legend(list(handles.values()), list(handles), loc="outside upper center", ncols=3, frameon=False)
        if hardware:
            figure.supxlabel(f"times measured on {hardware}", fontsize=7, color="#555555")
        return save_figure(figure, stem)
