"""How the simulator's own settings converge: error against time, with the scatterers of the reference."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from ablate.analysis.figures.point_names import figure_of_points
from ablate.metrics import Direction, metric_of

#: Series of the simulator: colour, marker and line.
SERIES = {
    "simulator, rays": ("#0072B2", "o", "-"),
    "simulator, layers": ("#D55E00", "s", "none"),
    "simulator, scanlines": ("#009E73", "^", "none"),
    "simulator, axial samples": ("#CC79A7", "v", "none"),
    "simulator, compound angles": ("#56B4E9", "P", "none"),
    "simulator, combined": ("#000000", "D", "none"),
}


def convergence_figure(points: pd.DataFrame, stem: Path, hardware: str = "") -> list[Path]:
    """Draw the error of each setting against its time, a panel a metric, on logarithmic axes; every point has its name.

    `points` has columns series, setting, ms, metric, error; series that are not of `SERIES` are left out. The files are
    at `stem`, a path without suffix. `hardware`, written on the figure, is the device that the times were measured on.
    It is a ValueError if no finite point of these series has a positive time.
    """
    known = points["series"].isin(list(SERIES)) & np.isfinite(points["error"]) & (points["ms"] > 0)
    return figure_of_points(points[known], _draw_panel, stem, hardware)


def _draw_panel(axes: Axes, points: pd.DataFrame, metric: str) -> tuple[list[str], np.ndarray, np.ndarray]:
    for name, (colour, marker, line) in SERIES.items():
        chosen = points[points["series"] == name]
        style: dict[str, Any] = {"color": colour, "marker": marker, "ls": line, "ms": 4, "lw": 0.8}
        if len(chosen):
            axes.plot(chosen["ms"], chosen["error"], label=name, **style)
    judge = metric_of(metric)
    axes.set(xscale="log", xlabel="median time, ms a frame", ylabel=judge.title)
    _plain_numbers(axes.xaxis)
    if judge.better is not Direction.higher and points["error"].min() > 0:  # PSNR is a logarithm already
        axes.set_yscale("log")
        _plain_numbers(axes.yaxis)
    axes.margins(x=0.12, y=0.1)
    once = points.drop_duplicates("error")  # the data set's own setting is in every series
    names = [named_setting(*pair) for pair in zip(once["series"], once["setting"], strict=True)]
    return names, once["ms"].to_numpy(float), once["error"].to_numpy(float)


def named_setting(series: str, setting: str) -> str:
    """How a setting of the simulator is called: `2 rays` of `rays` and `2`, or of `rays 2`; several have a comma."""
    what = series.removeprefix("simulator, ")
    parts = str(setting).split(", ")
    values = [part.rpartition(" ") if " " in part else (what, " ", part) for part in parts]
    named = [(name.removeprefix("compound "), value) for name, _, value in values]
    return ", ".join(f"{value} {name.removesuffix('s') if value == '1' else name}" for name, value in named)


def _plain_numbers(axis: Axis) -> None:
    """Write a logarithmic axis in plain decimal numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())
