"""The figure of error against time, for the networks of a study and for every setting of the simulator beside them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.lines import Line2D
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from ablate.analysis.components import Component
from ablate.analysis.figures.metric_panels import legend_entries, resimulation_line, shown_name
from ablate.analysis.figures.style import PAGE_IN, colour_of, house_style, new_figure, save_figure
from ablate.analysis.statistics.work_precision import pareto_front
from ablate.analysis.tables import resimulation_note
from ablate.metrics import Direction, metric_of
from ablate.metrics.stored_names import BOUNDS

COLUMNS = ("series", "setting", "ms", "metric", "error")
PAPER_ANCHORS_MS = {"simulated": 75.0, "generated": 40.0}
# The simulator with speckle of its own, as a generator has: only this series compares fairly with a trained run.
OTHER_SPECKLE = "simulator, other scatterers"
# Series of the simulator: colour, marker, line and size. All others are trained runs.
SIMULATOR: dict[str, tuple[str, str, str, float]] = {
    "simulator, rays": ("#000000", "o", "-", 3.5),
    "simulator, rays, plan=full": ("#000000", "o", "none", 6.5),
    "simulator, tolerance": ("#0072B2", "D", "-", 3.0),
    "simulator, layers": ("#666666", "s", "none", 4.0),
    "simulator, scanlines": ("#666666", "^", "none", 4.5),
    "simulator, axial samples": ("#666666", "v", "none", 4.5),
    OTHER_SPECKLE: ("#AAAAAA", "x", "none", 3.5),
}
_HOLLOW = ("simulator, rays, plan=full",)
# Of these the first and the last setting is written beside its point.
_LABELLED = ("simulator, rays", "simulator, tolerance", "simulator, layers", "simulator, scanlines")
_RUN_MARKERS = ("D", "P", "X", "*", "h", "<", ">", "d", "p", "8")
_ENGINE_FILL = {"eager": "none", "compiled": "left", "exported": "full"}
# What the time of a frame is spent on: shade and hatching.
_PARTS = {
    "S": ("#FFFFFF", ""),
    "A": ("#FFFFFF", "////"),
    "rays": ("#444444", ""),
    "signal chain": ("#AAAAAA", ""),
    "L": ("#AAAAAA", "xxxx"),
    "network": ("#E69F00", "...."),
}
_LOGARITHMIC_FROM = 5.0  # ratio of the largest error to the smallest


def error_vs_runtime(
    points: pd.DataFrame,
    stem: Path,
    floors: Mapping[str, float] | None = None,
    hardware: str = "",
    parts: pd.DataFrame | None = None,
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw error against time, a panel a metric, with the Pareto front, re-simulation and the paper's times.

    The files are a PNG and a PDF at `stem`, a path without suffix.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error (as `precision.csv`). The keys of `SIMULATOR` are the simulator's
        series, all others are trained runs. Columns lower and upper, where they are, are the spread of the times, and
        a difference within it puts no point on the front.
    floors : mapping of str to float, optional
        Re-simulation's value by metric.
    hardware : str
        Device that the times were measured on; it is written on the figure.
    parts : DataFrame, optional
        Columns series, setting, part (a key of `_PARTS`), ms: a last panel shows what the time is spent on, of a
        trained run in its fastest setting.
    components : sequence of Component
        Changes of these are written in short.

    Raises
    ------
    ValueError
        When a column is missing, or there is no finite point with a positive time.
    """
    missing = [name for name in COLUMNS if name not in points.columns]
    if missing:
        raise ValueError(f"points lack the columns {missing}, they have {list(points.columns)}")
    points = points[np.isfinite(points["error"]) & np.isfinite(points["ms"]) & (points["ms"] > 0)]
    metrics = list(dict.fromkeys(points["metric"]))
    if not metrics:
        raise ValueError("no finite point with a positive time to draw")
    across = min(len(metrics), 2)
    cells = [*metrics, *["legend"] * (-len(metrics) % across)]
    rows = [cells[k : k + across] for k in range(0, len(cells), across)]
    bars = None if parts is None else _bars(parts)
    heights = [2.3] * len(rows)
    if bars is not None:
        rows.append(["parts"] * across)
        heights.append(0.8 + 0.14 * len(bars))
    with house_style():
        legend_in = 0.0 if "legend" in cells else 0.6
        figure = new_figure(PAGE_IN if across == 2 else PAGE_IN * 0.62, sum(heights) + legend_in)
        grid = figure.subplot_mosaic(rows, height_ratios=heights)
        runs = {name: shown_name(name, components) for name in points["series"] if name not in SIMULATOR}
        for metric in metrics:
            _diagram(grid[metric], points[points["metric"] == metric], metric, (floors or {}).get(metric), runs)
        handles = _legend([grid[metric] for metric in metrics], points)
        style: dict[str, Any] = {"frameon": False, "handlelength": 1.5, "columnspacing": 1.0}
        if "legend" in cells:
            grid["legend"].set_axis_off()
            grid["legend"].legend(handles.values(), handles.keys(), loc="center", ncols=2, fontsize=6, **style)
        else:
            figure.legend(handles.values(), handles.keys(), loc="outside upper center", ncols=across + 1, **style)
        if bars is not None:
            _time_of_parts(grid["parts"], bars, runs)
        if hardware:
            figure.supxlabel(f"times measured on {hardware}", fontsize=7, color="#555555")
        return save_figure(figure, stem)


