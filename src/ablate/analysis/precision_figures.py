"""Figures of error against run time: the work-precision diagram, how errors fall, and where the time goes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter, NullLocator

from ablate.analysis.figure_style import COLOURS, FLOOR_COLOUR, PAGE_IN, house_style, new_figure, save_figure
from ablate.analysis.metric_facts import RESIMULATION, Better, facts_of
from ablate.analysis.runtime_figure import draw_background
from ablate.analysis.work_precision import observed_order

#: Series of the simulator: lines; colour, marker, line style. All others are trained runs: markers without a line.
_SIMULATOR: dict[str, tuple[str, str, str]] = {
    "simulator, rays": ("#000000", "o", "-"),
    "simulator, rays, plan=full": ("#000000", "o", "none"),
    "simulator, layers": (COLOURS[0], "s", "-"),
    "simulator, scanlines": (COLOURS[1], "^", "--"),
    "simulator, axial samples": (COLOURS[2], "v", "-."),
    "simulator, other scatterers": ("#888888", "x", "none"),
}
_HOLLOW = ("simulator, rays, plan=full",)
_GENERATOR_MARKERS = ("D", "P", "X", "*", "h", "<", ">", "d", "p", "8")
_ENGINE_FILL = {"eager": "none", "exported": "full", "compiled": "left"}
_REST = "the rest"
_HATCHES = ("", "////", "", "....", "", "xxxx", "", "----")


def work_precision_figure(points: pd.DataFrame, stem: Path, floors: dict[str, float], hardware: str) -> list[Path]:
    """Error to the reference against milliseconds a frame, a panel a metric, one page.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error, as `precision.csv`.
    stem : Path
        Path without suffix.
    floors : dict of str to float
        Re-simulation's value by metric.
    hardware : str
        What the times were measured on.

    Returns
    -------
    list of Path
        PNG and PDF.

    Raises
    ------
    ValueError
        When there is no finite point with a positive time.
    """
    points = points[np.isfinite(points["error"]) & (points["error"] > 0) & (points["ms"] > 0)]
    metrics = list(dict.fromkeys(points["metric"]))
    if not metrics:
        raise ValueError("no finite point with a positive time to draw")
    runs = [name for name in dict.fromkeys(points["series"]) if name not in _SIMULATOR]
    down = len(metrics) // 2 + 1  # one place is the key's
    with house_style():
        figure = new_figure(PAGE_IN, 2.6 * down + 0.2)
        grid = figure.subplots(down, 2, squeeze=False).ravel()
        handles: dict[str, Any] = {}
        for axes, metric in zip(grid, metrics, strict=False):
            _diagram(axes, points[points["metric"] == metric], metric, floors.get(metric), runs)
            found, names = axes.get_legend_handles_labels()
            names = [n.partition(" (")[0] if n.startswith(RESIMULATION) else n for n in names]
            handles |= {n: h for n, h in zip(names, found, strict=True) if n not in handles}
        for axes in grid[len(metrics) :]:
            axes.set_axis_off()
        if runs:
            handles |= {f"trained run, {e}": _engine_key(e) for e in _engines(points)}
        grid[len(metrics)].legend(
            list(handles.values()), list(handles), loc="center", ncols=1 + (len(handles) > 12), frameon=False
        )
        figure.supxlabel(f"times measured on {hardware}", fontsize=7, color="#555555")
        return save_figure(figure, stem)


def _engines(points: pd.DataFrame) -> list[str]:
    return [e for e in _ENGINE_FILL if points["setting"].str.contains(e).any()]


def _engine_key(engine: str) -> Line2D:
    return Line2D([], [], ls="none", **_marker("#555555", "D", engine))


def _marker(colour: str, marker: str, engine: str) -> dict[str, Any]:
    fill = _ENGINE_FILL[engine]
    style: dict[str, Any] = {"marker": marker, "color": colour, "ms": 5, "mew": 0.8, "fillstyle": fill}
    return style | ({"markerfacecoloralt": "white"} if fill == "left" else {})


def _diagram(axes: Axes, points: pd.DataFrame, metric: str, floor: float | None, runs: list[str]) -> None:
    for name, (colour, marker, line) in _SIMULATOR.items():
        of = points[points["series"] == name]
        if of.empty:
            continue
        face = "none" if name in _HOLLOW else colour
        size = 6.5 if name in _HOLLOW else 3.5
        axes.plot(of["ms"], of["error"], marker=marker, ls=line, ms=size, lw=0.8, color=colour, mfc=face, label=name)
        if line != "none":
            for end in (of.iloc[0], of.iloc[-1]):
                shift: dict[str, Any] = {"xytext": (3, 4), "textcoords": "offset points"}
                axes.annotate(end["setting"], (end["ms"], end["error"]), fontsize=6, color=colour, **shift)
    for k, name in enumerate(runs):
        colour, marker = COLOURS[k % 6], _GENERATOR_MARKERS[k % len(_GENERATOR_MARKERS)]
        labelled = False
        for point in points[points["series"] == name].to_dict("records"):
            engine = next((e for e in _ENGINE_FILL if e in point["setting"]), "eager")
            label = None if labelled else name
            axes.plot(point["ms"], point["error"], ls="none", label=label, **_marker(colour, marker, engine))
            labelled = True
    if facts_of(metric).better is not Better.larger:  # decibels are logarithms already
        _logarithmic(axes)
    draw_background(axes, points["ms"].to_numpy(float), points["error"].to_numpy(float), metric, floor)


def _logarithmic(axes: Axes) -> None:
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def order_figure(points: pd.DataFrame, convergence: pd.DataFrame, base: dict[str, int], stem: Path) -> list[Path]:
    """How errors fall: with rays, beside n^(-1/2); and with each grid, against another draw of the speckle.

    Parameters
    ----------
    points : DataFrame
        Of the series `simulator, rays`: columns setting, metric, error.
    convergence : DataFrame
        Columns series, setting (`other scatterers` for the level), quantity (the metric), value.
    base : dict of str to int
        The data set's value by series.
    stem : Path

    Returns
    -------
    list of Path
        PNG and PDF.
    """
    with house_style():
        figure = new_figure(PAGE_IN, 2.9)
        left, right = figure.subplots(1, 2)
        _rays_panel(left, points)
        _grids_panel(right, convergence, base)
        return save_figure(figure, stem)


def _rays_panel(axes: Axes, points: pd.DataFrame) -> None:
    """Errors over that with one ray, so that all start at 1."""
    styles = zip(("o", "s", "^", "v", "D"), ("-", "--", "-.", ":", "-"), COLOURS, strict=False)
    for metric, (marker, line, colour) in zip(dict.fromkeys(points["metric"]), styles, strict=False):
        of = points[points["metric"] == metric]
        rays, error = of["setting"].astype(int).to_numpy(), of["error"].to_numpy(float)
        fit = observed_order(rays, error, metric)
        if metric == "psnr":
            error = 10 ** (-error / 20)
        if fit is None or not error[0] > 0:
            continue
        name = "RMS error of the image" if metric == "psnr" else facts_of(metric).label
        label = f"{name}: p = {fit.order:.2f}"
        axes.loglog(rays, error / error[0], marker=marker, ls=line, ms=3.5, lw=0.8, color=colour, label=label)
    rays = np.array([1.0, float(points["setting"].astype(int).max())])
    axes.loglog(rays, rays**-0.5, color="#BBBBBB", lw=3, zorder=0, label="$n^{-1/2}$")
    _plain_ticks(axes, 2)
    axes.set_xlabel("rays of a scanline and layer, n")
    axes.set_ylabel("error over that of one ray")
    axes.legend(frameon=False, fontsize=6.5)


def _grids_panel(axes: Axes, table: pd.DataFrame, base: dict[str, int]) -> None:
    """Patch chi-square and smooth MAE over what other scatterers give on the finest grid."""
    for name in dict.fromkeys(table["series"]):
        colour, marker, _ = _SIMULATOR[name]
        for metric, line in (("mae_smooth", "-"), ("pchi2", ":")):
            of = table[(table["series"] == name) & (table["quantity"] == metric)].set_index("setting")["value"]
            if "other scatterers" not in of.index or not of["other scatterers"] > 0:
                continue
            level = of.pop("other scatterers")
            values = np.array([int(v) for v in of.index]) / base[name]
            label = f"{name.removeprefix('simulator, ')}, {facts_of(metric).label}"
            axes.loglog(
                values, of.to_numpy(float) / level, marker=marker, ls=line, ms=3.5, lw=0.8, color=colour, label=label
            )
    axes.axhline(1.0, color=FLOOR_COLOUR, ls="--", lw=0.9)
    axes.annotate("another draw of the speckle", (0.02, 1.0), xycoords=("axes fraction", "data"), fontsize=6.5,
                  xytext=(0, -8), textcoords="offset points", color=FLOOR_COLOUR)  # fmt: skip
    _plain_ticks(axes, 2)
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 1.5, 2.0, 3.0, 5.0)))
    axes.set_xlabel("number over the data set's")
    axes.set_ylabel("error to the finest over re-simulation")
    axes.legend(frameon=False, fontsize=6.5)


def _plain_ticks(axes: Axes, base: int) -> None:
    axes.set_xscale("log", base=base)
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def stages_figure(stages: pd.DataFrame, stem: Path, hardware: str, fewest: float = 0.02) -> list[Path]:
    """What the milliseconds are paid for: a bar a renderer, a section a stage.

    Parameters
    ----------
    stages : DataFrame
        Columns series, setting, quantity (the stage), value (ms).
    stem : Path
    hardware : str
    fewest : float
        Stages that take a smaller share of every bar are summed up as `the rest`.

    Returns
    -------
    list of Path
        PNG and PDF.
    """
    wide = stages.pivot_table(index=["series", "setting"], columns="quantity", values="value", sort=False).fillna(0.0)
    share = wide.div(wide.sum(axis=1), axis=0).max()
    small = [name for name in wide.columns if share[name] < fewest or name == "everything else"]
    shown = wide.drop(columns=small).assign(**{_REST: wide[small].sum(axis=1)})
    with house_style():
        figure = new_figure(PAGE_IN, 0.24 * len(shown) + 1.5)
        axes = figure.subplots()
        names = [f"{series}: {setting}" for series, setting in shown.index]
        left = np.zeros(len(shown))
        for k, stage in enumerate(shown.columns):
            width = shown[stage].to_numpy(float)
            axes.barh(
                names, width, left=left, label=stage, edgecolor="black", lw=0.4, height=0.7,
                color="white" if stage == _REST else COLOURS[k % 8], hatch="" if stage == _REST else _HATCHES[k % 8],
            )  # fmt: skip
            left += width
        axes.invert_yaxis()
        axes.margins(y=0.02)
        axes.set_xlabel(f"median time, ms/frame, on {hardware}")
        figure.legend(loc="outside upper center", ncols=4, frameon=False)
        return save_figure(figure, stem)
