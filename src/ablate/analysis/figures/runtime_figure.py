"""Work against precision: error against time, of networks and of the simulator beside them."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from ablate.analysis.components import Component
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure
from ablate.analysis.figures.style import (
    PAGE_IN,
    baseline_line,
    colour_of,
    house_style,
    legend_entries,
    new_figure,
    save_figure,
    shown_name,
)
from ablate.analysis.results import StudyResults
from ablate.analysis.statistics.work_precision import pareto_front, runtime_points
from ablate.metrics import Direction, metric_of
from ablate.metrics.metric import BOUNDS

PAPER_ANCHORS_MS = {"simulated": 75.0, "generated": 40.0}
# The simulator with speckle of its own, as a generator has: only this series compares fairly with a trained run.
OTHER_SPECKLE = "simulator, other scatterers"
# Series of the simulator: colour, marker, line and size. All others are trained runs.
SIMULATOR: dict[str, tuple[str, str, str, float]] = {
    "simulator, rays": ("#000000", "o", "-", 3.5),
    "simulator, layers": ("#666666", "s", "none", 4.0),
    "simulator, scanlines": ("#666666", "^", "none", 4.5),
    "simulator, axial samples": ("#666666", "v", "none", 4.5),
    OTHER_SPECKLE: ("#AAAAAA", "x", "none", 3.5),
}
# Of these the first and the last setting is written beside its point.
_LABELLED = ("simulator, rays", "simulator, layers", "simulator, scanlines")
_RUN_MARKERS = ("D", "P", "X", "*", "h", "<", ">", "d", "p", "8")
_ENGINE_FILL = {"eager": "none", "exported": "full"}
_LOGARITHMIC_FROM = 5.0  # ratio of the largest error to the smallest


def error_vs_runtime(
    points: pd.DataFrame,
    stem: Path,
    floors: Mapping[str, float] | None = None,
    hardware: str = "",
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw error against time, a panel a metric, with the Pareto front, re-simulation and the paper's times.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error (as `precision.csv`). The keys of `SIMULATOR` are the simulator's
        series, all others are trained runs. Columns lower and upper, where they are, are the spread of the times, and a
        difference within it puts no point on the front.
    stem : Path
        Of the files, without suffix.
    floors : mapping of str to float, optional
        The re-simulation's value by metric.
    hardware : str
        The device that the times were measured on, written on the figure.
    components : sequence of Component
        Changes of these are written in short.

    Returns
    -------
    list of Path
        A PNG and a PDF.

    Raises
    ------
    ValueError
        If no finite point has a positive time.
    """
    points = points[np.isfinite(points["error"]) & np.isfinite(points["ms"]) & (points["ms"] > 0)]
    metrics = list(dict.fromkeys(points["metric"]))
    if not metrics:
        raise ValueError("no finite point with a positive time to draw")
    across = min(len(metrics), 2)
    free_cells = -len(metrics) % across
    cells = metrics + ["legend"] * free_cells
    rows = [cells[k : k + across] for k in range(0, len(cells), across)]
    runs = {name: shown_name(name, components) for name in points["series"] if name not in SIMULATOR}
    with house_style():
        legend_in = 0.0 if free_cells else 0.6
        figure = new_figure(PAGE_IN if across == 2 else PAGE_IN * 0.62, 2.3 * len(rows) + legend_in)
        grid = figure.subplot_mosaic(rows)
        for metric in metrics:
            floor = None if floors is None else floors.get(metric)
            _draw_panel(grid[metric], points[points["metric"] == metric], metric, floor, runs)
        handles = legend_entries([grid[metric] for metric in metrics])
        settings = points.loc[points["series"].isin(list(runs)), "setting"]
        for engine in _ENGINE_FILL:  # what a marker's fill means comes last
            if settings.str.contains(engine).any():
                handles[f"run, {engine}"] = Line2D([], [], ls="none", **_marker("#555555", "D", engine))
        style: dict[str, Any] = {"frameon": False, "handlelength": 1.5, "columnspacing": 1.0}
        if free_cells:
            grid["legend"].set_axis_off()
            grid["legend"].legend(handles.values(), handles.keys(), loc="center", ncols=2, fontsize=6, **style)
        else:
            figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=across + 1, **style)
        if hardware:
            figure.supxlabel(f"times measured on {hardware}", fontsize=7, color="#555555")
        return save_figure(figure, stem)


