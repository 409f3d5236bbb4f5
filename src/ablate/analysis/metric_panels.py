"""Rows with names at the left and one panel a metric: the frame of every figure that compares variants or effects."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ablate.analysis.figure_style import COLUMN_IN, FLOOR_COLOUR, PAGE_IN, new_figure
from ablate.analysis.metric_facts import RESIMULATION, Better, Resimulation, facts_of

ROW_IN, HEAD_IN, LEGEND_IN = 0.19, 0.55, 0.25
SHORT = {
    "attenuation-none": "−att",
    "concat-input": "−concat",
    "upsampling-transposed": "−conv",
    "noise-input": "−noise",
    "depth-8": "−depth",
    "encoding-arbitrary": "+ arbitrary",
}
HINTS = {Better.larger: "better →", Better.smaller: "← better", Better.nearest_zero: "0 is right", Better.unjudged: ""}


def metric_panels(
    metrics: Sequence[str], rows: Sequence[str], across: int, row_in: float = ROW_IN, head_in: float = HEAD_IN
) -> tuple[Figure, list[Axes]]:
    """An empty figure with a panel a metric, the names of the rows beside the first of every line of panels.

    Parameters
    ----------
    metrics : sequence of str
    rows : sequence of str
        From top to bottom.
    across : int
        Panels side by side.
    row_in : float
        Height of a row, inches.
    head_in : float
        Room below a panel for its title, inches.

    Returns
    -------
    Figure
    list of Axes
        One a metric; row k lies at `place_of(k, len(rows))`.
    """
    across = min(across, len(metrics))
    down = -(-len(metrics) // across)
    width = PAGE_IN if across > 1 else COLUMN_IN
    legend_in = LEGEND_IN * (1 if across > 1 else 2)  # its entries stand below each other in a narrow figure
    figure = new_figure(width, legend_in + down * (head_in + row_in * max(len(rows), 2)))
    grid = figure.subplots(down, across, squeeze=False, sharey=True).ravel()
    for axes in grid[len(metrics) :]:
        axes.set_axis_off()
    places = [place_of(k, len(rows)) for k in range(len(rows))]
    for axes in grid[: len(metrics)]:
        axes.set_yticks(places, [shown_name(name) for name in rows])
        axes.set_ylim(0.4, len(rows) + 0.6)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.tick_params(axis="y", length=0)
        for place in places:
            axes.axhline(place, color="#EEEEEE", lw=0.5, zorder=0)
    return figure, list(grid[: len(metrics)])


def place_of(row: int, rows: int) -> int:
    """Ordinate of a row, the first at the top.

    Parameters
    ----------
    row, rows : int

    Returns
    -------
    int
    """
    return rows - row


def shown_name(label: str) -> str:
    """A label as it is written on a figure, with what was changed beside the variant in few letters.

    Parameters
    ----------
    label : str
        As `sa2h.concat-input.depth-8`.

    Returns
    -------
    str
        As `sa2h −concat −depth`.
    """
    variant, *changes = re.split(r"\.(?=[a-z])", label)
    return " ".join([variant, *(SHORT.get(change, f"+ {change}") for change in changes)])


def axis_title(metric: str, shown: str = "{}") -> str:
    """Name of a metric, and on a line below its unit and which way is better.

    Parameters
    ----------
    metric : str
    shown : str
        What is shown of it, for instance `Δ {} to sa2h`.

    Returns
    -------
    str
    """
    facts = facts_of(metric)
    hint = "" if facts.better is Better.nearest_zero and shown != "{}" else HINTS[facts.better]
    return f"{shown.format(facts.label)}\n{', '.join(filter(None, (facts.unit, hint)))}"


def resimulation_word(metric: str) -> str:
    """`floor` or `level`: what the re-simulation is for a metric.

    Parameters
    ----------
    metric : str

    Returns
    -------
    str
    """
    return "floor" if facts_of(metric).resimulation is Resimulation.floor else "level"


def draw_resimulation(axes: Axes, metric: str, value: float, name: str = "re-simulation") -> None:
    """The re-simulation as a line: dashed for a floor, dotted for a level.

    Parameters
    ----------
    axes : Axes
    metric : str
    value : float
        Nothing is drawn where it is not finite.
    name : str
        What the legend calls it.
    """
    if np.isfinite(value):
        word = resimulation_word(metric)
        style = {"floor": "--", "level": ":"}[word]
        axes.axvline(value, color=FLOOR_COLOUR, ls=style, lw=1.0, zorder=1, label=f"{name} ({word})")


def one_legend(figure: Figure, panels: Sequence[Axes], columns: int = 4) -> None:
    """One legend above all panels, each entry once.

    Parameters
    ----------
    figure : Figure
    panels : sequence of Axes
    columns : int
    """
    entries: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries.setdefault(label, handle)
    if entries:
        handles, labels = list(entries.values()), list(entries)
        figure.legend(handles, labels, loc="outside upper center", ncols=columns, frameon=False, handlelength=1.6)


def resimulation_means(values: pd.DataFrame) -> dict[str, float]:
    """Mean of the re-simulation by metric.

    Parameters
    ----------
    values : DataFrame
        Columns variant, metric, value.

    Returns
    -------
    dict of str to float
    """
    of = values[(values["variant"] == RESIMULATION) & np.isfinite(values["value"])]
    return {str(metric): float(mean) for metric, mean in of.groupby("metric")["value"].mean().items()}
