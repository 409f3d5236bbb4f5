"""All images of one state in one picture, so that what stands side by side was seen at the same moment."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ablate.analysis.figures.tissue_colours import Colour
from ablate.viewer.pictures import (
    difference_picture,
    empty_picture,
    grey_picture,
    label_picture,
    marked,
    share_picture,
)
from ablate.viewer.state import Quality, State, Views

_COLUMNS = 2
_BAR_PX, _GAP_PX = 30, 6
_PAPER, _INK, _DIM = (16, 18, 22), (235, 238, 242), (140, 150, 160)
_WORDS_PER_LINE = 42  # characters


@dataclass(frozen=True)
class Layout:
    """What is shown beside the simulated image, the segmentation and the attenuation.

    `names` are those of the state's runs; `points` are marked, x and z in mm of the image plane.
    """

    names: tuple[str, ...] = ()
    difference: bool = False
    points: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True, eq=False)
class _Tile:
    title: str
    note: str
    picture: np.ndarray


def screen(state: State, views: Views, colours: Sequence[Colour], layout: Layout) -> np.ndarray:
    """The picture of all images, (h, w, 3) uint8: the simulated one, generated ones, S, A and the difference."""
    probe, mask, shape = state.probe, views.mask, views.mask.shape
    ms = views.ms
    if views.target is None:
        simulated = empty_picture("the simulator rests while the probe moves", shape)
    else:
        simulated = grey_picture(views.target, mask, probe)
    how = "coarse" if views.quality is Quality.coarse else "full quality"
    tiles = [_Tile("simulated B-mode", f"{how}, {ms['target']:.0f} ms" if "target" in ms else "", simulated)]
    generated = [_generated(state, views, number, name) for number, name in enumerate(layout.names)]
    if not generated:
        words = "no generator is picked:\nchoose one under Compare"
        generated = [_Tile("generated", "", empty_picture(words, shape))]
    tiles += generated[:1]
    tiles.append(_Tile("segmentation S", "", label_picture(views.segmentation, colours, probe)))
    maps_ms = f"S and A: {ms['maps']:.0f} ms"
    tiles.append(_Tile("attenuation A", maps_ms, share_picture(views.attenuation, mask, probe)))
    tiles += generated[1:]
    if layout.difference:
        tiles.append(_difference(state, views))
    return _mosaic([_Tile(t.title, t.note, marked(t.picture, layout.points, probe)) for t in tiles])


def _generated(state: State, views: Views, number: int, name: str) -> _Tile:
    key = f"generated {number}"
    image = views.generated[number] if number < len(views.generated) else None
    if image is None:
        words = views.notes.get(key, "this generator has not rendered yet")
        return _Tile(f"generated: {name}", "", empty_picture(_wrapped(words), views.mask.shape))
    return _Tile(f"generated: {name}", f"{views.ms[key]:.0f} ms", grey_picture(image, views.mask, state.probe))


def _difference(state: State, views: Views) -> _Tile:
    first = views.generated[0] if views.generated else None
    if first is None or views.target is None:
        words = "a difference needs a simulated\nand a generated image"
        return _Tile("difference", "", empty_picture(words, views.mask.shape))
    title = "generated - simulated"
    picture = difference_picture(first, views.target, views.mask, state.probe)
    return _Tile(title, "red: brighter, blue: darker", picture)


def _mosaic(tiles: Sequence[_Tile]) -> np.ndarray:
    height, width = tiles[0].picture.shape[:2]
    rows = -(-len(tiles) // _COLUMNS)
    cell_height, cell_width = height + _BAR_PX + _GAP_PX, width + _GAP_PX
    canvas = Image.new("RGB", (_COLUMNS * cell_width - _GAP_PX, rows * cell_height - _GAP_PX), _PAPER)
    draw, font = ImageDraw.Draw(canvas), ImageFont.load_default(size=20)
    for number, tile in enumerate(tiles):
        x, y = number % _COLUMNS * cell_width, number // _COLUMNS * cell_height
        note_width = draw.textlength(tile.note, font=font)
        title = tile.title
        while title and draw.textlength(title, font=font) > width - note_width - 20:
            title = title[:-2].rstrip(" .") + "." if len(title) > 2 else ""
        draw.text((x + 4, y + _BAR_PX / 2), title, fill=_INK, font=font, anchor="lm")
        draw.text((x + width - 4, y + _BAR_PX / 2), tile.note, fill=_DIM, font=font, anchor="rm")
        canvas.paste(Image.fromarray(tile.picture), (x, y + _BAR_PX))
    return np.asarray(canvas)


def _wrapped(words: str) -> str:
    lines, line = [], ""
    for word in words.split():
        if line and len(line) + len(word) > _WORDS_PER_LINE:
            lines.append(line)
            line = ""
        line = f"{line} {word[:60]}".strip()
    return "\n".join([*lines, line])
