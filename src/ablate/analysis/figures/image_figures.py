"""Figures made of pictures: the qualitative grid and the patch chi-square maps."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from ablate.analysis.components import Component
from ablate.analysis.figures.style import PAGE_IN, house_style, new_figure, save_figure, shown_name
from ablate.analysis.scored import CHANGED, variant_group
from ablate.analysis.tables import NOTHING
from ablate.metrics import patch_chi2, patches_inside, rms

ACROSS = 4  # pictures side by side on a page; with more of them, speckle is lost in print
MOST_DOWN, MOST_TALL = 7, 5.0  # rows of pictures that a page holds; height of the place of one, in widths
PAGE_HIGH_IN = 9.6  # what a page of a paper has
NAME_IN, HEAD_IN = 0.2, 0.25  # beside and above the pictures, for their names
PATCH = 20  # px, of the chi-square maps
GREY: dict[str, Any] = {"vmin": 0, "vmax": 255, "interpolation": "antialiased"}  # how 8 bits are shown
INSET = 0.27  # of the picture's width and height: what fits beside a 70 degree fan


@dataclass(frozen=True, eq=False)
class FramePictures:
    """What was rendered of one test frame; `name` stands at the left of its row.

    All images are (H, W): `target` and `segmentation` uint8, `mask` bool, the fan, `attenuation` in [0, 1] or None, and
    `predictions` uint8 by variant, in the order shown, after the re-simulation under its own name. Labels and shadows
    are each shown in a corner of the target.
    """

    name: str
    target: np.ndarray
    predictions: dict[str, np.ndarray]
    mask: np.ndarray
    segmentation: np.ndarray
    attenuation: np.ndarray | None = None


def _picture(axes: Axes, image: np.ndarray, colours: str = "gray", **how: Any) -> AxesImage:
    axes.set_axis_on()
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_visible(False)
    return axes.imshow(image, cmap=colours, **how)


def _insets(axes: Axes, frame: FramePictures) -> None:
    """S at the top left and A at the top right: the corners that a fan leaves black."""
    corners = [(0.0, np.ma.masked_array(frame.segmentation, ~frame.mask | (frame.segmentation == 0)), "cividis")]
    if frame.attenuation is not None:
        # Attenuation falls over decades with depth: its logarithm is what shows shadows.
        log = np.log10(np.maximum(frame.attenuation.astype(np.float32), 1e-4))
        corners.append((1 - INSET, np.ma.masked_array(log, ~frame.mask), "gray"))
    for left, shown, colours in corners:
        corner = axes.inset_axes((left, 1 - INSET, INSET, INSET), facecolor="none")
        _picture(corner, shown, colours, interpolation="nearest")


def _columns(frames: Sequence[FramePictures]) -> list[str]:
    """Names of all predictions as they come, what was changed beside a variant last."""
    names = dict.fromkeys(name for frame in frames for name in frame.predictions)
    return sorted(names, key=lambda name: variant_group(name) == CHANGED)


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
    names = ["target", *_columns(frames)]
    blocks = min(max(-(-len(names) // MOST_DOWN), ACROSS // len(frames)), len(names))
    down = -(-len(names) // blocks)
    blocks = -(-len(names) // down)  # no column is left empty
    across = blocks * len(frames)
    single = across > 1 and len(frames) == 1
    height, width = frames[0].target.shape
    page = PAGE_IN * max(across / ACROSS, 1.0) if across > 1 else PAGE_IN / 2
    picture = (page - (0 if single else NAME_IN * blocks)) / max(across, 2)
    heads_in = HEAD_IN * (down if single else 1)
    with house_style(page):
        figure = new_figure(page, heads_in + down * picture * min(height / width, MOST_TALL), pad_in=0.01)
        grid = figure.subplots(down, across, squeeze=False)
        for axes in grid.ravel():
            axes.set_axis_off()
        for k, name in enumerate(names):
            block, row = divmod(k, blocks)[::-1] if single else divmod(k, down)
            for j, frame in enumerate(frames):
                axes = grid[row, block * len(frames) + j]
                image = frame.target if name == "target" else frame.predictions.get(name)
                if image is None:
                    continue
                _picture(axes, image, **GREY)
                if name == "target":
                    _insets(axes, frame)
                if single:
                    axes.set_title(f"{frame.name}: target" if name == "target" else shown_name(name, components))
                elif j == 0:
                    axes.set_ylabel(shown_name(name, components).replace(" ", "\n", 1))
                if row == 0 and not single:
                    axes.set_title(frame.name)
        return save_figure(figure, stem)


def chi2_maps_figure(frame: FramePictures, stem: Path, components: Sequence[Component] = ()) -> list[Path]:
    """Patch chi-square maps on [0, 1] above their images; the target comes last, as in the paper.

    The files are a PNG and a PDF at `stem`, a path without suffix.
    """
    names = _columns([frame])
    height, width = frame.target.shape
    inside = patches_inside(frame.mask, PATCH)
    pictures = len(names) + 1
    line_in = {n: 0.45 + 2 * PAGE_IN / max(n, 3) * min(height / width, MOST_TALL) for n in range(1, ACROSS + 2)}
    # Three to five side by side, as many as leave the fewest places of a page empty.
    fitting = [n for n in (ACROSS, 3, ACROSS + 1) if -(-pictures // n) * line_in[n] <= PAGE_HIGH_IN]
    across = min(pictures, min(fitting, key=lambda n: -pictures % n, default=ACROSS + 1))
    lines = -(-pictures // across)
    with house_style():
        figure = new_figure(PAGE_IN, lines * line_in[across], pad_in=0.015)
        grid = figure.subplots(2 * lines, across, squeeze=False)
        for axes in grid.ravel():
            axes.set_axis_off()
        maps, images = grid[::2].ravel(), grid[1::2].ravel()
        for upper, lower, name in zip(maps, images, names, strict=False):
            chi2 = patch_chi2(frame.predictions[name], frame.target, PATCH)
            shown = np.ma.masked_array(chi2, ~inside)
            extent = (0, chi2.shape[1] * PATCH, chi2.shape[0] * PATCH, 0)
            drawn = _picture(upper, shown, "inferno", vmin=0, vmax=1, extent=extent)
            upper.set(xlim=(0, width), ylim=(height, 0), aspect="equal", facecolor="#EEEEEE")
            whole = rms(chi2, inside)
            upper.set_title(f"{shown_name(name, components)}\n{NOTHING if whole is None else f'{whole:.3f}'}")
            _picture(lower, frame.predictions[name], **GREY)
        bar = figure.colorbar(drawn, cax=maps[len(names)].inset_axes((0.1, 0.5, 0.8, 0.1)), orientation="horizontal")
        bar.set_label("pχ²")
        bar.set_ticks([0, 0.5, 1])
        _picture(images[len(names)], frame.target, **GREY)
        images[len(names)].set_title("target")
        return save_figure(figure, stem)
