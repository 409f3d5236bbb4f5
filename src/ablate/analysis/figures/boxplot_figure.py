"""Paired differences to the reference as box plots, a panel a metric, as the paper's Fig. 4."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from ablate.analysis.components import Component
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure
from ablate.analysis.figures.style import (
    PAGE_IN,
    axis_title,
    baseline_line,
    house_style,
    new_figure,
    one_legend,
    save_figure,
    shown_name,
)
from ablate.analysis.results import StudyResults
from ablate.analysis.scored import BASELINE_NAMES, REFERENCE, RESIMULATION
from ablate.analysis.statistics.paired import aligned_differences
from ablate.metrics import Shown, shown_in

# Heights of a row with a box, of what is above and below a panel, and of the legend.
BOX_IN, HEAD_IN, LEGEND_IN = 0.26, 0.55, 0.25
BOX_STYLE: dict[str, Any] = {
    "orientation": "horizontal",
    "widths": 0.5,
    "whis": (5, 95),
    "patch_artist": True,
    "manage_ticks": False,
    "boxprops": {"facecolor": "#9ECAE9", "lw": 0.7},
    "medianprops": {"color": "black", "lw": 1.3},
    "whiskerprops": {"lw": 0.7},
    "capprops": {"lw": 0.7},
    "flierprops": {"marker": ".", "ms": 2, "mfc": "#777777", "mec": "none"},
}


def boxplot_panels(
    per_image: pd.DataFrame,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
    paired: pd.DataFrame | None = None,
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw paired differences to the reference as box plots of these metrics side by side; no file without a pair.

    Boxes are quartiles, whiskers the 5th and 95th percentile over frames; the grey band and the line in it are the re-
    simulation's difference; the bar under a box is the interval of the median shift over sites.

    Parameters
    ----------
    per_image : DataFrame
        As for `comparison_table`.
    metrics : sequence of str
        Those without pairs are left out.
    stem : Path
        Of the files, without suffix.
    reference : str
        The variant that the others are compared with.
    paired : DataFrame, optional
        What `paired_table` gives, for the intervals.
    components : sequence of Component
        Changes of these are written in short.
    """
    shown: dict[str, dict[str, np.ndarray]] = {}
    for metric in metrics:
        differences = _finite_differences(per_image, metric, reference)
        if set(differences) - set(BASELINE_NAMES):
            shown[metric] = differences
    named = dict.fromkeys(name for by_variant in shown.values() for name in by_variant)
    networks = [name for name in named if name not in BASELINE_NAMES]
    if not networks:
        return []
    with house_style():
        figure, panels = _empty_panels(len(shown), [shown_name(name, components) for name in networks])
        for axes, (metric, differences) in zip(panels, shown.items(), strict=True):
            places = {name: len(networks) - k for k, name in enumerate(networks) if name in differences}
            _draw_boxes(axes, metric, differences, places)
            if paired is not None:
                _draw_intervals(axes, paired[paired["metric"] == metric], places)
            axes.set_xlabel(axis_title(metric, f"Δ {{}} to {reference}"))
        one_legend(figure, panels)
        return save_figure(figure, stem)


def _empty_panels(count: int, rows: Sequence[str]) -> tuple[Figure, list[Axes]]:
    """Axes, three side by side; row k of the names lies at the ordinate `len(rows) - k`."""
    across = min(3, count)
    down = -(-count // across)
    figure = new_figure(PAGE_IN, LEGEND_IN + down * (HEAD_IN + BOX_IN * max(len(rows), 2)))
    grid = list(figure.subplots(down, across, squeeze=False, sharey=True).ravel())
    places = range(len(rows), 0, -1)
    for axes in grid[:count]:
        axes.set_yticks(places, rows)
        axes.set_ylim(0.4, len(rows) + 0.6)
        axes.xaxis.set_major_locator(MaxNLocator(4))
        axes.tick_params(axis="y", length=0)
        axes.hlines(places, 0, 1, colors="#EEEEEE", lw=0.5, zorder=0, transform=axes.get_yaxis_transform())
    for axes in grid[count:]:
        axes.set_axis_off()
    return figure, grid[:count]


def _finite_differences(per_image: pd.DataFrame, metric: str, reference: str) -> dict[str, np.ndarray]:
    """By variant, its finite differences to the reference, (frames,), where it has any."""
    finite = {}
    for variant, pairs in aligned_differences(per_image, metric, reference).items():
        kept = pairs[np.isfinite(pairs[["value", "reference"]]).all(axis=1)]
        if len(kept):
            finite[variant] = (kept["value"] - kept["reference"]).to_numpy()
    return finite


def _draw_boxes(axes: Axes, metric: str, differences: Mapping[str, np.ndarray], places: Mapping[str, int]) -> None:
    if RESIMULATION in differences:
        lower, upper = np.quantile(differences[RESIMULATION], [0.25, 0.75])
        axes.axvspan(lower, upper, color="#DDDDDD", zorder=0, label=f"{RESIMULATION}, quartiles")
    for name in (name for name in BASELINE_NAMES if name in differences):
        line = baseline_line(metric, name, ", median")
        axes.axvline(float(np.median(differences[name])), lw=1.0, zorder=1, **line)
    axes.axvline(0, color="black", lw=0.8, zorder=1)
    axes.boxplot([differences[name] for name in places], positions=list(places.values()), **BOX_STYLE)


def _draw_intervals(axes: Axes, paired: pd.DataFrame, places: Mapping[str, int]) -> None:
    """Bars below the boxes, of rows of `paired_table`."""
    for row in paired.to_dict("records"):
        ends = [row["lower"], row["upper"]]
        if row["variant"] in places and np.isfinite(ends).all():
            height = places[row["variant"]] - 0.37
            axes.plot(ends, [height, height], color="black", lw=1.8, solid_capstyle="butt")


def _of_study(results: StudyResults, folder: Path) -> Iterator[Drawing]:
    """The metrics of the headline side by side, and each metric alone."""
    headline = [name for name in shown_in(Shown.headline) if name in results.metrics]
    stems = {"boxplots": headline} | {f"boxplot_{name}": [name] for name in results.metrics}
    for stem, metrics in stems.items():
        files = boxplot_panels(
            results.per_image,
            metrics,
            folder / stem,
            reference=results.reference,
            paired=results.paired,
            components=results.components,
        )
        yield Drawing(files, metrics=metrics, folded=stem != "boxplots")


BOXPLOTS = StudyFigure(name="boxplots", section=Section.figures, draw=_of_study, place=30)