def _marker(colour: str, marker: str, engine: str) -> dict[str, Any]:
    return {"marker": marker, "color": colour, "ms": 5, "mew": 0.8, "fillstyle": _ENGINE_FILL[engine]}


def _draw_panel(axes: Axes, points: pd.DataFrame, metric: str, floor: float | None, runs: Mapping[str, str]) -> None:
    """Every point of one metric; `runs` has the shown name of every trained run."""
    for name in SIMULATOR:
        _draw_simulator(axes, points[points["series"] == name], name)
    for number, name in enumerate(runs):
        marker = _RUN_MARKERS[number % len(_RUN_MARKERS)]
        _draw_run(axes, points[points["series"] == name], runs[name], colour_of(name, list(runs)), marker)
    error = points["error"].to_numpy(dtype=np.float64)
    decibels = metric_of(metric).better is Direction.higher  # PSNR is a logarithm already
    if not decibels and error.min() > 0 and error.max() > _LOGARITHMIC_FROM * error.min():
        axes.set_yscale("log")
        _plain_numbers(axes.yaxis)
    fair = points[points["series"].isin([*runs, OTHER_SPECKLE])]
    _draw_front(axes, points if fair.empty else fair, metric)
    if floor is not None:
        axes.axhline(floor, lw=0.9, **baseline_line(metric))
    for (name, anchor), line in zip(PAPER_ANCHORS_MS.items(), (":", "-."), strict=True):
        axes.axvline(anchor, color="#999999", ls=line, lw=0.9, label=f"paper, {name}: {anchor:.0f} ms, unknown GPU")
    axes.set(xscale="log", xlabel="median time, ms/frame", ylabel=metric_of(metric).title)
    _plain_numbers(axes.xaxis)


def _draw_simulator(axes: Axes, points: pd.DataFrame, name: str) -> None:
    """One series of the simulator, with the first and the last setting where these are written."""
    if points.empty:
        return
    colour, marker, line, size = SIMULATOR[name]
    style: dict[str, Any] = {"marker": marker, "ls": line, "ms": size, "lw": 0.8, "color": colour, "label": name}
    axes.plot(points["ms"], points["error"], **style)
    if name in _LABELLED:
        for _, end in points.iloc[[0, -1]].iterrows():
            shift: dict[str, Any] = {"xytext": (4, 3), "textcoords": "offset points"}
            axes.annotate(str(end["setting"]), (end["ms"], end["error"]), fontsize=6, color=colour, **shift)


def _draw_run(axes: Axes, points: pd.DataFrame, label: str, colour: str, marker: str) -> None:
    """The points of one trained run, with the spread of their times where it is known."""
    for point in points.to_dict("records"):
        engine = next((name for name in _ENGINE_FILL if name in str(point["setting"])), "exported")
        if "lower" in point:
            span = [[point["ms"] - point["lower"]], [point["upper"] - point["ms"]]]
            axes.errorbar(point["ms"], point["error"], xerr=span, color=colour, lw=0.8, capsize=1.5)
        axes.plot(point["ms"], point["error"], ls="none", label=label, **_marker(colour, marker, engine))


def _draw_front(axes: Axes, points: pd.DataFrame, metric: str) -> None:
    """The Pareto front of these points, where the metric says what is better."""
    judge = metric_of(metric)
    if judge.better is Direction.none:
        return
    ms = points["ms"].to_numpy(dtype=np.float64)
    error = points["error"].to_numpy(dtype=np.float64)
    spread = [points[side].to_numpy(dtype=np.float64) for side in BOUNDS if side in points]
    front = pareto_front(ms, np.array([judge.badness(value) for value in error]), *spread)
    axes.step(ms[front], error[front], where="post", color="#BBBBBB", lw=3, zorder=0, label="Pareto front")


def _plain_numbers(axis: Axis) -> None:
    """Write a logarithmic axis in plain decimal numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())


def _of_study(results: StudyResults, folder: Path) -> Iterator[Drawing]:
    points, floors = runtime_points(results.table)
    if len(points):
        files = error_vs_runtime(points, folder / "error_vs_runtime", floors, results.machine, results.components)
        yield Drawing(files, metrics=list(dict.fromkeys(points["metric"])))


RUNTIME = StudyFigure(name="error_vs_runtime", section=Section.figures, draw=_of_study, place=60)
