"""Where images differ from their target: maps of patch chi-square, as the paper's Fig. 3."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from ablate.analysis.components import Component
from ablate.analysis.figures.picture_parts import ACROSS, MOST_TALL, draw_grey, draw_picture, shown_variants
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure
from ablate.analysis.figures.style import PAGE_IN, house_style, new_figure, save_figure, shown_name
from ablate.analysis.pictures import FramePictures
from ablate.analysis.results import StudyResults
from ablate.analysis.tables import NOTHING
from ablate.metrics import patch_chi2, patches_inside, rms

PAGE_HIGH_IN = 9.6  # what a page of a paper has
PATCH = 20  # px, of the maps


def chi2_maps_figure(frame: FramePictures, stem: Path, components: Sequence[Component] = ()) -> list[Path]:
    """Patch chi-square maps on [0, 1] above their images; the target comes last, as in the paper.

    The files are a PNG and a PDF at `stem`, a path without suffix.
    """
    names = shown_variants([frame])
    height, width = frame.target.shape
    across, line_in = _layout(len(names) + 1, min(height / width, MOST_TALL))
    lines = -(-(len(names) + 1) // across)
    inside = patches_inside(frame.mask, PATCH)
    with house_style():
        figure = new_figure(PAGE_IN, lines * line_in, pad_in=0.015)
        grid = figure.subplots(2 * lines, across, squeeze=False)
        for axes in grid.ravel():
            axes.set_axis_off()
        maps = grid[::2].ravel()
        images = grid[1::2].ravel()
        for upper, lower, name in zip(maps, images, names, strict=False):
            chi2 = patch_chi2(frame.predictions[name], frame.target, PATCH)
            extent = (0, chi2.shape[1] * PATCH, chi2.shape[0] * PATCH, 0)
            shown = np.ma.masked_array(chi2, ~inside)
            drawn = draw_picture(upper, shown, cmap="inferno", vmin=0, vmax=1, extent=extent)
            upper.set(xlim=(0, width), ylim=(height, 0), aspect="equal", facecolor="#EEEEEE")
            whole = rms(chi2, inside)
            number = NOTHING if whole is None else f"{whole:.3f}"
            upper.set_title(f"{shown_name(name, components)}\n{number}")
            draw_grey(lower, frame.predictions[name])
        bar = figure.colorbar(drawn, cax=maps[len(names)].inset_axes((0.1, 0.5, 0.8, 0.1)), orientation="horizontal")
        bar.set_label("pχ²")
        bar.set_ticks([0, 0.5, 1])
        draw_grey(images[len(names)], frame.target)
        images[len(names)].set_title("target")
        return save_figure(figure, stem)


def _layout(pictures: int, tall: float) -> tuple[int, float]:
    """How many pictures, each `tall` widths high, stand side by side, and the inches of a line of them.

    Three to five, as many as leave the fewest places of a page empty.
    """
    line_in = {across: 0.45 + 2 * PAGE_IN / max(across, 3) * tall for across in range(1, ACROSS + 2)}
    candidates = [ACROSS, 3, ACROSS + 1]
    fitting = [across for across in candidates if -(-pictures // across) * line_in[across] <= PAGE_HIGH_IN]
    across = min(pictures, min(fitting, key=lambda across: -pictures % across, default=ACROSS + 1))
    return across, line_in[across]


def _of_study(results: StudyResults, folder: Path) -> Iterator[Drawing]:
    for number, frame in enumerate(results.pictures):
        files = chi2_maps_figure(frame, folder / f"pchi2_maps_{number}", results.components)
        yield Drawing(files, facts={"frame": frame.name}, folded=number > 0)


CHI2_MAPS = StudyFigure(name="pchi2_maps", section=Section.figures, draw=_of_study, place=50)
