"""From views to pictures with a scale: images of Pillow, and `screen`, an RGB array of all of them.

All images of one state are one picture, so that what stands side by side was seen at the same moment.
"""

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache, lru_cache
from html import escape
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

from ablate.analysis.figures.scene_parts import Colour
from ablate.anatomy import Scene
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of, pixel_coordinates_mm, pixel_size_mm
from ablate.viewer import calipers
from ablate.viewer.session import Quality, Views

_HEIGHT_PX = 384  # a picture at rest has at least so many rows, for its letters, and at most twice as many
_TICK_MM, _LABEL_MM = 10, 50
_SCALE = (150, 160, 170)
_MARK, _YELLOW = (44, 160, 44), "#ffd400"
_INFERNO = [0, 0, 0, *colormaps["inferno"](np.linspace(0, 1, 255), bytes=True)[:, :3].ravel().tolist()]
_PAPER = (16, 18, 22)
_COLUMNS = 2
_BAR_PX, _GAP_PX, _EDGE_PX, _LETTER_PX = 30, 6, 4, 20  # where a picture has _HEIGHT_PX
_INK, _DIM = (235, 238, 242), (140, 150, 160)
_LINE, _NOTE = 42, 30  # characters
GOOD, BAD, DIM = "#2f9e44", "#e8590c", "#868e96"
_LEAST_SHARE = 0.002  # of the fan, or a tissue is not named
# Title and note of an image, and its picture or the words in its place.
_Tile = tuple[str, str, Image.Image | str]


def framed(
    colours: np.ndarray, mask: np.ndarray, probe: Probe, quality: Quality = Quality.full, palette: Sequence[int] = ()
) -> Image.Image:
    """Grey levels, (H, W), or colours, (H, W, 3), of the fan, with a scale of depth and the mark of one side.

    With a palette, 3 values for each level, levels are looked up in it, and no values between them are made. A coarse
    picture has two thirds of the rows: it is drawn in half the time, and the browser shows it as large as one at rest.
    """
    picture = Image.fromarray(np.where(mask if colours.ndim == 2 else mask[..., None], colours, np.uint8(0)))
    way = Image.Resampling.NEAREST if palette else Image.Resampling.BILINEAR
    picture = picture.resize(_size(mask.shape, quality), way)
    if palette:
        picture.putpalette(palette)
    picture = picture.convert("RGB")
    picture.paste(*_scale(probe, picture.size))
    return picture


def label_picture(labels: np.ndarray, colours: Sequence[Colour], probe: Probe, quality: Quality) -> Image.Image:
    """A segmentation, (H, W) uint8, each tissue in its colour."""
    palette = [round(255 * channel) for colour in ((0.0, 0.0, 0.0), *colours) for channel in colour]
    return framed(labels, labels > 0, probe, quality, palette)


def share_picture(shares: np.ndarray, mask: np.ndarray, probe: Probe, quality: Quality) -> Image.Image:
    """A map of shares in [0, 1], (H, W), from dark violet (0) to yellow (1)."""
    levels = (1 + 254 * np.clip(shares, 0, 1)).astype(np.uint8)  # 0 is black, outside the fan
    return framed(levels, mask, probe, quality, _INFERNO)


def difference_picture(a: np.ndarray, b: np.ndarray, mask: np.ndarray, probe: Probe, quality: Quality) -> Image.Image:
    """a - b of two images, (H, W) uint8 each: red where a is brighter, blue where b is, white where they agree."""
    levels = np.clip(a.astype(np.int16) - b + 128, 0, 255).astype(np.uint8)
    return framed(colormaps["RdBu_r"](levels, bytes=True)[..., :3], mask, probe, quality)


def on_fan(image: np.ndarray, mask: np.ndarray, rows: int) -> np.ndarray:
    """An image to lay on the fan in 3-D, transparent outside of it, (rows, w, 4) uint8."""
    size = max(1, round(image.shape[1] * rows / image.shape[0])), rows
    grey = Image.fromarray(image).resize(size, Image.Resampling.BILINEAR)
    inside = Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).resize(size, Image.Resampling.NEAREST)
    return np.dstack([np.asarray(grey)] * 3 + [np.asarray(inside)])


def empty_picture(words: str, shape: tuple[int, int], quality: Quality) -> Image.Image:
    """Words in place of a missing picture, as large as the picture of an image of this shape."""
    canvas = Image.new("RGB", _size(shape, quality), _PAPER)
    font, middle = _font(canvas.height / 26), (canvas.width / 2, canvas.height / 2)
    ImageDraw.Draw(canvas).text(middle, words, _SCALE, font, "mm", spacing=0.6 * font.size, align="center")
    return canvas


