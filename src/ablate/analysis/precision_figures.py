"""Figures of error against run time: the diagram, what its milliseconds are paid for, how errors fall."""

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
from ablate.analysis.metric_panels import shown_name
from ablate.analysis.runtime_figure import draw_background
from ablate.analysis.work_precision import observed_order

_LEVEL = "other scatterers"  # row of a grid's table
_OTHER = "simulator, other scatterers"  # what trained runs, which draw speckle of their own, compare with
#: Series of the simulator, in greys: colour, marker, line, size. All others are trained runs, in colours.
_SIMULATOR: dict[str, tuple[str, str, str, float]] = {
    "simulator, rays": ("#000000", "o", "-", 3.5),
    "simulator, rays, plan=full": ("#000000", "o", "none", 6.5),
    "simulator, layers": ("#666666", "s", "none", 4.0),
    "simulator, scanlines": ("#666666", "^", "none", 4.5),
    "simulator, axial samples": ("#666666", "v", "none", 4.5),
    _OTHER: ("#AAAAAA", "x", "none", 3.5),
}
_HOLLOW = ("simulator, rays, plan=full",)
_LABELLED = ("simulator, rays", "simulator, layers", "simulator, scanlines")
_RUN_COLOURS = ("#D55E00", "#0072B2", "#CC79A7", "#009E73", "#E69F00", "#56B4E9")
_RUN_MARKERS = ("D", "P", "X", "*", "h", "<", ">", "d", "p", "8")
_ENGINE_FILL = {"eager": "none", "compiled": "left", "exported": "full"}
#: What a frame is made of: name, shade, hatching, and the stages that belong to it.
_PAID_FOR: tuple[tuple[str, str, str, tuple[str, ...]], ...] = (
    ("S", "#FFFFFF", "", ("labels of the pixels", "segmentation")),
    ("A", "#FFFFFF", "////", ("attenuation, its labels", "attenuation, its sum", "attenuation")),
    (
        "rays",
        "#444444",
        "",
        ("rays at the probe", "rays, to the last echo", "echoes onto lines", "clutter onto lines", "illumination"),
    ),
    (
        "signal chain",
        "#AAAAAA",
        "",
        (
            "labels of the scanlines",
            "level and texture",
            "scatterers",
            "point spread",
            "grey levels",
            "scan conversion",
            "everything else",
        ),
    ),
    ("L", "#AAAAAA", "xxxx", ("low",)),
    ("network", "#E69F00", "....", ("network",)),
)


def work_precision_figure(
    points: pd.DataFrame, stages: pd.DataFrame, stem: Path, floors: dict[str, float], hardware: str
) -> list[Path]:
    """Error to the reference against milliseconds a frame, a panel a metric; in the last one, what they are paid for.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error, as `precision.csv`.
    stages : DataFrame
        Columns series, setting, quantity (the stage), value (ms); of trained runs the fastest way of each is shown.
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
    cells = [*metrics, "names"] if len(metrics) % 2 else [*metrics, "names", "names"]
    rows = [*zip(cells[::2], cells[1::2], strict=True), ("stages", "stages")]
    bars = _bars(stages)
    heights = [2.3] * (len(rows) - 1) + [0.8 + 0.14 * len(bars)]
    with house_style():
        figure = new_figure(PAGE_IN, sum(heights))
        grid = figure.subplot_mosaic([list(row) for row in rows], height_ratios=heights)
        handles: dict[str, Any] = {}
        for metric in metrics:
            axes = grid[metric]
            _diagram(axes, points[points["metric"] == metric], metric, floors.get(metric), runs)
            found, names = axes.get_legend_handles_labels()
            names = [n.partition(" (")[0] if n.startswith(RESIMULATION) else n for n in names]
            handles |= {n: h for n, h in zip(names, found, strict=True) if n not in handles}
        _paid_for(grid["stages"], bars)
        engines = [e for e in _ENGINE_FILL if runs and points["setting"].str.contains(e).any()]
        handles |= {f"run, {e}": Line2D([], [], ls="none", **_marker("#555555", "D", e)) for e in engines}
        grid["names"].set_axis_off()
        named = [name if name in _SIMULATOR else shown_name(name) for name in handles]
        style: dict[str, Any] = {"ncols": 2, "frameon": False, "fontsize": 6, "columnspacing": 1.0, "handlelength": 1.5}
        grid["names"].legend(list(handles.values()), named, loc="center", **style)
        figure.supxlabel(f"times measured on {hardware}", fontsize=7, color="#555555")
        return save_figure(figure, stem)


def _marker(colour: str, marker: str, engine: str) -> dict[str, Any]:
    fill = _ENGINE_FILL[engine]
    style: dict[str, Any] = {"marker": marker, "color": colour, "ms": 5, "mew": 0.8, "fillstyle": fill}
    return style | ({"markerfacecoloralt": "white"} if fill == "left" else {})


def _engine_of(setting: str) -> str:
    return next((e for e in _ENGINE_FILL if e in setting), "eager")


def _diagram(axes: Axes, points: pd.DataFrame, metric: str, floor: float | None, runs: list[str]) -> None:
    for name, (colour, marker, line, size) in _SIMULATOR.items():
        of = points[points["series"] == name]
        if of.empty:
            continue
        face = "none" if name in _HOLLOW else colour
        axes.plot(of["ms"], of["error"], marker=marker, ls=line, ms=size, lw=0.8, color=colour, mfc=face, label=name)
        if name in _LABELLED:
            for end in (of.iloc[0], of.iloc[-1]):
                shift: dict[str, Any] = {"xytext": (4, 3), "textcoords": "offset points"}
                axes.annotate(end["setting"], (end["ms"], end["error"]), fontsize=6, color=colour, **shift)
    for k, name in enumerate(runs):
        colour, marker = _RUN_COLOURS[k % len(_RUN_COLOURS)], _RUN_MARKERS[k % len(_RUN_MARKERS)]
        label: str | None = name
        for point in points[points["series"] == name].to_dict("records"):
            style = _marker(colour, marker, _engine_of(point["setting"]))
            axes.plot(point["ms"], point["error"], ls="none", label=label, **style)
            label = None
    if facts_of(metric).better is not Better.larger:  # decibels are logarithms already
        axes.set_yscale("log")
        _plain(axes)
    fair = points[~points["series"].isin([name for name in _SIMULATOR if name != _OTHER])]
    front = points if fair.empty else fair
    draw_background(axes, front["ms"].to_numpy(float), front["error"].to_numpy(float), metric, floor)


def _plain(axes: Axes, subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Numbers as they are spoken on a logarithmic axis of errors."""
    axes.yaxis.set_major_locator(LogLocator(subs=subs))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_formatter(NullFormatter())


