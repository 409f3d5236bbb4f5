"""The picture of all that is seen of a state.

All images of one state are one picture, so that what stands side by side was seen at the same moment.
"""

import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from ablate.analysis.figures.scene_parts import Colour
from ablate.viewer import calipers
from ablate.viewer.pictures import (
    HEIGHT_PX,
    PAPER,
    WHOLE,
    Window,
    difference_picture,
    empty_picture,
    font,
    framed,
    label_picture,
    mark,
    picture_size,
    point_of,
    share_picture,
)
from ablate.viewer.session import Quality, Views

_BAR_PX, _GAP_PX, _EDGE_PX, _LETTER_PX = 30, 6, 4, 20  # where a picture has HEIGHT_PX
_INK = (235, 238, 242)
_DIM = (140, 150, 160)
_LINE = 42  # characters of words in place of a picture
_NOTE = 30  # characters


class Shown(StrEnum):
    """Which images are shown: all, the B-mode image over a generated one, or the B-mode image alone, the largest."""

    all = "all images"
    pair = "B-mode and generated"
    bmode = "one large B-mode"


class _Tile(NamedTuple):
    """Title and note of an image, and its picture or the words in its place."""

    title: str
    note: str
    shown: Image.Image | str


@dataclass(frozen=True, eq=False)
class Layout:
    """Which images are shown, and how.

    `names` are those of runs, by folder; `points` are measured, (n, 3) mm in the world; `window` is the part that is
    seen of each image.
    """

    names: Mapping[Path, str] = field(default_factory=dict)
    difference: bool = False
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))
    shown: Shown = Shown.all
    window: Window = WHOLE


def screen(views: Views, colours: Sequence[Colour], layout: Layout) -> np.ndarray:
    """The picture of all images that are shown, (h, w, 3) uint8."""
    points = calipers.in_plane(layout.points, views.state.pose)
    pictures = []
    for draw in _tiles(views, colours, layout):
        tile = draw()
        picture = tile.shown
        if isinstance(picture, str):
            picture = empty_picture(picture, views.mask.shape, views.quality)
        mark(picture, points, views.state.probe, layout.window)
        pictures.append((tile.title, tile.note, picture))
    return _mosaic(pictures)


