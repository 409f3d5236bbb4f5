"""What every training scored: the spread over seeds that a claim about a component has to stand out from."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ablate.analysis.components import Component
from ablate.analysis.figures.metric_panels import axis_title, draw_resimulation, metric_panels, one_legend, shown_name
from ablate.analysis.figures.style import house_style, save_figure
from ablate.analysis.order import REFERENCE, RESIMULATION, ordered_variants
from ablate.analysis.values import finite_values


def seed_plot(
    per_image: pd.DataFrame,
    scalars: pd.DataFrame | None,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw one ring a training at its mean over the test frames, a panel a metric, with the re-simulation.

    The grey band is the range of the reference's trainings. Metrics without a finite value are left out. The files are
    a PNG and a PDF at `stem`, a path without suffix; none without a network.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value.
    components : sequence of Component
        Changes of these are written in short.
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
            for k, variant in enumerate(rows):
                if (metric, variant) not in means.index:
                    continue
                of = means[metric, variant].to_numpy()
                at = np.full(len(of), len(rows) - k)
                axes.plot(of, at, "o", ms=4, mfc="none", mec="black", mew=0.8, label="one training")
                axes.plot(of.mean(keepdims=True), at[:1], "|", ms=9, color="#0072B2", mew=1.8, label="mean", zorder=1)
                if variant == reference:
                    axes.axvspan(of.min(), of.max(), color="#E3E3E3", zorder=0, label=f"range of {reference}")
            draw_resimulation(axes, metric, floors.get(metric, np.nan))
            axes.set_xlabel(axis_title(metric))
        one_legend(figure, panels, 5)
        return save_figure(figure, stem)
