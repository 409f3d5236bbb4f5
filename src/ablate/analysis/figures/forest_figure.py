"""What each component earns or saves, in one picture: effects with intervals, costs, and the map of interactions."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from textwrap import wrap
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap

from ablate.analysis.components import Component, Question
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure
from ablate.analysis.figures.style import PAGE_IN, house_style, new_figure, one_legend, save_figure
from ablate.analysis.results import StudyResults
from ablate.analysis.statistics.component_models import ALPHA, sign_of
from ablate.analysis.statistics.verdicts import Verdict, improvements, interactions
from ablate.metrics import metric_of

ROW_IN = 0.42
HEAD_IN = 0.9
CELL_IN = 0.27  # of the map of interactions
FAINT = 0.3  # opacity of an interaction that may be chance
BAND_COLOUR, RUN_COLOUR = "#DDDDDD", "#0072B2"
COLOURS = {
    Verdict.earns: "#007A55",
    Verdict.saves: "#007A55",
    Verdict.does_not: "#B04A00",
    Verdict.harms: "#B04A00",
    Verdict.undecided: "#555555",
}
MAP_NOTE = """Half of the difference between
a component's improvement (row)
with and without another
component (column),
in the unit above.

* and strong colour: false
discovery rate < 5 %"""
_MAP = LinearSegmentedColormap.from_list("harm to gain", ["#E08A4F", "#FFFFFF", "#6BAED6"]).with_extremes(bad="#F2F2F2")


def forest_figure(
    verdicts: pd.DataFrame, runs: pd.DataFrame, pairs: pd.DataFrame, components: Sequence[Component], stem: Path
) -> list[Path]:
    """Draw the verdicts: a row a component, and below them how components change each other's effects.

    The unit of an improvement is the band of its component. Components without an effect are left out, and without one
    with an effect no file is made.

    Parameters
    ----------
    verdicts : DataFrame
        What `verdict_table` gives.
    runs : DataFrame
        What `improvements` gives.
    pairs : DataFrame
        What `interactions` gives.
    components : sequence of Component
        Those of the tables, for their labels.
    stem : Path
        Of the files, without suffix.
    """
    shown = verdicts[verdicts["effect"].notna()].reset_index(drop=True)
    if shown.empty:
        return []
    labels = {name: name for name in shown["component"]} | {c.name: c.label for c in components}
    rows = [HEAD_IN + ROW_IN * len(shown)]
    if len(pairs):
        rows.append(1.0 + CELL_IN * len(shown))
    with house_style():
        figure = new_figure(PAGE_IN, sum(rows))
        grid = figure.add_gridspec(len(rows), 2, height_ratios=rows, width_ratios=[2.0, 1])
        forest = figure.add_subplot(grid[0, 0])
        _draw_forest(forest, shown, runs, labels)
        _write_beside(figure.add_subplot(grid[0, 1], sharey=forest), shown)
        if len(pairs):
            _draw_map(figure.add_subplot(grid[1, 0]), shown, pairs, labels)
            beside = figure.add_subplot(grid[1, 1])
            beside.set_axis_off()
            beside.text(0.03, 0.5, MAP_NOTE, va="center", color="#444444", transform=beside.transAxes, linespacing=1.4)
        one_legend(figure, [forest])
        return save_figure(figure, stem)


def _draw_forest(axes: Axes, shown: pd.DataFrame, runs: pd.DataFrame, labels: Mapping[str, str]) -> None:
    places = range(len(shown), 0, -1)
    axes.set_xscale("symlog", linthresh=1, linscale=0.8)  # linear within the band
    axes.margins(x=0.06)
    axes.axvspan(-1, 1, color=BAND_COLOUR, lw=0, zorder=0, label="too small to matter")
    axes.axvline(0, color="black", lw=0.8, zorder=1)
    for place, row in zip(places, shown.to_dict("records"), strict=True):
        _draw_runs(axes, runs[runs["component"] == row["component"]], row["band"], place)
        scale = sign_of(row["metric"]) / row["band"]
        ends = [scale * row["lower"], scale * row["upper"]]
        axes.plot(ends, [place, place], color="black", lw=2.2, solid_capstyle="butt", zorder=3)
        ends = [row["least"] / row["band"], row["most"] / row["band"]]
        axes.plot(ends, [place, place], "k|-", lw=0.8, ms=6, label="with Holm's correction", zorder=3)
        style: dict[str, Any] = {"ms": 5.5, "mfc": "black", "mec": "white", "mew": 0.6}
        axes.plot([scale * row["effect"]], [place], "D", **style, label="effect, 95 % interval", zorder=4)
    names = zip(shown["component"], shown["metric"], strict=True)
    axes.set_yticks(places, [f"{labels[name]}\n{metric_of(metric).label}" for name, metric in names])
    axes.set_ylim(0.5, len(shown) + 0.5)
    axes.tick_params(axis="y", length=0)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("improvement / what is too small to matter")
    axes.set_title("effect of each component on its own metric", loc="left")


def _draw_runs(axes: Axes, runs: pd.DataFrame, band: float, place: int) -> None:
    """A dot a run: those with the component above its row, those without it below."""
    for on, height, fill, label in (
        (True, place + 0.24, RUN_COLOUR, "run with it"),
        (False, place - 0.24, "white", "run without it"),
    ):
        values = runs.loc[runs["on"] == on, "improvement"] / band
        heights = np.full(len(values), height)
        axes.plot(values, heights, "o", ms=3.2, mfc=fill, mec=RUN_COLOUR, mew=0.7, label=label, zorder=2)


def _write_beside(axes: Axes, shown: pd.DataFrame) -> None:
    """Verdicts and costs, as columns of text in the rows of the forest."""
    axes.set_axis_off()
    axes.set_xlim(0, 1)
    for x, head, side in ((0.03, "verdict", "left"), (0.66, "ms/frame", "right"), (1.0, "weights", "right")):
        axes.text(x, len(shown) + 0.72, head, ha=side, va="center", color="#666666")
    for place, row in zip(range(len(shown), 0, -1), shown.to_dict("records"), strict=True):
        verdict = Verdict(row["verdict"])
        word = verdict.replace("_", " ")
        if row["question"] == Question.saves and verdict is Verdict.undecided:
            word = "undecided\n(saves?)"
        axes.text(0.03, place, word, va="center", weight="bold", color=COLOURS[verdict])
        time = _signed(row["ms_per_frame"], 1 if abs(row["ms_per_frame"]) < 10 else 0)
        axes.text(0.66, place, time, ha="right", va="center")
        axes.text(1.0, place, _signed(row["parameters"] / 1000, 0, "k"), ha="right", va="center")


def _signed(value: float, decimals: int, unit: str = "") -> str:
    """A number with its sign; a dash where it is missing, and no sign where it is printed as zero."""
    if pd.isna(value):
        return "–"
    text = f"{value:+,.{decimals}f}".replace("-", "−")
    return f"{text}{unit}" if text.strip("+−0.") else "0"


def _draw_map(axes: Axes, shown: pd.DataFrame, pairs: pd.DataFrame, labels: Mapping[str, str]) -> None:
    names = list(shown["component"])
    bands = dict(zip(names, shown["band"], strict=True))
    shown_pairs = pairs[pairs["component"].isin(names) & pairs["other"].isin(names)]
    share = np.full((len(names), len(names)), np.nan)
    strength = np.full(share.shape, FAINT)
    for row in shown_pairs.to_dict("records"):
        i = names.index(row["component"])
        j = names.index(row["other"])
        share[i, j] = row["improvement"] / bands[row["component"]]
        star = "*" if row["q"] < ALPHA else ""
        strength[i, j] = 1.0 if star else FAINT
        axes.text(j, i, f"{_signed(share[i, j], 1)}{star}", ha="center", va="center")
    most = max(float(np.nanmax(np.abs(share), initial=0.0)), 1.0)
    axes.imshow(share, cmap=_MAP, vmin=-most, vmax=most, aspect="auto", alpha=strength)
    axes.set_xticks(range(len(names)), ["\n".join(wrap(labels[name], 11)) for name in names])
    axes.set_yticks(range(len(names)), [labels[name] for name in names])
    axes.tick_params(length=0)
    axes.tick_params(axis="x", labelsize="small")
    axes.xaxis.tick_top()
    axes.set_title("interactions", loc="left")
    axes.spines[:].set_visible(False)


def _of_study(results: StudyResults, folder: Path) -> Iterator[Drawing]:
    files = forest_figure(
        results.verdicts,
        improvements(results.means, results.design, results.components),
        interactions(results.means, results.design, results.components),
        results.components,
        folder / "verdicts",
    )
    questions = results.verdicts.loc[results.verdicts["effect"].notna(), "question"]
    yield Drawing(files, facts={"design": results.design, "saving": Question.saves in set(questions)})


VERDICTS = StudyFigure(name="verdicts", section=Section.verdicts, draw=_of_study, place=10)
