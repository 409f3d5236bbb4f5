"""Every figure of a comparison with its caption, in the order of the report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import pandas as pd

from ablate.analysis import (
    RESIMULATION,
    Design,
    FramePictures,
    boxplot_caption,
    boxplot_panels,
    chi2_caption,
    chi2_maps_figure,
    effects_caption,
    effects_plot,
    error_vs_runtime,
    frames_a_page,
    paired_boxplots,
    qualitative_caption,
    qualitative_figure,
    runtime_caption,
    seed_plot,
    seeds_caption,
)
from ablate.studies.results import Finished, pictures, runtime_points
from ablate.tracking import hardware

_FIGURE_4 = ("psnr", "mae", "pchi2")  # of the paper; every metric has its own picture beside
_PANELS = (
    *("psnr", "mae", "pchi2", "fd_speckle"),
    *("shadow_contrast", "mae_smooth", "nyquist_excess", "noise_sd"),
)


@dataclass(frozen=True, eq=False)
class Numbers:
    """What the figures of a comparison are drawn from.

    Attributes
    ----------
    reference : str
    per_image, scalars : DataFrame
        As `scored_frames` gives them.
    table, paired, effects : DataFrame
        What `comparison_table`, `paired_table` and `effects_table` give.
    design : Design, optional
        None where no two components vary; `effects` is then empty.
    """

    reference: str
    per_image: pd.DataFrame
    scalars: pd.DataFrame
    table: pd.DataFrame
    paired: pd.DataFrame
    effects: pd.DataFrame
    design: Design | None


def stored_pictures(runs: Sequence[Finished], reference: str) -> tuple[list[FramePictures], str]:
    """The frames that can be shown, and why there are none.

    Parameters
    ----------
    runs : sequence of Finished
    reference : str

    Returns
    -------
    frames : list of FramePictures
        Empty where pairs or pictures are not on disk, or are damaged.
    note : str
        The reason, for the report; empty otherwise.
    """
    try:
        frames = pictures(runs, reference)
    except (OSError, ValueError, KeyError, BadZipFile) as error:
        return [], f"There are no pictures: {' '.join(str(error).split())}."
    return frames, "" if frames else "There are no pictures: the runs kept no frame in common."


def draw_figures(numbers: Numbers, frames: Sequence[FramePictures], folder: Path) -> list[tuple[Path, str]]:
    """Draw what the numbers and pictures allow.

    Parameters
    ----------
    numbers : Numbers
    frames : sequence of FramePictures
    folder : Path

    Returns
    -------
    list of (Path, str)
        Files, PNG and PDF, each with its caption.
    """
    reference, per_image = numbers.reference, numbers.per_image
    made: list[tuple[Path, str]] = []

    def add(paths: Sequence[Path], caption: str) -> None:
        made.extend((path, caption) for path in paths)

    page = frames_a_page(len(frames[0].predictions)) if frames else 1
    for k, start in enumerate(range(0, len(frames), page)):
        paths = qualitative_figure(frames[start : start + page], folder / f"qualitative_{k}")
        add(paths, qualitative_caption(reference))
    add(
        boxplot_panels(per_image, _FIGURE_4, folder / "boxplots", reference, numbers.paired),
        boxplot_caption(_FIGURE_4, reference),
    )
    add(seed_plot(per_image, numbers.scalars, _PANELS, folder / "seeds", reference), seeds_caption(_PANELS, reference))
    if numbers.design is not None and len(numbers.effects):
        drawn = effects_plot(numbers.effects, _PANELS, folder / "effects", _gaps(numbers.table, reference))
        add(drawn, effects_caption(numbers.design, numbers.effects))
    for k, frame in enumerate(frames):
        add(chi2_maps_figure(frame, folder / f"pchi2_maps_{k}"), chi2_caption(frame.name))
    points, floors = runtime_points(numbers.table)
    if len(points):
        paths = error_vs_runtime(points, folder / "error_vs_runtime", floors, hardware())
        add(paths, runtime_caption(list(dict.fromkeys(points["metric"]))))
    for metric, paths in paired_boxplots(per_image, folder, reference, numbers.paired).items():
        add(paths, boxplot_caption([metric], reference))
    return made


def _gaps(table: pd.DataFrame, reference: str) -> dict[str, float]:
    """By metric, the re-simulation minus the reference."""
    means = table.pivot(index="metric", columns="variant", values="mean")
    if not {RESIMULATION, reference} <= set(means.columns):
        return {}
    return {str(metric): float(gap) for metric, gap in (means[RESIMULATION] - means[reference]).items()}
