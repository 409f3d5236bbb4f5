"""Test frames beside what every variant rendered of them, as the paper's Fig. 2."""

import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from ablate.analysis.components import Component
from ablate.analysis.figures.picture_parts import ACROSS, MOST_TALL, draw_grey, draw_picture, shown_variants
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure
from ablate.analysis.figures.style import PAGE_IN, house_style, new_figure, save_figure, shown_name
from ablate.analysis.pictures import FramePictures
from ablate.analysis.results import StudyResults

MOST_DOWN = 7  # rows of pictures that a page holds
NAME_IN, HEAD_IN = 0.2, 0.25  # beside and above the pictures, for their names
EM = 0.6  # width of a letter, in sizes of the type
INSET = 0.27  # of the picture's width and height: what fits beside a 70 degree fan


def frames_a_page(predictions: int) -> int:
    """How many frames `qualitative_figure` can show on one page, each with its target and so many predictions.

    1 to 4: as many columns of pictures as are left when a frame's pictures take one or more.
    """
    return max(1, ACROSS // -(-(predictions + 1) // MOST_DOWN))


def qualitative_figure(frames: Sequence[FramePictures], stem: Path, components: Sequence[Component] = ()) -> list[Path]:
    """Target, re-simulation and every variant below each other, a column a frame, S and A in the target's corners.

    Variants that do not fit continue in further columns; `frames_a_page` says how many frames fit. The pictures of a
    single frame fill line after line instead, each below its name. The files are a PNG and a PDF at `stem`, a path
    without suffix.
    """
    names = ["target", *shown_variants(frames)]
    blocks = min(max(-(-len(names) // MOST_DOWN), ACROSS // len(frames)), len(names))
    down = -(-len(names) // blocks)
    blocks = -(-len(names) // down)  # no column is left empty
    across = blocks * len(frames)
    single = across > 1 and len(frames) == 1
    page_in = PAGE_IN * max(across / ACROSS, 1.0) if across > 1 else PAGE_IN / 2
    names_in = 0.0 if single else NAME_IN * blocks
    heads_in = HEAD_IN * down if single else HEAD_IN
    height, width = frames[0].target.shape
    picture_in = (page_in - names_in) / max(across, 2)
    tall_in = picture_in * min(height / width, MOST_TALL)
    with house_style(page_in):
        figure = new_figure(page_in, heads_in + down * tall_in, pad_in=0.01)
        grid = figure.subplots(down, across, squeeze=False)
        for axes in grid.ravel():
            axes.set_axis_off()
        if single:
            _fill_lines(list(grid.ravel()), frames[0], names, components)
        else:
            _fill_columns(grid, frames, names, components, tall_in)
        return save_figure(figure, stem)


def _fill_lines(
    panels: Sequence[Axes], frame: FramePictures, names: Sequence[str], components: Sequence[Component]
) -> None:
    """The pictures of a single frame, each below its name."""
    for axes, name in zip(panels, names, strict=False):
        _draw_of(axes, frame, name)
        axes.set_title(f"{frame.name}: target" if name == "target" else shown_name(name, components))


def _fill_columns(
    grid: np.ndarray,
    frames: Sequence[FramePictures],
    names: Sequence[str],
    components: Sequence[Component],
    tall_in: float,
) -> None:
    """A column a frame, its name above; the names of variants stand at the left, in lines of a picture's height."""
    down = len(grid)
    letters = max(int(tall_in / (EM * mpl.rcParams["font.size"] / 72)), 1)
    for k, name in enumerate(names):
        block, row = divmod(k, down)
        panels = grid[row, block * len(frames) :]
        for j, frame in enumerate(frames):
            if not _draw_of(panels[j], frame, name):
                continue
            if j == 0:
                panels[j].set_ylabel(textwrap.fill(shown_name(name, components), letters))
            if row == 0:
                panels[j].set_title(frame.name)


def _draw_of(axes: Axes, frame: FramePictures, name: str) -> bool:
    """Draw the target of a frame, or what a variant rendered of it; whether there is such an image."""
    image = frame.target if name == "target" else frame.predictions.get(name)
    if image is None:
        return False
    draw_grey(axes, image)
    if name == "target":
        _draw_insets(axes, frame)
    return True


def _draw_insets(axes: Axes, frame: FramePictures) -> None:
    """S at the top left and A at the top right: the corners that a fan leaves black."""
    labels = np.ma.masked_array(frame.segmentation, ~frame.mask | (frame.segmentation == 0))
    _draw_inset(axes, labels, left=0.0, colours="cividis")
    if frame.attenuation is not None:
        # Attenuation falls over decades with depth: its logarithm is what shows shadows.
        log = np.log10(np.maximum(frame.attenuation.astype(np.float32), 1e-4))
        _draw_inset(axes, np.ma.masked_array(log, ~frame.mask), left=1 - INSET, colours="gray")


def _draw_inset(axes: Axes, image: np.ndarray, left: float, colours: str) -> None:
    corner = axes.inset_axes((left, 1 - INSET, INSET, INSET), facecolor="none")
    draw_picture(corner, image, cmap=colours, interpolation="nearest")


def _of_study(results: StudyResults, folder: Path) -> Iterator[Drawing]:
    frames = results.pictures
    page = frames_a_page(len(frames[0].predictions)) if frames else 1
    for number, start in enumerate(range(0, len(frames), page)):
        files = qualitative_figure(frames[start : start + page], folder / f"qualitative_{number}", results.components)
        yield Drawing(files, facts={"attenuation": frames[start].attenuation is not None})


QUALITATIVE = StudyFigure(name="qualitative", section=Section.figures, draw=_of_study, place=20)