def point_at(views: Views, layout: Layout, place: tuple[float, float]) -> np.ndarray | None:
    """x and z, (2,) mm, of a place in the picture of all images, shares of its width and height; None beside them."""
    size = picture_size(views.mask.shape, views.quality)
    count = len(_tiles(views, (), layout))
    cells = _cells(size, count)
    canvas = cells.canvas(count)
    x, y = place[0] * canvas[0], place[1] * canvas[1]
    column, row = int(x // cells.step[0]), int(y // cells.step[1])
    left, top = cells.corner(row * cells.columns + column)
    inside = np.array([(x - left) / size[0], (y - top) / size[1]])
    if column >= cells.columns or row * cells.columns + column >= count or not ((inside >= 0) & (inside < 1)).all():
        return None
    return point_of(inside, views.state.probe, layout.window)


def _tiles(views: Views, colours: Sequence[Colour], layout: Layout) -> list[Callable[[], _Tile]]:
    """What draws each image that is shown: the simulated one, generated ones, S, A and the difference."""
    window = layout.window
    runs = range(len(views.state.runs))
    generated: list[Callable[[], _Tile]] = [partial(_generated, views, run, layout.names, window) for run in runs]
    if not generated:
        generated = [lambda: _Tile("generated", "", "no generator is picked:\nchoose one under Compare")]
    tiles: list[Callable[[], _Tile]] = [partial(_simulated, views, window)]
    if layout.shown is Shown.bmode:
        return tiles
    tiles.append(generated[0])
    if layout.shown is Shown.pair:
        return tiles
    tiles += [partial(_segmentation, views, colours, window), partial(_attenuation, views, window), *generated[1:]]
    if layout.difference:
        tiles.append(partial(_difference, views, window))
    return tiles


def _simulated(views: Views, window: Window) -> _Tile:
    how = "coarse" if views.quality is Quality.coarse else "full quality"
    note = f"{how}, {views.ms['target']:.0f} ms" if "target" in views.ms else ""
    shown: Image.Image | str = "the simulator rests while the probe moves"
    if views.target is not None:
        shown = framed(views.target, views.mask, views.state.probe, views.quality, window=window)
    return _Tile("simulated B-mode", note, shown)


def _segmentation(views: Views, colours: Sequence[Colour], window: Window) -> _Tile:
    labels = label_picture(views.segmentation, colours, views.state.probe, views.quality, window)
    return _Tile("segmentation S", "", labels)


def _attenuation(views: Views, window: Window) -> _Tile:
    shares = share_picture(views.attenuation, views.mask, views.state.probe, views.quality, window)
    return _Tile("attenuation A", f"S and A: {views.ms['maps']:.0f} ms", shares)


def _generated(views: Views, number: int, names: Mapping[Path, str], window: Window) -> _Tile:
    key = f"generated {number}"
    run = views.state.runs[number]
    title = f"generated: {names.get(run, run.name)}"
    image = views.generated[number]
    if image is None:
        words = views.notes.get(key, "this generator has not rendered yet")
        return _Tile(title, "", textwrap.fill(words, _LINE))
    note = views.notes.get(key, f"{views.ms[key]:.0f} ms").partition(";")[0]  # the caption has all of it
    short = textwrap.shorten(note, _NOTE, placeholder=" ...")
    return _Tile(title, short, framed(image, views.mask, views.state.probe, views.quality, window=window))


def _difference(views: Views, window: Window) -> _Tile:
    first = views.generated[0] if views.generated else None
    if first is None or views.target is None:
        return _Tile("difference", "", "a difference needs a simulated\nand a generated image")
    picture = difference_picture(first, views.target, views.mask, views.state.probe, views.quality, window)
    return _Tile("generated - simulated", "red: brighter, blue: darker", picture)


class _Cells(NamedTuple):
    """Where pictures of one size stand on their canvas, px."""

    columns: int
    step: tuple[int, int]  # from cell to cell, to the right and down
    margin: int  # to the left and the right of a picture in its cell
    bar: int  # above it
    gap: int

    def corner(self, number: int) -> tuple[int, int]:
        """The upper left corner of a picture."""
        column, row = number % self.columns, number // self.columns
        return column * self.step[0] + self.margin, row * self.step[1] + self.bar

    def canvas(self, count: int) -> tuple[int, int]:
        """Width and height of the canvas of so many pictures."""
        return self.columns * self.step[0] - self.gap, -(-count // self.columns) * self.step[1] - self.gap


def _cells(size: tuple[int, int], count: int) -> _Cells:
    """The cells of so many pictures of one size; up to two stand below each other, as large as can be."""
    bar, gap = (round(px * size[1] / HEIGHT_PX) for px in (_BAR_PX, _GAP_PX))
    # Narrow images get margins: their titles fit, and S and A stay above the fold.
    width = max(size[0], size[1] * 5 // 4)
    return _Cells(1 if count <= 2 else 2, (width + gap, size[1] + bar + gap), (width - size[0]) // 2, bar, gap)


def _mosaic(tiles: Sequence[tuple[str, str, Image.Image]]) -> np.ndarray:
    """Pictures of one size, with a title and a note above each, as one picture, (h, w, 3) uint8."""
    size = tiles[0][2].size
    cells = _cells(size, len(tiles))
    edge, letter = (round(px * size[1] / HEIGHT_PX) for px in (_EDGE_PX, _LETTER_PX))
    width = cells.step[0] - cells.gap
    canvas = Image.new("RGB", cells.canvas(len(tiles)), PAPER)
    draw = ImageDraw.Draw(canvas)
    letters = font(letter)
    for number, (title, note, picture) in enumerate(tiles):
        left, top = cells.corner(number)
        x, middle = left - cells.margin, top - cells.bar / 2
        spare = width - draw.textlength(note, font=letters) - 5 * edge
        while title and draw.textlength(title, font=letters) > spare:
            title = title[:-2].rstrip(" .") + "." if len(title) > 2 else ""
        draw.text((x + edge, middle), title, fill=_INK, font=letters, anchor="lm")
        draw.text((x + width - edge, middle), note, fill=_DIM, font=letters, anchor="rm")
        canvas.paste(picture, (left, top))
    return np.asarray(canvas)
