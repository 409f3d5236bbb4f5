"""Rows with names at the left and one panel a metric: the frame of every figure that compares variants or effects."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ablate.analysis.components import Component
from ablate.analysis.figures.style import COLUMN_IN, FLOOR_COLOUR, PAGE_IN, new_figure
from ablate.metrics import Direction, Resimulation, metric_of

ROW_IN, HEAD_IN, LEGEND_IN = 0.19, 0.55, 0.25
HINTS = {Direction.higher: "better →", Direction.lower: "← better", Direction.zero: "0 is right", Direction.none: ""}


def metric_panels(
    metrics: Sequence[str], rows: Sequence[str], across: int, row_in: float = ROW_IN, head_in: float = HEAD_IN
) -> tuple[Figure, list[Axes]]:
    """An empty figure with one axes a metric, `across` side by side, and the shown names of rows from top to bottom.

    Row k lies at the ordinate `len(rows) - k`. A row takes `row_in` inches, a panel's title `head_in`.
    """
    across = min(across, len(metrics))
    down = -(-len(metrics) // across)
    width = PAGE_IN if across > 1 else COLUMN_IN
    legend_in = LEGEND_IN * (1 if across > 1 else 2)  # its entries stand below each other in a narrow figure
    figure = new_figure(width, legend_in + down * (head_in + row_in * max(len(rows), 2)))
    grid = figure.subplots(down, across, squeeze=False, sharey=True).ravel()
    for axes in grid[len(metrics) :]:
        axes.set_axis_off()
    places = range(len(rows), 0, -1)
    for axes in grid[: len(metrics)]:
        axes.set_yticks(places, rows)
        axes.set_ylim(0.4, len(rows) + 0.6)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.tick_params(axis="y", length=0)
        for place in places:
            axes.axhline(place, color="#EEEEEE", lw=0.5, zorder=0)
    return figure, list(grid[: len(metrics)])


def shown_name(label: str, components: Sequence[Component] = ()) -> str:
    """A label as it is written on a figure: `sa2h.concat-input.depth-6` becomes `sa2h −concat depth 6`.

    What was changed beside a variant is written in short where it is one of the components.
    """
    variant, *changes = re.split(r"\.(?=[a-z])", label)
    return " ".join([variant, *(_shown_change(change, components) for change in changes)])


def _shown_change(change: str, components: Sequence[Component]) -> str:
    key, _, level = change.partition("-")
    for component in components:
        if component.key.rpartition(".")[2] != key:
            continue
        if isinstance(component.off, int | float):  # which number stands for "off" follows from the frame size
            return f"{key} {level}"
        if level == str(component.off):
            return (
                f"−{component.name}" if "." in component.key else f"+ {level}"
            )  # of a whole group nothing is left out
    return f"+ {change}"


def axis_title(metric: str, shown: str = "{}") -> str:
    """Name of a metric within `shown` (`Δ {} to sa2h`), and on a line below its unit and which way is better."""
    entry = metric_of(metric)
    hint = "" if entry.better is Direction.zero and shown != "{}" else HINTS[entry.better]
    return f"{shown.format(entry.label)}\n{', '.join(filter(None, (entry.unit, hint)))}"


def resimulation_word(metric: str) -> str:
    """`floor` or `level`: what the re-simulation is for a metric."""
    return "floor" if metric_of(metric).resimulation is Resimulation.floor else "level"


def resimulation_line(metric: str, name: str = "re-simulation") -> dict[str, Any]:
    """How a figure draws the re-simulation: dashed for a floor, dotted for a level, as one entry of the legend."""
    style = {"floor": "--", "level": ":"}[resimulation_word(metric)]
    return {"color": FLOOR_COLOUR, "ls": style, "label": f"{name} (dashed: floor, dotted: level)"}


def draw_resimulation(axes: Axes, metric: str, value: float, name: str = "re-simulation") -> None:
    """Draw the re-simulation as a vertical line where it is finite."""
    if np.isfinite(value):
        axes.axvline(value, lw=1.0, zorder=1, **resimulation_line(metric, name))


def one_legend(figure: Figure, panels: Sequence[Axes], columns: int = 4) -> None:
    """One legend above all panels, each entry once."""
    entries = legend_entries(panels)
    if entries:
        handles, labels = list(entries.values()), list(entries)
        figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False, handlelength=1.6)


def legend_entries(panels: Sequence[Axes]) -> dict[str, Artist]:
    """What the legends of these panels would show, each entry once."""
    entries: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    return entries
