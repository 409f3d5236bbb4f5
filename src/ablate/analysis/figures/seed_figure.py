"""Every training as a ring at its score, a panel a metric."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import pandas as pd

from ablate.analysis.components import Component
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure
from ablate.analysis.figures.style import (
    axis_title,
    draw_baselines,
    house_style,
    metric_panels,
    one_legend,
    save_figure,
    shown_name,
)
from ablate.analysis.results import StudyResults
from ablate.analysis.scored import REFERENCE, finite_values, is_network, ordered_variants
from ablate.metrics import Shown, shown_in


def seed_plot(
    per_image: pd.DataFrame,
    scalars: pd.DataFrame | None,
    metrics: Sequence[str],
    stem: Path,
    reference: str = REFERENCE,
    components: Sequence[Component] = (),
) -> list[Path]:
    """Draw one ring a training at its mean over the test frames of which all have a value, with the baselines.

    The grey band is the range of the reference's trainings. Without a network no file is made.

    Parameters
    ----------
    per_image, scalars : DataFrame
        As for `comparison_table`.
    metrics : sequence of str
        Those without a finite value are left out.
    stem : Path
        Of the files, without suffix.
    reference : str
        The variant that the others are compared with.
    components : sequence of Component
        Changes of these are written in short.
    """
    values = finite_values(per_image, scalars)
    networks = values[is_network(values["variant"])]
    shown = [metric for metric in metrics if metric in set(networks["metric"])]
    if not shown:
        return []
    rows = ordered_variants(list(networks["variant"]), reference)
    means = networks.groupby(["metric", "variant", "seed"])["value"].mean()
    baselines = values[~is_network(values["variant"])].groupby(["metric", "variant"])["value"].mean()
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
            if metric in baselines.index:
                draw_baselines(axes, metric, baselines[metric].to_dict())
            axes.set_xlabel(axis_title(metric))
        one_legend(figure, panels, 5)
        return save_figure(figure, stem)


def _of_study(results: StudyResults, folder: Path) -> Iterator[Drawing]:
    metrics = shown_in(Shown.panels)
    files = seed_plot(
        results.per_image,
        results.scalars,
        metrics,
        folder / "seeds",
        reference=results.reference,
        components=results.components,
    )
    yield Drawing(files, metrics=metrics)


SEEDS = StudyFigure(name="seeds", section=Section.figures, draw=_of_study, place=40)