def _legend(panels: Sequence[Axes], points: pd.DataFrame) -> dict[str, Artist]:
    """The legend's entries, each once; what a marker's fill means comes last."""
    handles = legend_entries(panels)
    for engine in _ENGINE_FILL:
        if points.loc[~points["series"].isin(list(SIMULATOR)), "setting"].str.contains(engine).any():
            handles[f"run, {engine}"] = Line2D([], [], ls="none", **_marker("#555555", "D", engine))
    return handles


def _marker(colour: str, marker: str, engine: str) -> dict[str, Any]:
    fill = _ENGINE_FILL[engine]
    style: dict[str, Any] = {"marker": marker, "color": colour, "ms": 5, "mew": 0.8, "fillstyle": fill}
    return style | ({"markerfacecoloralt": "white"} if fill == "left" else {})


def _diagram(axes: Axes, points: pd.DataFrame, metric: str, floor: float | None, runs: Mapping[str, str]) -> None:
    """Every point of one metric; `runs` has the shown name of every trained run."""
    for name, (colour, marker, line, size) in SIMULATOR.items():
        drawn = points[points["series"] == name]
        if drawn.empty:
            continue
        style: dict[str, Any] = {"marker": marker, "ls": line, "ms": size, "lw": 0.8, "color": colour, "label": name}
        axes.plot(drawn["ms"], drawn["error"], mfc="none" if name in _HOLLOW else colour, **style)
        for _, end in drawn.iloc[[0, -1]].iterrows() if name in _LABELLED else ():
            shift: dict[str, Any] = {"xytext": (4, 3), "textcoords": "offset points"}
            axes.annotate(str(end["setting"]), (end["ms"], end["error"]), fontsize=6, color=colour, **shift)
    for k, name in enumerate(runs):
        for point in points[points["series"] == name].to_dict("records"):
            engine = next((e for e in _ENGINE_FILL if e in str(point["setting"])), "exported")
            style = _marker(colour_of(name, list(runs)), _RUN_MARKERS[k % len(_RUN_MARKERS)], engine)
            if "lower" in point:
                span = [[point["ms"] - point["lower"]], [point["upper"] - point["ms"]]]
                axes.errorbar(point["ms"], point["error"], xerr=span, color=style["color"], lw=0.8, capsize=1.5)
            axes.plot(point["ms"], point["error"], ls="none", label=runs[name], **style)
    error = points["error"].to_numpy(dtype=np.float64)
    positive = error[error > 0]
    decibels = metric_of(metric).better is Direction.higher  # PSNR is a logarithm already
    if not decibels and len(positive) and positive.max() > _LOGARITHMIC_FROM * positive.min():
        axes.set_yscale("log")
        plain_numbers(axes.yaxis)
    fair = points[points["series"].isin([*runs, OTHER_SPECKLE])]
    _background(axes, points if fair.empty else fair, metric, floor)


