"""The name of every point beside it, where there is room."""

from collections.abc import Iterator, Sequence

import numpy as np
from matplotlib.axes import Axes

_POINTS_HIGH = 6.0  # of the letters
_WIDTH = 0.58  # of a letter, in heights
_GAP = 4.0  # from a point to its name, points
_FARTHEST = 9  # times as far at most
_BESIDE = 8  # places that need no line to the point
Box = tuple[float, float, float, float]  # left, bottom, right, top, pixels


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
    places = axes.transData.transform(np.column_stack([x, y])) if len(names) else np.empty((0, 2))
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
