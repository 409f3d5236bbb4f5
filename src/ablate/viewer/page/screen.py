"""All images of one state in one picture, so that what stands side by side was seen at the same moment; its caption."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ablate.analysis.figures.scene_parts import Colour
from ablate.anatomy import Scene
from ablate.viewer.pictures import difference_picture, empty_picture, framed, label_picture, marked, share_picture
from ablate.viewer.state import Quality, State, Views

_COLUMNS = 2
_BAR_PX, _GAP_PX = 30, 6
_PAPER, _INK, _DIM = (16, 18, 22), (235, 238, 242), (140, 150, 160)
_LINE = 42  # characters
GOOD, BAD, DIM = "#2f9e44", "#e8590c", "#868e96"
_LEAST_SHARE = 0.002  # of the fan, or a tissue is not named


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
        simulated = framed(views.target, mask, probe)
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
        return _Tile(f"generated: {name}", "", empty_picture(textwrap.fill(words, _LINE), views.mask.shape))
    return _Tile(f"generated: {name}", f"{views.ms[key]:.0f} ms", framed(image, views.mask, state.probe))


def _difference(state: State, views: Views) -> _Tile:
    first = views.generated[0] if views.generated else None
    if first is None or views.target is None:
        words = "a difference needs a simulated\nand a generated image"
        return _Tile("difference", "", empty_picture(words, views.mask.shape))
    picture = difference_picture(first, views.target, views.mask, state.probe)
    return _Tile("generated - simulated", "red: brighter, blue: darker", picture)


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


def caption(state: State, views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    """The lines under the images: pose and probe in words, reservations, and a legend of the tissues that are seen."""
    words = [f"{state.probe.depth_mm:g} mm deep", f"{state.probe.frequency_mhz:g} MHz", f"speckle {state.seed}"]
    if (hold := state.hold) is not None:
        place = [f"height {hold.height_mm:.1f} mm", f"around {hold.angle_deg:.1f}°", f"turn {hold.roll_deg:.1f}°"]
        words = [*place, f"rock {hold.rock_deg:.1f}°", f"tilt {hold.tilt_deg:.1f}°", *words]
    notes = "".join(line(note, BAD) for note in dict.fromkeys(views.notes.values()))
    return line(" · ".join([*words, views.quality.value]), DIM) + notes + _legend(views, scene, colours)


def line(words: str, colour: str) -> str:
    """A line of HTML; the words are shown as they are."""
    style = f"color:{colour};font-size:0.85em;line-height:1.35;padding:0 0.8em 0.2em;overflow-wrap:anywhere"
    return f'<div style="{style}">{escape(words)}</div>'


def _legend(views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    counts = np.bincount(views.segmentation.ravel(), minlength=len(scene.tissues) + 1)[1:]
    chips = []
    for index in np.argsort(-counts, kind="stable"):
        if counts[index] > _LEAST_SHARE * counts.sum():
            red, green, blue = (round(255 * c) for c in colours[index])
            box = f'<span style="background:rgb({red},{green},{blue});padding:0 0.5em;border-radius:2px"></span>'
            name = escape(scene.tissues[index].name.replace("_", " "))
            chips.append(f'<span style="white-space:nowrap;margin-right:0.9em">{box} {name}</span>')
    return f'<div style="font-size:0.8em;line-height:1.6;padding:0.2em 1em">{" ".join(chips)}</div>'