def _paid_for(axes: Axes, wide: pd.DataFrame) -> None:
    """A bar a renderer, a section for each thing that takes time."""
    names = [_bar_name(*place) for place in wide.index]
    left = np.zeros(len(wide))
    for name, colour, hatch, belonging in _PAID_FOR:
        width = wide.reindex(columns=list(belonging), fill_value=0.0).sum(axis=1).to_numpy(float)
        if width.any():
            style: dict[str, Any] = {"color": colour, "hatch": hatch, "edgecolor": "black", "lw": 0.4, "height": 0.7}
            axes.barh(names, width, left=left, label=name, **style)
        left += width
    for name, end in zip(names, left, strict=True):
        axes.annotate(name, (end, name), xytext=(4, 0), textcoords="offset points", fontsize=6.5, va="center")
    axes.invert_yaxis()
    axes.set_yticks([])
    axes.set_xlim(0, 1.15 * left.max())
    axes.set_xlabel("median time, ms/frame")
    above: dict[str, Any] = {"loc": "lower left", "bbox_to_anchor": (0, 1), "ncols": 6}
    axes.legend(frameon=False, fontsize=6.5, **above)


def _bars(stages: pd.DataFrame) -> pd.DataFrame:
    """A row a bar, a column a stage: the simulator's settings, and of each label the fastest way."""
    wide = stages.pivot_table(index=["series", "setting"], columns="quantity", values="value", sort=False).fillna(0.0)
    fastest = wide.sum(axis=1).sort_values(kind="stable").reset_index()
    fastest = fastest[~fastest["series"].isin(_SIMULATOR)].drop_duplicates("series")
    places = set(zip(fastest["series"], fastest["setting"], strict=True))
    return wide.loc[[place for place in wide.index if place[0] in _SIMULATOR or place in places]]


def _bar_name(series: str, setting: str) -> str:
    if series in _SIMULATOR:
        return f"{series.removeprefix('simulator, ')} {setting}"
    way = [p for p in setting.split(", ") if p.startswith("width") or p in ("fp32", "bf16", *_ENGINE_FILL)]
    return ", ".join([shown_name(series), *way])


def order_figure(points: pd.DataFrame, grids: pd.DataFrame, base: dict[str, int], stem: Path) -> list[Path]:
    """How errors fall: with rays, beside n^(-1/2); and with each grid, against another draw of the speckle.

    Parameters
    ----------
    points : DataFrame
        Of the series `simulator, rays`: columns setting, metric, error.
    grids : DataFrame
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
        _grids_panel(right, grids, base)
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
    _powers_of_two(axes)
    _plain(axes)
    axes.set_xlabel("rays of a scanline and layer, n")
    axes.set_ylabel("error over that of one ray")
    axes.legend(frameon=False, fontsize=6.5)


def _grids_panel(axes: Axes, table: pd.DataFrame, base: dict[str, int]) -> None:
    """Patch chi-square and smooth MAE over what other scatterers give on the finest grid."""
    for k, name in enumerate(dict.fromkeys(table["series"])):
        marker = _SIMULATOR[name][1]
        for metric, line in (("mae_smooth", "-"), ("pchi2", ":")):
            of = table[(table["series"] == name) & (table["quantity"] == metric)].set_index("setting")["value"]
            if _LEVEL not in of.index or not of[_LEVEL] > 0:
                continue
            level = of.pop(_LEVEL)
            values = np.array([int(v) for v in of.index]) / base[name]
            label = f"{name.removeprefix('simulator, ')}, {facts_of(metric).label}"
            style: dict[str, Any] = {"marker": marker, "ls": line, "ms": 3.5, "lw": 0.8, "color": COLOURS[k]}
            axes.loglog(values, of.to_numpy(float) / level, label=label, **style)
    axes.axhline(1.0, color=FLOOR_COLOUR, ls="--", lw=0.9)
    where: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "xytext": (0, -8), "textcoords": "offset points"}
    axes.annotate("another draw of the speckle", (0.02, 1.0), fontsize=6.5, color=FLOOR_COLOUR, **where)
    _powers_of_two(axes)
    _plain(axes, (1.0, 1.5, 2.0, 3.0, 5.0))
    axes.set_xlabel("number over the data set's")
    axes.set_ylabel("error to a finer grid over re-simulation")
    axes.legend(frameon=False, fontsize=6.5)


def _powers_of_two(axes: Axes) -> None:
    axes.set_xscale("log", base=2)
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_locator(NullLocator())