def _background(axes: Axes, points: pd.DataFrame, metric: str, floor: float | None) -> None:
    """Draw the Pareto front of these points, re-simulation, the paper's times, and the axes' names."""
    ms, error = points["ms"].to_numpy(dtype=np.float64), points["error"].to_numpy(dtype=np.float64)
    spread = [points[side].to_numpy(dtype=np.float64) for side in BOUNDS if side in points]
    front = pareto_front(ms, -error if metric_of(metric).better is Direction.higher else error, *spread)
    axes.step(ms[front], error[front], where="post", color="#BBBBBB", lw=3, zorder=0, label="Pareto front")
    if floor is not None:
        axes.axhline(floor, lw=0.9, **resimulation_line(metric))
    for (name, anchor), line in zip(PAPER_ANCHORS_MS.items(), (":", "-."), strict=True):
        label = f"paper, {name}: {anchor:.0f} ms, unknown GPU"
        axes.axvline(anchor, color="#999999", ls=line, lw=0.9, label=label)
    axes.set_xscale("log")
    plain_numbers(axes.xaxis)
    axes.set_xlabel("median time, ms/frame")
    axes.set_ylabel(metric_of(metric).title)


def plain_numbers(axis: Axis, subs: tuple[float, ...] = (1.0, 2.0, 5.0)) -> None:
    """Write a logarithmic axis in plain decimal numbers, at `subs` of every decade."""
    axis.set_major_locator(LogLocator(subs=subs))
    axis.set_major_formatter(FormatStrFormatter("%g"))
    axis.set_minor_formatter(NullFormatter())


def _bars(parts: pd.DataFrame) -> pd.DataFrame:
    """A row a bar, a column a part, ms: every setting of the simulator, and of each trained run the fastest."""
    wide = parts.pivot_table(index=["series", "setting"], columns="part", values="ms", aggfunc="sum", sort=False)
    wide = wide.fillna(0.0)
    fastest = wide.sum(axis=1).sort_values(kind="stable").reset_index()
    fastest = fastest[~fastest["series"].isin(list(SIMULATOR))].drop_duplicates("series")
    places = set(zip(fastest["series"], fastest["setting"], strict=True))
    return wide.loc[[place for place in wide.index if place[0] in SIMULATOR or place in places]]


def _time_of_parts(axes: Axes, bars: pd.DataFrame, runs: Mapping[str, str]) -> None:
    """Draw a bar a row, a section for each part that takes time."""
    names = [_bar_name(series, setting, runs) for series, setting in bars.index]
    left = np.zeros(len(bars))
    for name, (colour, hatch) in _PARTS.items():
        if name in bars:
            style: dict[str, Any] = {"color": colour, "hatch": hatch, "edgecolor": "black", "lw": 0.4, "height": 0.7}
            axes.barh(names, bars[name], left=left, label=name, **style)
            left = left + bars[name].to_numpy()
    for name, end in zip(names, left, strict=True):
        axes.annotate(name, (end, name), xytext=(4, 0), textcoords="offset points", fontsize=6.5, va="center")
    axes.invert_yaxis()
    axes.set_yticks([])
    axes.set_xlim(0, 1.15 * left.max())
    axes.set_xlabel("median time, ms/frame")
    axes.legend(frameon=False, fontsize=6.5, loc="lower left", bbox_to_anchor=(0, 1), ncols=6)


def _bar_name(series: str, setting: str, runs: Mapping[str, str]) -> str:
    if series in SIMULATOR:
        return f"{series.removeprefix('simulator, ')} {setting}"
    shown = [p for p in setting.split(", ") if p.startswith("width") or p in ("fp32", "bf16", *_ENGINE_FILL)]
    return ", ".join([runs.get(series, series), *shown])


def runtime_caption(metrics: Sequence[str]) -> str:
    """Caption of `error_vs_runtime`."""
    return (
        "Error on the test frames against the median time per frame, with the maps that the network reads, on the "
        "machine that the figure names. Bars are quartiles over rounds in which all networks took turns. The grey line "
        f"is the Pareto front; no point is on it for a time that differs by less than the bars. The paper does "
        f"not name the GPU of its times. {resimulation_note(list(metrics))}"
    )
