"""Box plots of paired differences to the reference: the paper's Fig. 4, and one figure a metric."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ablate.analysis.components import Component
from ablate.analysis.figures.metric_panels import axis_title, draw_resimulation, metric_panels, one_legend, shown_name
from ablate.analysis.figures.style import house_style, save_figure
from ablate.analysis.scored import REFERENCE, RESIMULATION, ordered_metrics
from ablate.analysis.statistics.paired import aligned_differences
from ablate.analysis.tables import resimulation_note
from ablate.metrics import metric_of

ROW_IN = 0.26
BOX_COLOUR = "#9ECAE9"


def _finite_differences(per_image: pd.DataFrame, metric: str, reference: str) -> dict[str, np.ndarray]:
    found = {}
    for variant, pairs in aligned_differences(per_image, metric, reference).items():
        delta = pairs["value"].to_numpy() - np.where(np.isfinite(pairs["reference"]), pairs["reference"], np.nan)
        if np.isfinite(delta).any():
            found[variant] = delta[np.isfinite(delta)]
    return found


def _draw(
    axes: Axes,
    differences: dict[str, np.ndarray],
    networks: Sequence[str],
    shifts: pd.DataFrame | None,
    metric: str,
    reference: str,
) -> None:
    if RESIMULATION in differences:
        lower, middle, upper = np.quantile(differences[RESIMULATION], [0.25, 0.5, 0.75])
        axes.axvspan(lower, upper, color="#DDDDDD", zorder=0)
        draw_resimulation(axes, metric, float(middle), "re-simulation, median and quartiles")
    axes.axvline(0, color="black", lw=0.8, zorder=1)
    shown = [name for name in networks if name in differences]
    places = {name: len(networks) - k for k, name in enumerate(networks)}
    axes.boxplot(
        [differences[name] for name in shown],
        positions=[places[name] for name in shown],
        orientation="horizontal",
        manage_ticks=False,
        widths=0.5,
        whis=(5, 95),
        patch_artist=True,
        boxprops={"facecolor": BOX_COLOUR, "lw": 0.7},
        medianprops={"color": "black", "lw": 1.3},
        whiskerprops={"lw": 0.7},
        capprops={"lw": 0.7},
        flierprops={"marker": ".", "ms": 2, "mfc": "#777777", "mec": "none"},
    )
    if shifts is not None and len(shifts):
        rows = shifts[(shifts["metric"] == metric) & shifts["variant"].isin(shown)]
        for row in rows[np.isfinite(rows["lower"]) & np.isfinite(rows["upper"])].to_dict("records"):
            place = places[row["variant"]] - 0.37
            axes.plot([row["lower"], row["upper"]], [place] * 2, color="black", lw=1.8, solid_capstyle="butt")
    axes.set_xlabel(axis_title(metric, f"Δ {{}} to {reference}"))


def paired_boxplots(
    per_image: pd.DataFrame,
    folder: Path,
    reference: str = REFERENCE,
    paired: pd.DataFrame | None = None,
    components: Sequence[Component] = (),
) -> dict[str, list[Path]]:
    """Draw `boxplot_<metric>.png` and `.pdf` into `folder` for every metric that has pairs; return the files by metric.

    Boxes are quartiles, whiskers the 5th and 95th percentile over frames; the grey band and the line in it are the re-
    simulation's difference; the bar under a box is the interval of the median shift over sites. Nothing is drawn
    without the reference or a second variant.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    paired : DataFrame, optional
        What `paired_table` gives, for the intervals.
    components : sequence of Component
        Changes of these are written in short.
    """
    written = {}
    for metric in ordered_metrics(list(per_image["metric"])):
        if files := boxplot_panels(per_image, [metric], folder / f"boxplot_{metric}", reference, paired, components):
            written[metric] = files
    return written


def boxplot_panels(
    per_image: pd.DataFrame,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
    paired: pd.DataFrame | None = None,
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw box plots of several metrics side by side, as the paper's Fig. 4; arguments as for `paired_boxplots`.

    Metrics without pairs are left out. The files are a PNG and a PDF at `stem`, a path without suffix; none without the
    reference or a second variant.
    """
    differences = {metric: _finite_differences(per_image, metric, reference) for metric in metrics}
    drawn = {metric: found for metric, found in differences.items() if set(found) - {RESIMULATION}}
    networks = list(dict.fromkeys(name for found in drawn.values() for name in found if name != RESIMULATION))
    if not networks:
        return []
    with house_style():
        figure, panels = metric_panels(list(drawn), [shown_name(n, components) for n in networks], 3, ROW_IN)
        for axes, (metric, found) in zip(panels, drawn.items(), strict=True):
            _draw(axes, found, networks, paired, metric, reference)
        one_legend(figure, panels, 3 if len(panels) > 1 else 1)
        return save_figure(figure, stem)


def boxplot_caption(metrics: Sequence[str], reference: str = REFERENCE) -> str:
    """Caption of `paired_boxplots` and `boxplot_panels`."""
    names = ", ".join(metric_of(metric).label for metric in metrics)
    return (
        f"Paired differences from {reference} in {names} on the same test frames (means over seeds). A box shows "
        "quartiles, and its whiskers show the 5th and 95th percentiles. The bar below a box is the 95 % interval of "
        f"the median shift over probe sites. {resimulation_note(list(metrics))}"
    )
