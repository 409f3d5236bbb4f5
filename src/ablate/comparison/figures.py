"""Every figure of a comparison with its caption, in the order of the report."""

from collections.abc import Sequence
from pathlib import Path

from ablate import analysis
from ablate.analysis import RESIMULATION, FramePictures
from ablate.comparison.frame_times import timed_on
from ablate.comparison.reading import Study
from ablate.comparison.results import pictures, runtime_points
from ablate.metrics import Shown, shown_in
from ablate.runs.run import Run


def stored_pictures(runs: Sequence[Run], reference: str) -> tuple[list[FramePictures], str]:
    """The frames that can be shown, and where pairs or pictures are missing or damaged the reason, for the report."""
    try:
        frames = pictures(runs, reference)
    except (OSError, ValueError, KeyError) as error:
        return [], f"There are no pictures: {' '.join(str(error).split())}."
    return frames, "" if frames else "There are no pictures: the runs kept no frame in common."


def draw_figures(study: Study, frames: Sequence[FramePictures], folder: Path) -> list[tuple[Path, str]]:
    """Draw every figure for which there are numbers or pictures; returns PNGs and PDFs, each with its caption."""
    reference, per_image, answers = study.reference, study.per_image, study.answers
    design, means, effects, components = answers.design, answers.means, answers.effects, answers.components
    made: list[tuple[Path, str]] = []

    def add(paths: Sequence[Path], caption: str) -> None:
        made.extend((path, caption) for path in paths)

    runs = analysis.improvements(means, design, components)
    pairs = analysis.interactions(means, design, components)
    paths = analysis.forest_figure(answers.verdicts, runs, pairs, components, folder / "verdicts")
    add(paths, analysis.verdicts_caption(design, reference))
    page = analysis.frames_a_page(len(frames[0].predictions)) if frames else 1
    for k, start in enumerate(range(0, len(frames), page)):
        paths = analysis.qualitative_figure(frames[start : start + page], folder / f"qualitative_{k}", components)
        add(paths, analysis.QUALITATIVE_CAPTION.format(reference=reference))
    boxes = [name for name in shown_in(Shown.headline) if name in set(per_image["metric"])]
    drawn = analysis.boxplot_panels(per_image, boxes, folder / "boxplots", reference, study.paired, components)
    add(drawn, analysis.boxplot_caption(boxes, reference))
    panels = shown_in(Shown.panels)
    add(
        analysis.seed_plot(per_image, study.scalars, panels, folder / "seeds", reference, components),
        analysis.seeds_caption(panels, reference),
    )
    if design is not None and len(effects):
        scored = study.table.pivot(index="metric", columns="variant", values="mean")
        scored = scored.reindex(columns=[RESIMULATION, reference])  # NaN where there is none
        gaps = {str(m): floor - mean for m, floor, mean in scored.dropna().itertuples()}
        drawn = analysis.effects_plot(effects, panels, folder / "effects", gaps)
        add(drawn, analysis.effects_caption(design, effects, reference if gaps else None))
    for k, frame in enumerate(frames):
        paths = analysis.chi2_maps_figure(frame, folder / f"pchi2_maps_{k}", components)
        add(paths, analysis.CHI2_CAPTION.format(frame=frame.name))
    points, floors = runtime_points(study.table)
    if len(points):
        paths = analysis.error_vs_runtime(
            points, folder / "error_vs_runtime", floors, timed_on(study.usable.all), components=components
        )
        add(paths, analysis.runtime_caption(list(dict.fromkeys(points["metric"]))))
    for metric in analysis.ordered_metrics(list(per_image["metric"])):
        stem = folder / f"boxplot_{metric}"
        paths = analysis.boxplot_panels(per_image, [metric], stem, reference, study.paired, components)
        add(paths, analysis.boxplot_caption([metric], reference))
    return made
