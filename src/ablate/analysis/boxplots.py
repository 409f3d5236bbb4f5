"""Box plots of paired differences to the reference: the paper's Fig. 4, and one figure a metric."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ablate.analysis.figure_style import house_style, save_figure
from ablate.analysis.metric_facts import REFERENCE, RESIMULATION
from ablate.analysis.metric_panels import axis_title, draw_resimulation, metric_panels, one_legend, place_of
from ablate.analysis.order import ordered_metrics
from ablate.analysis.paired_differences import aligned_differences

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
        low, middle, high = np.quantile(differences[RESIMULATION], [0.25, 0.5, 0.75])
        axes.axvspan(low, high, color="#DDDDDD", zorder=0, label="re-simulation, quartiles")
        draw_resimulation(axes, metric, float(middle), "re-simulation, median")
    axes.axvline(0, color="black", lw=0.8, zorder=1)
    shown = [name for name in networks if name in differences]
    places = {name: place_of(k, len(networks)) for k, name in enumerate(networks)}
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
        for row in rows[np.isfinite(rows["low"]) & np.isfinite(rows["high"])].to_dict("records"):
            place = places[row["variant"]] - 0.37
            axes.plot([row["low"], row["high"]], [place] * 2, color="black", lw=1.8, solid_capstyle="butt")
    axes.set_xlabel(axis_title(metric, f"Δ {{}} to {reference}"))


def paired_boxplots(
    per_image: pd.DataFrame, folder: Path, reference: str = REFERENCE, paired: pd.DataFrame | None = None
) -> dict[str, list[Path]]:
    """Draw `boxplot_<metric>.png` and `.pdf` for every metric that has pairs.

    Boxes are quartiles, whiskers the 5th and 95th percentile over frames; the grey band and the line in it are the
    re-simulation's difference; the bar under a box is the interval of the median shift over sites.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    folder : Path
        Where the files go.
    reference : str
        Variant that differences are taken to.
    paired : DataFrame, optional
        What `paired_table` gives, for the intervals.

    Returns
    -------
    dict of str to list of Path
        Files by metric; empty without reference or second variant.
    """
    written = {}
    for metric in ordered_metrics(list(per_image["metric"])):
        if files := boxplot_panels(per_image, [metric], folder / f"boxplot_{metric}", reference, paired):
            written[metric] = files
    return written


def boxplot_panels(
    per_image: pd.DataFrame,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
    paired: pd.DataFrame | None = None,
) -> list[Path]:
    """Box plots of several metrics side by side, as the paper's Fig. 4; see `paired_boxplots`.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    metrics : sequence of str
        Panels; those without pairs are left out.
    stem : Path
        Path without suffix, for instance `boxplots`.
    reference : str
    paired : DataFrame, optional
        What `paired_table` gives.

    Returns
    -------
    list of Path
        PNG and PDF; empty without reference or second variant.
    """
    differences = {metric: _finite_differences(per_image, metric, reference) for metric in metrics}
    drawn = {metric: found for metric, found in differences.items() if set(found) - {RESIMULATION}}
    networks = list(dict.fromkeys(name for found in drawn.values() for name in found if name != RESIMULATION))
    if not networks:
        return []
    with house_style():
        figure, panels = metric_panels(list(drawn), networks, 3, ROW_IN)
        for axes, (metric, found) in zip(panels, drawn.items(), strict=True):
            _draw(axes, found, networks, paired, metric, reference)
        one_legend(figure, panels, 3 if len(panels) > 1 else 1)
        return save_figure(figure, stem)