def mark(picture: Image.Image, points: np.ndarray, probe: Probe) -> None:
    """Draw crosses at points of the image plane, x and z, (n, 2) mm, and what is measured between them."""
    draw, shape = ImageDraw.Draw(picture), (picture.height, picture.width)
    arm, width = picture.height / 55, max(1, round(picture.height / 200))
    for x, y in (_pixel(point, shape, probe) for point in points):
        draw.line((x - arm, y, x + arm, y), fill=_YELLOW, width=width)
        draw.line((x, y - arm, x, y + arm), fill=_YELLOW, width=width)
    for line in calipers.lines(points):
        draw.line([_pixel(point, shape, probe) for point in line], fill=_YELLOW, width=1)


def label_at(labels: np.ndarray, point: np.ndarray, probe: Probe) -> int:
    """Label of a point of the image plane, x and z in mm, in a segmentation, (H, W); 0 outside the picture."""
    column, row = _pixel(point, labels.shape, probe)
    inside = 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]
    return int(labels[int(row), int(column)]) if inside else 0


def _pixel(point: np.ndarray, shape: tuple[int, int], probe: Probe) -> tuple[float, float]:
    """Column and row, from the edges of an image of this shape, of a point, x and z in mm."""
    tall, wide = pixel_size_mm(probe, shape)
    return point[0] / wide + shape[1] / 2, (point[1] + fan_of(probe).sag_mm) / tall


def _size(shape: tuple[int, int], quality: Quality) -> tuple[int, int]:
    """Width and height of the picture of an image with this shape, px."""
    rows = int(np.clip(shape[0], _HEIGHT_PX, 2 * _HEIGHT_PX)) * (2 if quality is Quality.coarse else 3) // 3
    return max(1, round(shape[1] * rows / shape[0])), rows


@lru_cache(maxsize=8)
def _scale(probe: Probe, size: tuple[int, int]) -> tuple[Image.Image, tuple[int, int], Image.Image]:
    """A picture of the scale alone, the corner to paste it at, and a mask of what is drawn."""
    canvas = Image.new("RGB", size)
    draw, font = ImageDraw.Draw(canvas), _font(size[1] / 26)
    rows = pixel_coordinates_mm(probe, (size[1], size[0]))[1]
    for depth in range(0, int(probe.depth_mm) + 1, _TICK_MM):
        row = min(int(np.searchsorted(rows, depth)), size[1] - 1)
        long = depth % _LABEL_MM == 0
        draw.line((0, row, size[1] / (32 if long else 64), row), fill=_SCALE)
        if long and depth:
            words = f"{depth} mm" if depth == _LABEL_MM else f"{depth}"
            place = size[1] / 26, min(row, size[1] - int(font.size))
            draw.text(place, words, fill=_SCALE, font=font, anchor="lm", stroke_width=2, stroke_fill=_PAPER)
    radius = size[1] // 60
    x, y = size[0] // 9, size[1] // 14
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_MARK)
    return canvas, (0, 0), Image.fromarray(np.asarray(canvas).any(axis=-1))


@cache
def _font(size: float) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font


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
    probe, mask, ms, quality = views.state.probe, views.mask, views.ms, views.quality
    how = "coarse" if quality is Quality.coarse else "full quality"
    taken = f"{how}, {ms['target']:.0f} ms" if "target" in ms else ""
    resting = "the simulator rests while the probe moves"
    generated = [_generated(views, number, layout.names) for number in range(len(views.state.runs))]
    tiles: list[_Tile] = [
        ("simulated B-mode", taken, resting if views.target is None else framed(views.target, mask, probe, quality)),
        *(generated[:1] or [("generated", "", "no generator is picked:\nchoose one under Compare")]),
        ("segmentation S", "", label_picture(views.segmentation, colours, probe, quality)),
        ("attenuation A", f"S and A: {ms['maps']:.0f} ms", share_picture(views.attenuation, mask, probe, quality)),
        *generated[1:],
    ]
    if layout.difference:
        first = views.generated[0] if views.generated else None
        if first is None or views.target is None:
            tiles.append(("difference", "", "a difference needs a simulated\nand a generated image"))
        else:
            picture = difference_picture(first, views.target, mask, probe, quality)
            tiles.append(("generated - simulated", "red: brighter, blue: darker", picture))
    pictures = [empty_picture(shown, mask.shape, quality) if isinstance(shown, str) else shown for _, _, shown in tiles]
    points = calipers.in_plane(layout.points, views.state.pose)
    for picture in pictures:
        mark(picture, points, probe)
    return _mosaic([(title, note, picture) for (title, note, _), picture in zip(tiles, pictures, strict=True)])


