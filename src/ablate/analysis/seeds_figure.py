"""What every training scored: the spread over seeds that a claim about a component has to stand out from."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ablate.analysis.figure_style import house_style, save_figure
from ablate.analysis.metric_facts import REFERENCE, RESIMULATION
from ablate.analysis.metric_panels import (
    axis_title,
    draw_resimulation,
    metric_panels,
    one_legend,
    place_of,
    resimulation_means,
)
from ablate.analysis.order import ordered_variants


def seed_plot(
    per_image: pd.DataFrame,
    scalars: pd.DataFrame | None,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
) -> list[Path]:
    """Draw one ring a training at its mean over the test frames, a panel a metric, with the re-simulation.

    The grey band is the range of the reference's trainings.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value.
    metrics : sequence of str
        Panels; those without a finite value are left out.
    stem : Path
        Path without suffix, for instance `seeds`.
    reference : str

    Returns
    -------
    list of Path
        PNG and PDF; empty without a network.
    """
    columns = ["variant", "seed", "metric", "value"]
    values = per_image[columns] if scalars is None else pd.concat([per_image[columns], scalars[columns]])
    values = values[np.isfinite(values["value"])]
    networks = values[values["variant"] != RESIMULATION]
    shown = [metric for metric in metrics if metric in set(networks["metric"])]
    if not shown:
        return []
    rows = ordered_variants(list(networks["variant"]), reference)
    means = networks.groupby(["metric", "variant", "seed"])["value"].mean()
    floors = resimulation_means(values)
    with house_style():
        figure, panels = metric_panels(shown, rows, 4)
        for axes, metric in zip(panels, shown, strict=True):
            for k, variant in enumerate(rows):
                if (metric, variant) not in means.index:
                    continue
                of = means[metric, variant].to_numpy()
                at = np.full(len(of), place_of(k, len(rows)))
                axes.plot(of, at, "o", ms=4, mfc="none", mec="black", mew=0.8, label="one training")
                axes.plot(of.mean(keepdims=True), at[:1], "|", ms=9, color="#0072B2", mew=1.8, label="mean", zorder=1)
                if variant == reference:
                    axes.axvspan(of.min(), of.max(), color="#E3E3E3", zorder=0, label=f"range of {reference}")
            draw_resimulation(axes, metric, floors.get(metric, np.nan))
            axes.set_xlabel(axis_title(metric))
        one_legend(figure, panels, 5)
        return save_figure(figure, stem)
