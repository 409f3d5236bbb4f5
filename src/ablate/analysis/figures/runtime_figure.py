"""Work against precision: how much worse than re-simulation renderers are, against the time of a frame."""

import textwrap
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter

from ablate.analysis.components import Component
from ablate.analysis.figures.point_names import figure_of_points
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure
from ablate.analysis.figures.style import baseline_line, colour_of, shown_name
from ablate.analysis.results import StudyResults
from ablate.analysis.scored import BASELINE_NAMES
from ablate.analysis.statistics.work_precision import pareto_front, runtime_points
from ablate.metrics import Direction, Metric, metric_of
from ablate.metrics.metric import BOUNDS

#: Begins the names of the simulator's settings, with scatterers of their own as a network has.
SIMULATOR = "simulator"
SIMULATOR_COLOUR = "#888888"
#: Columns that points may have: the ends of an interval over frames of how much worse than re-simulation one is.
WORSE_BOUNDS = ("worse_lower", "worse_upper")
_FARTHEST = 2.5  # times the largest of the simulator's: what is worse is told in words
_LINEAR_UP_TO = 100  # times the shortest time: beyond that the axis of times is logarithmic
_TITLE_LETTERS = 60  # of a line above a panel
_AXIS_LETTERS = 38  # of a line beside it, with its unit


def error_vs_runtime(
    points: pd.DataFrame,
    stem: Path,
    floors: Mapping[str, float] | None = None,
    hardware: str = "",
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw how much worse than re-simulation renderers are that do not know the scatterers, a panel a metric.

    Every point has its name, and the grey line is the Pareto front. Axes are linear, but that of times is logarithmic
    beyond a factor of `_LINEAR_UP_TO`.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error: a row a renderer and a metric. Both of the first two are its name;
        a series that begins with `SIMULATOR` is named by its setting alone. Columns lower and upper, where they are,
        are the spread of the times, and a difference within it puts no point on the front. Those of `WORSE_BOUNDS` are
        the interval of the ordinate over frames.
    stem : Path
        Of the files, without suffix.
    floors : mapping of str to float, optional
        The re-simulation's value by metric; without a finite one, and of a metric that does not judge, the error itself
        is drawn.
    hardware : str
        The device that the times were measured on, written on the figure.
    components : sequence of Component
        Changes of these are written in short.

    Raises
    ------
    ValueError
        If no finite point has a positive time.
    """
    points = points[np.isfinite(points["error"]) & np.isfinite(points["ms"]) & (points["ms"] > 0)]
    names = {name: shown_name(name, components) for name in points["series"] if not name.startswith(SIMULATOR)}
    known = {metric: floor for metric, floor in (floors or {}).items() if np.isfinite(floor)}

    def draw(axes: Axes, of_metric: pd.DataFrame, metric: str) -> tuple[list[str], np.ndarray, np.ndarray]:
        return _draw_panel(axes, of_metric, metric, known.get(metric), names)

    return figure_of_points(points, draw, stem, hardware)


def _draw_panel(
    axes: Axes, points: pd.DataFrame, metric: str, floor: float | None, names: Mapping[str, str]
) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Draw every point of one metric; returns their names, (n,), and places, (n,) each."""
    judge = metric_of(metric)
    relative = floor is not None and judge.better in (Direction.lower, Direction.higher)
    badness = np.array([judge.badness(value) for value in points["error"]])
    points = points.assign(
        y=badness - judge.badness(float(floor or 0.0)) if relative else points["error"],
        badness=badness,
        name=[_name(point, names) for point in points.to_dict("records")],
        simulated=points["series"].str.startswith(SIMULATOR),
    )
    within = points["y"] <= (_end_of_axis(points) if relative else np.inf)
    shown, beyond = points[within], points[~within]
    for point in shown.to_dict("records"):
        colour = SIMULATOR_COLOUR if point["simulated"] else _colour_of(point["series"], list(names))
        _draw_spread(axes, point, colour, relative)
        marker = "x" if point["simulated"] else "o"
        axes.plot(point["ms"], point["y"], ls="none", color=colour, ms=4.5, marker=marker)
    ms, y = (shown[name].to_numpy(dtype=np.float64) for name in ("ms", "y"))
    if judge.better is not Direction.none:
        spread = [shown[side].to_numpy(dtype=np.float64) for side in BOUNDS if side in shown]
        front = pareto_front(ms, shown["badness"].to_numpy(), *spread)
        axes.step(ms[front], y[front], where="post", color="#CCCCCC", lw=3, zorder=0, label="Pareto front")
    if floor is not None:
        axes.axhline(0.0 if relative else floor, lw=0.9, **baseline_line(metric))
    if len(beyond):
        values = [f"{point['name']}: {point['y']:+.{judge.decimals}f}" for point in beyond.to_dict("records")]
        lines = textwrap.fill("beyond the axis: " + "; ".join(values), _TITLE_LETTERS)
        axes.set_title(lines, fontsize=6, color="#555555")
    axes.set(xlabel="median time, ms a frame", ylabel=_ordinate(judge, relative))
    if len(ms) and ms.max() > _LINEAR_UP_TO * ms.min():
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:,.0f}")
        axes.xaxis.set_minor_formatter(NullFormatter())
    else:
        axes.set_xlim(left=0.0)
    axes.margins(x=0.15, y=0.1)
    return list(shown["name"]), ms, y


def _end_of_axis(points: pd.DataFrame) -> float:
    """The ordinate beyond which renderers are told in words: it leaves all of the simulator's on the axis."""
    simulated = points.loc[points["simulated"], "y"]
    return max(simulated.max(), _FARTHEST * simulated.max()) if len(simulated) else np.inf  # all may lie below zero


def _ordinate(judge: Metric, relative: bool) -> str:
    """The title of the ordinate, a long one with its unit on a second line."""
    side = "below" if judge.better is Direction.higher else "above"
    name = f"{judge.label} {side} re-simulation" if relative else judge.label
    if not judge.unit:
        return name
    title = f"{name} ({judge.unit})"
    return title if len(title) <= _AXIS_LETTERS else f"{name}\n({judge.unit})"


def _name(point: Mapping[Any, Any], names: Mapping[str, str]) -> str:
    """What a point is called: its series and its setting; of the simulator its setting alone."""
    return ", ".join(filter(None, [names.get(str(point["series"]), ""), str(point["setting"])]))


def _colour_of(name: str, names: Sequence[str]) -> str:
    return "#444444" if name in BASELINE_NAMES else colour_of(name, [one for one in names if one not in BASELINE_NAMES])


def _draw_spread(axes: Axes, point: Mapping[Any, Any], colour: str, relative: bool) -> None:
    """The spread of a point's time and the interval of its error, where they are known."""
    style: dict[str, Any] = {"color": colour, "lw": 0.8, "zorder": 1}
    sides = [point.get(side, np.nan) for side in BOUNDS]
    if np.isfinite(sides).all():
        axes.plot(sides, [point["y"]] * 2, **style)
    ends = [point.get(side, np.nan) for side in WORSE_BOUNDS]
    if relative and np.isfinite(ends).all():
        axes.plot([point["ms"]] * 2, ends, **style)


def _of_study(results: StudyResults, folder: Path) -> Iterator[Drawing]:
    points, floors = runtime_points(results.table)
    if np.isfinite(points["error"]).any():
        files = error_vs_runtime(points, folder / "error_vs_runtime", floors, results.machine, results.components)
        yield Drawing(files, metrics=list(dict.fromkeys(points["metric"])))


RUNTIME = StudyFigure(name="error_vs_runtime", section=Section.figures, draw=_of_study, place=60)
