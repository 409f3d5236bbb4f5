"""The picture of all that is seen of a state.

All images of one state are one picture, so that what stands side by side was seen at the same moment.
"""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from ablate.analysis.figures.scene_parts import Colour
from ablate.viewer import calipers
from ablate.viewer.pictures import (
    HEIGHT_PX,
    PAPER,
    difference_picture,
    empty_picture,
    font,
    framed,
    label_picture,
    mark,
    share_picture,
)
from ablate.viewer.session import Quality, Views

_COLUMNS = 2
_BAR_PX, _GAP_PX, _EDGE_PX, _LETTER_PX = 30, 6, 4, 20  # where a picture has HEIGHT_PX
_INK = (235, 238, 242)
_DIM = (140, 150, 160)
_LINE = 42  # characters of words in place of a picture
_NOTE = 30  # characters


class _Tile(NamedTuple):
    """Title and note of an image, and its picture or the words in its place."""

    title: str
    note: str
    shown: Image.Image | str


@dataclass(frozen=True, eq=False)
class Layout:
    """What is shown beside the simulated image, the segmentation and the attenuation.

    `names` are those of runs, by folder; `points` are measured, (n, 3) mm in the world.
    """

    names: Mapping[Path, str] = field(default_factory=dict)
    difference: bool = False
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))


def screen(views: Views, colours: Sequence[Colour], layout: Layout) -> np.ndarray:
    """The picture of all images, (h, w, 3) uint8: the simulated one, generated ones, S, A and the difference."""
    generated = [_generated(views, number, layout.names) for number in range(len(views.state.runs))]
    tiles = [
        _simulated(views),
        generated[0] if generated else _Tile("generated", "", "no generator is picked:\nchoose one under Compare"),
        *_maps(views, colours),
        *generated[1:],
    ]
    if layout.difference:
        tiles.append(_difference(views))
    points = calipers.in_plane(layout.points, views.state.pose)
    pictures = []
    for tile in tiles:
        picture = tile.shown
        if isinstance(picture, str):
            picture = empty_picture(picture, views.mask.shape, views.quality)
        mark(picture, points, views.state.probe)
        pictures.append((tile.title, tile.note, picture))
    return _mosaic(pictures)


def _simulated(views: Views) -> _Tile:
    how = "coarse" if views.quality is Quality.coarse else "full quality"
    note = f"{how}, {views.ms['target']:.0f} ms" if "target" in views.ms else ""
    shown: Image.Image | str = "the simulator rests while the probe moves"
    if views.target is not None:
        shown = framed(views.target, views.mask, views.state.probe, views.quality)
    return _Tile("simulated B-mode", note, shown)


def _maps(views: Views, colours: Sequence[Colour]) -> list[_Tile]:
    labels = label_picture(views.segmentation, colours, views.state.probe, views.quality)
    shares = share_picture(views.attenuation, views.mask, views.state.probe, views.quality)
    note = f"S and A: {views.ms['maps']:.0f} ms"
    return [_Tile("segmentation S", "", labels), _Tile("attenuation A", note, shares)]


def _generated(views: Views, number: int, names: Mapping[Path, str]) -> _Tile:
    key = f"generated {number}"
    run = views.state.runs[number]
    title = f"generated: {names.get(run, run.name)}"
    image = views.generated[number]
    if image is None:
        words = views.notes.get(key, "this generator has not rendered yet")
        return _Tile(title, "", textwrap.fill(words, _LINE))
    note = views.notes.get(key, f"{views.ms[key]:.0f} ms").partition(";")[0]  # the caption has all of it
    short = textwrap.shorten(note, _NOTE, placeholder=" ...")
    return _Tile(title, short, framed(image, views.mask, views.state.probe, views.quality))


def _difference(views: Views) -> _Tile:
    first = views.generated[0] if views.generated else None
    if first is None or views.target is None:
        return _Tile("difference", "", "a difference needs a simulated\nand a generated image")
    picture = difference_picture(first, views.target, views.mask, views.state.probe, views.quality)
    return _Tile("generated - simulated", "red: brighter, blue: darker", picture)


def _mosaic(tiles: Sequence[tuple[str, str, Image.Image]]) -> np.ndarray:
    """Pictures of one size, with a title and a note above each, as one picture, (h, w, 3) uint8."""
    picture_width, height = tiles[0][2].size
    bar, gap, edge, letter = (round(px * height / HEIGHT_PX) for px in (_BAR_PX, _GAP_PX, _EDGE_PX, _LETTER_PX))
    # Narrow images get margins: their titles fit, and S and A stay above the fold.
    width = max(picture_width, height * 5 // 4)
    cell_width = width + gap
    cell_height = height + bar + gap
    rows = -(-len(tiles) // _COLUMNS)
    canvas = Image.new("RGB", (_COLUMNS * cell_width - gap, rows * cell_height - gap), PAPER)
    draw = ImageDraw.Draw(canvas)
    letters = font(letter)
    for number, (title, note, picture) in enumerate(tiles):
        x = number % _COLUMNS * cell_width
        y = number // _COLUMNS * cell_height
        spare = width - draw.textlength(note, font=letters) - 5 * edge
        while title and draw.textlength(title, font=letters) > spare:
            title = title[:-2].rstrip(" .") + "." if len(title) > 2 else ""
        draw.text((x + edge, y + bar / 2), title, fill=_INK, font=letters, anchor="lm")
        draw.text((x + width - edge, y + bar / 2), note, fill=_DIM, font=letters, anchor="rm")
        canvas.paste(picture, (x + (width - picture_width) // 2, y + bar))
    return np.asarray(canvas)
