"""A panel a metric of points against time, with the name of every point beside it, where there is room."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ablate.analysis.figures.style import PAGE_IN, house_style, new_figure, one_legend, save_figure

_PANEL_IN = 2.9
_POINTS_HIGH = 6.0  # of the letters
_WIDTH = 0.58  # of a letter, in heights
_GAP = 4.0  # from a point to its name, points
_FARTHEST = 9  # times as far at most
_BESIDE = 8  # places that need no line to the point
Box = tuple[float, float, float, float]  # left, bottom, right, top, pixels
Draw = Callable[[Axes, pd.DataFrame, str], tuple[Sequence[str], np.ndarray, np.ndarray]]


def figure_of_points(points: pd.DataFrame, draw: Draw, stem: Path, hardware: str) -> list[Path]:
    """Draw a panel a metric, two side by side, and write the names of its points; returns a PNG and a PDF.

    Parameters
    ----------
    points : DataFrame
        With a column metric; those that have no place are left out before.
    draw : callable
        Draws the points of a metric; gives their names, (n,), and places, (n,) each, in units of the axes.
    stem : Path
        Of the files, without suffix.
    hardware : str
        The device that the times were measured on, written on the figure; empty for none.
    """
    metrics = list(dict.fromkeys(points["metric"]))
    if not metrics:
        raise ValueError("no finite point with a positive time to draw")
    across = min(len(metrics), 2)
    down = -(-len(metrics) // across)
    with house_style():
        figure = new_figure(PAGE_IN if across == 2 else PAGE_IN * 0.62, _PANEL_IN * down)
        grid = list(figure.subplots(down, across, squeeze=False).ravel())
        for axes in grid[len(metrics) :]:
            axes.set_axis_off()
        drawn = [draw(axes, points[points["metric"] == m], m) for axes, m in zip(grid, metrics, strict=False)]
        one_legend(figure, grid[: len(metrics)])
        if hardware:
            figure.supxlabel(f"times measured on {hardware}", fontsize=7, color="#555555")
        figure.draw_without_rendering()  # so that the panels have their places
        for axes, (names, x, y) in zip(grid, drawn, strict=False):
            write_names(axes, names, x, y)
        return save_figure(figure, stem)


def write_names(axes: Axes, names: Sequence[str], x: np.ndarray, y: np.ndarray) -> None:
    """Write the names of points beside them so that they overlap neither each other nor a point, if there is room.

    Parameters
    ----------
    axes : Axes
        Whose place in the figure and whose limits are final.
    names : sequence of str
        (n,).
    x, y : (n,) float
        The points, in units of the axes.
    """
    places = axes.transData.transform(np.column_stack([x, y]))
    scale = axes.figure.dpi / 72
    taken: list[Box] = [_around(place, 2.5 * scale) for place in places]
    inside = axes.get_window_extent()
    limits = inside.x0, inside.y0, inside.x1, inside.y1
    for k in np.lexsort([places[:, 1], places[:, 0]]):
        width, height = len(names[k]) * _WIDTH * _POINTS_HIGH * scale, 1.25 * _POINTS_HIGH * scale
        offsets = list(_offsets(_GAP * scale, width, height))
        boxes = [(a := places[k][0] + dx, b := places[k][1] + dy, a + width, b + height) for dx, dy in offsets]
        cost = [sum(_overlap(box, other) for other in taken) + _outside(box, limits) for box in boxes]
        best = int(np.argmin(cost))
        taken.append(boxes[best])
        axes.annotate(
            names[k],
            (x[k], y[k]),
            tuple(np.array(offsets[best]) / scale),
            textcoords="offset points",
            fontsize=_POINTS_HIGH,
            color="#333333",
            arrowprops={"arrowstyle": "-", "lw": 0.4, "color": "#999999"} if best >= _BESIDE else None,
            annotation_clip=False,
        ).set_in_layout(False)


def _offsets(gap: float, width: float, height: float) -> Iterator[tuple[float, float]]:
    """Places of a name's lower left corner about a point, the nearest first: right, left, above and below."""
    for times in range(1, _FARTHEST + 1):
        for rise in (0.0, *(sign * times * height / 2 for sign in (1, -1))):
            yield times * gap, rise - height / 2
            yield -times * gap - width, rise - height / 2
        yield -width / 2, times * gap
        yield -width / 2, -times * gap - height


def _around(place: np.ndarray, half: float) -> Box:
    return place[0] - half, place[1] - half, place[0] + half, place[1] + half


def _overlap(one: Box, other: Box) -> float:
    """The area that two boxes share, square pixels."""
    width = min(one[2], other[2]) - max(one[0], other[0])
    height = min(one[3], other[3]) - max(one[1], other[1])
    return max(width, 0.0) * max(height, 0.0)


def _outside(box: Box, limits: Box) -> float:
    """The area of a box beyond limits, square pixels."""
    return (box[2] - box[0]) * (box[3] - box[1]) - _overlap(box, limits)
