"""The figure of convergence: how the simulator's errors fall with more rays and with finer grids."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, NullLocator

from ablate.analysis.figures.runtime_figure import SIMULATOR, plain_numbers
from ablate.analysis.figures.style import COLOURS, FLOOR_COLOUR, PAGE_IN, house_style, new_figure, save_figure
from ablate.analysis.statistics.work_precision import observed_order
from ablate.metrics import metric_of

_LEVEL = "other scatterers"  # the row of a grid that is the level of re-simulation


def order_figure(points: pd.DataFrame, grids: pd.DataFrame, base: dict[str, int], stem: Path) -> list[Path]:
    """Draw how errors fall: with rays, beside n^(-1/2), and with each grid, beside another draw of the speckle.

    The files are a PNG and a PDF at `stem`, a path without suffix.

    Parameters
    ----------
    points : DataFrame
        Of the series `simulator, rays`: columns setting, metric, error.
    grids : DataFrame
        Columns series, setting (`other scatterers` for the level), quantity (the metric), value.
    base : dict of str to int
        The data set's value by series.
    """
    with house_style():
        figure = new_figure(PAGE_IN, 2.9)
        left, right = figure.subplots(1, 2)
        _rays_panel(left, points)
        _grids_panel(right, grids, base)
        return save_figure(figure, stem)


def _rays_panel(axes: Axes, points: pd.DataFrame) -> None:
    """Draw errors relative to that of one ray, so that all lines start at 1."""
    styles = zip(("o", "s", "^", "v", "D"), ("-", "--", "-.", ":", "-"), COLOURS, strict=False)
    for metric, (marker, line, colour) in zip(dict.fromkeys(points["metric"]), styles, strict=False):
        drawn = points[points["metric"] == metric]
        rays, error = drawn["setting"].astype(int).to_numpy(), drawn["error"].to_numpy(float)
        fit = observed_order(rays, error, metric)
        if metric == "psnr":
            error = 10 ** (-error / 20)
        if fit is None or not error[0] > 0:
            continue
        name = "RMS error of the image" if metric == "psnr" else metric_of(metric).label
        label = f"{name}: p = {fit.order:.2f}"
        axes.loglog(rays, error / error[0], marker=marker, ls=line, ms=3.5, lw=0.8, color=colour, label=label)
    rays = np.array([1.0, float(points["setting"].astype(int).max())])
    axes.loglog(rays, rays**-0.5, color="#BBBBBB", lw=3, zorder=0, label="$n^{-1/2}$")
    _powers_of_two(axes)
    plain_numbers(axes.yaxis)
    axes.set_xlabel("rays of a scanline and layer, n")
    axes.set_ylabel("error over that of one ray")
    axes.legend(frameon=False, fontsize=6.5)


def _grids_panel(axes: Axes, table: pd.DataFrame, base: dict[str, int]) -> None:
    """Draw patch chi-square and smooth MAE relative to those of other scatterers on the finest grid."""
    for k, name in enumerate(dict.fromkeys(table["series"])):
        marker = SIMULATOR[name][1]
        for metric, line in (("mae_smooth", "-"), ("pchi2", ":")):
            errors = table[(table["series"] == name) & (table["quantity"] == metric)].set_index("setting")["value"]
            if _LEVEL not in errors.index or not errors[_LEVEL] > 0:
                continue
            level = errors.pop(_LEVEL)
            values = np.array([int(v) for v in errors.index]) / base[name]
            label = f"{name.removeprefix('simulator, ')}, {metric_of(metric).label}"
            style: dict[str, Any] = {"marker": marker, "ls": line, "ms": 3.5, "lw": 0.8, "color": COLOURS[k]}
            axes.loglog(values, errors.to_numpy(float) / level, label=label, **style)
    axes.axhline(1.0, color=FLOOR_COLOUR, ls="--", lw=0.9)
    where: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "xytext": (0, -8), "textcoords": "offset points"}
    axes.annotate("another draw of the speckle", (0.02, 1.0), fontsize=6.5, color=FLOOR_COLOUR, **where)
    _powers_of_two(axes)
    plain_numbers(axes.yaxis, (1.0, 1.5, 2.0, 3.0, 5.0))
    axes.set_xlabel("number over the data set's")
    axes.set_ylabel("error to a finer grid over re-simulation")
    axes.legend(frameon=False, fontsize=6.5)


def _powers_of_two(axes: Axes) -> None:
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_locator(NullLocator())
