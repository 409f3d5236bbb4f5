"""Box plots of paired differences to the reference, one figure a metric."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from ablate.analysis.figure_style import COLUMN_IN, FLOOR_COLOUR, colour_of, house_style, new_figure, save_figure
from ablate.analysis.metric_facts import REFERENCE, RESIMULATION, Better, facts_of
from ablate.analysis.order import ordered_metrics
from ablate.analysis.paired_differences import aligned_differences

HINTS = {Better.larger: "better →", Better.smaller: "← better", Better.nearest_zero: "", Better.unjudged: ""}


def _draw(
    axes: Axes, differences: dict[str, np.ndarray], shifts: pd.DataFrame | None, metric: str, reference: str
) -> None:
    networks = [name for name in differences if name != RESIMULATION]
    if RESIMULATION in differences:
        low, middle, high = np.quantile(differences[RESIMULATION], [0.25, 0.5, 0.75])
        axes.axvspan(low, high, color="#DDDDDD", zorder=0, label="re-simulation, quartiles")
        axes.axvline(middle, color=FLOOR_COLOUR, lw=0.9, ls="--", zorder=1, label="re-simulation, median")
    axes.axvline(0, color="black", lw=0.9, zorder=1)
    places = np.arange(len(networks), 0, -1)
    boxes = axes.boxplot(
        [differences[name] for name in networks],
        positions=places,
        orientation="horizontal",
        widths=0.55,
        whis=(5, 95),
        patch_artist=True,
        medianprops={"color": "black", "lw": 1.2},
        whiskerprops={"lw": 0.7},
        capprops={"lw": 0.7},
        flierprops={"marker": ".", "ms": 2, "mfc": "#777777", "mec": "none"},
    )
    for box, name in zip(boxes["boxes"], networks, strict=True):
        box.set(facecolor=colour_of(name, networks), alpha=0.55, lw=0.7)
    if shifts is not None and len(shifts):
        rows = shifts[(shifts["metric"] == metric) & shifts["variant"].isin(networks)]
        for row in rows[np.isfinite(rows["low"]) & np.isfinite(rows["high"])].to_dict("records"):
            place = places[networks.index(row["variant"])] - 0.4
            axes.plot([row["low"], row["high"]], [place] * 2, color="black", lw=1.6, solid_capstyle="butt")
    axes.set_yticks(places, networks)
    axes.set_ylim(0.35, len(networks) + 0.6)
    hint = HINTS[facts_of(metric).better]
    axes.set_xlabel(f"Δ {facts_of(metric).title}, variant − {reference}" + (f"   {hint}" if hint else ""))


def paired_boxplots(
    per_image: pd.DataFrame, folder: Path, reference: str = REFERENCE, paired: pd.DataFrame | None = None
) -> dict[str, list[Path]]:
    """Draw `boxplot_<metric>.png` and `.pdf` for every metric that has pairs.

    Boxes are quartiles, whiskers the 5th and 95th percentile over frames; the grey band and dashed line are the
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
        differences = {}
        for variant, pairs in aligned_differences(per_image, metric, reference).items():
            delta = pairs["value"].to_numpy() - pairs["reference"].to_numpy()
            if np.isfinite(delta).any():
                differences[variant] = delta[np.isfinite(delta)]
        networks = [name for name in differences if name != RESIMULATION]
        if not networks:
            continue
        with house_style():
            figure = new_figure(COLUMN_IN, 0.9 + 0.27 * len(networks))
            _draw(figure.add_subplot(), differences, paired, metric, reference)
            if RESIMULATION in differences:
                figure.legend(loc="outside upper center", ncols=2, frameon=False, handlelength=1.4)
            written[metric] = save_figure(figure, folder / f"boxplot_{metric}")
    return written
