"""Figures with a panel a metric: paired differences as the paper's Fig. 4, and every training."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ablate.analysis.components import Component
from ablate.analysis.figures.style import (
    axis_title,
    draw_resimulation,
    house_style,
    metric_panels,
    one_legend,
    save_figure,
    shown_name,
)
from ablate.analysis.scored import REFERENCE, RESIMULATION, finite_values, ordered_variants
from ablate.analysis.statistics.paired import aligned_differences

BOX_IN = 0.26  # height of a row with a box
BOX_STYLE: dict[str, Any] = {
    **{"orientation": "horizontal", "widths": 0.5, "whis": (5, 95), "patch_artist": True, "manage_ticks": False},
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
    """Draw paired differences to the reference as box plots of these metrics side by side, as the paper's Fig. 4.

    Boxes are quartiles, whiskers the 5th and 95th percentile over frames; the grey band and the line in it are the re-
    simulation's difference; the bar under a box is the interval of the median shift over sites. Metrics without pairs
    are left out. The files are a PNG and a PDF at `stem`, a path without suffix; none without the reference or a second
    variant. `per_image` is as for `comparison_table`; the intervals are those of `paired`, which `paired_table` gives.
    Changes of `components` are written in short.
    """
    drawn: dict[str, dict[str, np.ndarray]] = {}
    for metric in metrics:
        pairs = aligned_differences(per_image, metric, reference)
        finite = {v: p[np.isfinite(p[["value", "reference"]]).all(axis=1)] for v, p in pairs.items()}
        differences = {v: (p["value"] - p["reference"]).to_numpy() for v, p in finite.items() if len(p)}
        if set(differences) - {RESIMULATION}:
            drawn[metric] = differences
    networks = list(dict.fromkeys(name for shown in drawn.values() for name in shown if name != RESIMULATION))
    if not networks:
        return []
    with house_style():
        figure, panels = metric_panels(list(drawn), [shown_name(n, components) for n in networks], 3, BOX_IN)
        for axes, (metric, differences) in zip(panels, drawn.items(), strict=True):
            if RESIMULATION in differences:
                lower, middle, upper = np.quantile(differences[RESIMULATION], [0.25, 0.5, 0.75])
                axes.axvspan(lower, upper, color="#DDDDDD", zorder=0)
                draw_resimulation(axes, metric, float(middle), "re-simulation, median and quartiles")
            axes.axvline(0, color="black", lw=0.8, zorder=1)
            places = {name: len(networks) - k for k, name in enumerate(networks) if name in differences}
            axes.boxplot([differences[name] for name in places], positions=list(places.values()), **BOX_STYLE)
            for row in [] if paired is None else paired[paired["metric"] == metric].to_dict("records"):
                if row["variant"] in places and np.isfinite([row["lower"], row["upper"]]).all():
                    place = [places[row["variant"]] - 0.37] * 2
                    axes.plot([row["lower"], row["upper"]], place, color="black", lw=1.8, solid_capstyle="butt")
            axes.set_xlabel(axis_title(metric, f"Δ {{}} to {reference}"))
        one_legend(figure, panels, 3)
        return save_figure(figure, stem)


def seed_plot(
    per_image: pd.DataFrame,
    scalars: pd.DataFrame | None,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw one ring a training at its mean over the test frames of which all have a value, with the re-simulation.

    The grey band is the range of the reference's trainings. Metrics without a finite value are left out. The files are
    as for `boxplot_panels`, none without a network. `per_image` and `scalars` are as for `comparison_table`.
    """
    values = finite_values(per_image, scalars)
    networks = values[values["variant"] != RESIMULATION]
    shown = [metric for metric in metrics if metric in set(networks["metric"])]
    if not shown:
        return []
    rows = ordered_variants(list(networks["variant"]), reference)
    means = networks.groupby(["metric", "variant", "seed"])["value"].mean()
    floors = values[values["variant"] == RESIMULATION].groupby("metric")["value"].mean()
    with house_style():
        figure, panels = metric_panels(shown, [shown_name(row, components) for row in rows], 4)
        for axes, metric in zip(panels, shown, strict=True):
            for place, variant in zip(range(len(rows), 0, -1), rows, strict=True):
                if (metric, variant) not in means.index:
                    continue
                scores = means[metric, variant].to_numpy()
                places = [place] * len(scores)
                axes.plot(scores, places, "o", ms=4, mfc="none", mec="black", mew=0.8, label="one training")
                axes.plot([scores.mean()], [place], "|", ms=9, color="#0072B2", mew=1.8, label="mean", zorder=1)
                if variant == reference:
                    axes.axvspan(scores.min(), scores.max(), color="#E3E3E3", zorder=0, label=f"range of {reference}")
            draw_resimulation(axes, metric, floors.get(metric, np.nan))
            axes.set_xlabel(axis_title(metric))
        one_legend(figure, panels, 5)
        return save_figure(figure, stem)
