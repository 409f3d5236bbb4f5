"""How the simulator's own settings converge: error against time, with the scatterers of the reference."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axis import Axis
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from ablate.analysis.figures.point_names import write_names
from ablate.analysis.figures.style import PAGE_IN, house_style, new_figure, one_legend, save_figure
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
_PANEL_IN = 2.7


def convergence_figure(points: pd.DataFrame, stem: Path, hardware: str = "") -> list[Path]:
    """Draw the error of each setting against its time, a panel a metric, on logarithmic axes; every point has its name.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error. Series that are not of `SERIES` are left out.
    stem : Path
        Of the files, without suffix.
    hardware : str
        The device that the times were measured on, written on the figure.

    Returns
    -------
    list of Path
        A PNG and a PDF.

    Raises
    ------
    ValueError
        If no finite point of these series has a positive time.
    """
    known = points["series"].isin(list(SERIES)) & np.isfinite(points["error"]) & (points["ms"] > 0)
    points = points[known]
    metrics = list(dict.fromkeys(points["metric"]))
    if not metrics:
        raise ValueError("no finite point of the simulator with a positive time to draw")
    across = min(len(metrics), 2)
    down = -(-len(metrics) // across)
    with house_style():
        figure = new_figure(PAGE_IN if across == 2 else PAGE_IN * 0.62, _PANEL_IN * down)
        grid = list(figure.subplots(down, across, squeeze=False).ravel())
        for axes in grid[len(metrics) :]:
            axes.set_axis_off()
        panels = [points[points["metric"] == metric] for metric in metrics]
        for axes, metric, own in zip(grid, metrics, panels, strict=False):
            for name, (colour, marker, line) in SERIES.items():
                of_series = own[own["series"] == name]
                style: dict[str, Any] = {"color": colour, "marker": marker, "ls": line, "ms": 4, "lw": 0.8}
                if len(of_series):
                    axes.plot(of_series["ms"], of_series["error"], label=name, **style)
            axes.set(xscale="log", xlabel="median time, ms a frame", ylabel=metric_of(metric).title)
            _plain_numbers(axes.xaxis)
            if (
                metric_of(metric).better is not Direction.higher and own["error"].min() > 0
            ):  # PSNR is a logarithm already
                axes.set_yscale("log")
                _plain_numbers(axes.yaxis)
            axes.margins(x=0.12, y=0.1)
        one_legend(figure, grid[: len(metrics)], 3)
        if hardware:
            figure.supxlabel(f"times measured on {hardware}", fontsize=7, color="#555555")
        figure.draw_without_rendering()  # so that the panels have their places
        for axes, own in zip(grid, panels, strict=False):
            once = own.drop_duplicates("error")  # the data set's own setting is in every series
            names = [named_setting(*pair) for pair in zip(once["series"], once["setting"], strict=True)]
            write_names(axes, names, once["ms"].to_numpy(float), once["error"].to_numpy(float))
        return save_figure(figure, stem)


def named_setting(series: str, setting: str) -> str:
    """How a setting of the simulator is called: `2 rays` of `rays` and `2`, or of `rays 2`; several have a comma."""
    what = series.removeprefix("simulator, ")
    parts = str(setting).split(", ")
    values = [part.rpartition(" ") if " " in part else (what, " ", part) for part in parts]
    return ", ".join(f"{value} {name.removesuffix('s') if value == '1' else name}" for name, _, value in values)


def _plain_numbers(axis: Axis) -> None:
    """Write a logarithmic axis in plain decimal numbers."""
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())