def _generated(views: Views, number: int, names: Mapping[Path, str]) -> _Tile:
    key, run, image = f"generated {number}", views.state.runs[number], views.generated[number]
    name = names.get(run, run.name)
    if image is None:
        words = views.notes.get(key, "this generator has not rendered yet")
        return f"generated: {name}", "", textwrap.fill(words, _LINE)
    note = views.notes.get(key, f"{views.ms[key]:.0f} ms").partition(";")[0]  # the caption has all of it
    short = textwrap.shorten(note, _NOTE, placeholder=" ...")
    return f"generated: {name}", short, framed(image, views.mask, views.state.probe, views.quality)


def _mosaic(tiles: Sequence[tuple[str, str, Image.Image]]) -> np.ndarray:
    own, height = tiles[0][2].size
    bar, gap, edge, letter = (round(px * height / _HEIGHT_PX) for px in (_BAR_PX, _GAP_PX, _EDGE_PX, _LETTER_PX))
    width = max(own, height * 5 // 4)  # narrow images get margins: their titles fit, and S and A stay above the fold
    rows = -(-len(tiles) // _COLUMNS)
    cell_height, cell_width = height + bar + gap, width + gap
    canvas = Image.new("RGB", (_COLUMNS * cell_width - gap, rows * cell_height - gap), _PAPER)
    draw, font = ImageDraw.Draw(canvas), _font(letter)
    for number, (title, note, picture) in enumerate(tiles):
        x, y = number % _COLUMNS * cell_width, number // _COLUMNS * cell_height
        spare = width - draw.textlength(note, font=font) - 5 * edge
        while title and draw.textlength(title, font=font) > spare:
            title = title[:-2].rstrip(" .") + "." if len(title) > 2 else ""
        draw.text((x + edge, y + bar / 2), title, fill=_INK, font=font, anchor="lm")
        draw.text((x + width - edge, y + bar / 2), note, fill=_DIM, font=font, anchor="rm")
        canvas.paste(picture, (x + (width - own) // 2, y + bar))
    return np.asarray(canvas)


def caption(views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    """The lines under the images: pose and probe in words, reservations, and a legend of the tissues that are seen."""
    state = views.state
    words = [f"{state.probe.depth_mm:g} mm deep", f"{state.probe.frequency_mhz:g} MHz", f"speckle {state.seed}"]
    if (hold := state.hold) is not None:
        place = [f"height {hold.height_mm:z.1f} mm", f"around {hold.angle_deg:z.1f}°", f"turn {hold.roll_deg:z.1f}°"]
        words = [*place, f"rock {hold.rock_deg:z.1f}°", f"tilt {hold.tilt_deg:z.1f}°", *words]
    notes = "".join(line(note, BAD) for note in dict.fromkeys(views.notes.values()))
    return line(" · ".join([*words, views.quality.value]), DIM) + notes + _legend(views, scene, colours)


def line(words: str, colour: str) -> str:
    """A line of HTML; the words are shown as they are."""
    style = f"color:{colour};font-size:0.85em;line-height:1.35;padding:0 0.8em 0.2em;overflow-wrap:anywhere"
    return f'<div style="{style}">{escape(words)}</div>'


def in_markdown(words: str) -> str:
    """Words as they are in Markdown, in which viser runs even scripts: a run or a tissue may be a stranger's."""
    return re.sub(r"[^\w\s.,:+-]", lambda sign: f"&#{ord(sign[0])};", " ".join(words.split()))


def _legend(views: Views, scene: Scene, colours: Sequence[Colour]) -> str:
    counts = np.bincount(views.segmentation.ravel(), minlength=len(scene.tissues) + 1)[1:]
    chips = []
    for index in np.argsort(-counts, kind="stable"):
        if counts[index] > _LEAST_SHARE * counts.sum():
            red, green, blue = (round(255 * c) for c in colours[index])
            look = f"background:rgb({red},{green},{blue});padding:0 0.5em;margin-right:0.3em;border-radius:2px"
            name = escape(scene.tissues[index].name.replace("_", " "))
            chips.append(f'<span style="white-space:nowrap;margin-right:1em"><span style="{look}"></span>{name}</span>')
    return f'<div style="font-size:0.8em;line-height:1.6;padding:0.2em 1em">{" ".join(chips)}</div>'
