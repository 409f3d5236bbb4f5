"""From images and maps to pictures of Pillow with a scale of depth, and from points on them to pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cache, lru_cache
from typing import Any

import numpy as np
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont, ImageOps

from ablate.analysis.figures.scene_parts import Colour
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of
from ablate.viewer import calipers
from ablate.viewer.session import Quality

HEIGHT_PX = 384  # a picture at rest has at least so many rows, for its letters, and at most twice as many
PAPER = (16, 18, 22)
_TICK_MM = 10
_LABEL_MM = 50
_ZOOMED = 2.0  # from here on each tick has its depth
_SCALE = (150, 160, 170)
_MARK = (44, 160, 44)
_YELLOW = "#ffd400"
_EDGE: dict[str, Any] = {"stroke_width": 2, "stroke_fill": PAPER}  # around letters on an image
_INFERNO = [0, 0, 0, *colormaps["inferno"](np.linspace(0, 1, 255), bytes=True)[:, :3].ravel().tolist()]


class Sides(StrEnum):
    """Whether the first scanline is on the left."""

    kept = "left as scanned"
    swapped = "left and right swapped"


@dataclass(frozen=True)
class Window:
    """The part of an image that is seen; places are shares of its width and height, from the upper left corner.

    `zoom` is how many times larger than the whole it is shown; `middle` is in its middle, or as near as the edges let.
    """

    zoom: float = 1.0
    middle: tuple[float, float] = (0.5, 0.5)
    sides: Sides = Sides.kept

    @property
    def corner(self) -> np.ndarray:
        """The upper left corner of what is seen, (2,)."""
        most = 1 - 1 / self.zoom
        return np.clip(np.subtract(self.middle, 0.5 / self.zoom), 0, most)

    def to_picture(self, place: np.ndarray) -> np.ndarray:
        """Where a place of the image is in what is seen, (2,)."""
        x, y = (place - self.corner) * self.zoom
        return np.array([1 - x if self.sides is Sides.swapped else x, y])

    def to_image(self, place: np.ndarray) -> np.ndarray:
        """Where a place of what is seen is in the image, (2,)."""
        x, y = place
        seen = np.array([1 - x if self.sides is Sides.swapped else x, y])
        return self.corner + seen / self.zoom


WHOLE = Window()


def framed(
    colours: np.ndarray,
    mask: np.ndarray,
    probe: Probe,
    quality: Quality = Quality.full,
    palette: Sequence[int] = (),
    window: Window = WHOLE,
) -> Image.Image:
    """Draw the fan with a scale of depth and the mark of one side.

    Parameters
    ----------
    colours : (H, W) or (H, W, 3) uint8
        Grey levels or colours.
    mask : (H, W) bool
        The fan.
    probe : Probe
        Of the image.
    quality : Quality
        A coarse picture has two thirds of the rows: it is drawn in half the time, and the browser shows it as large as
        one at rest.
    palette : sequence of int
        Where it is given, 3 values for each level; levels are looked up in it, and none between them are made.
    window : Window
        The part of the image that is drawn.
    """
    picture = Image.fromarray(np.where(mask if colours.ndim == 2 else mask[..., None], colours, np.uint8(0)))
    way = Image.Resampling.NEAREST if palette else Image.Resampling.BILINEAR
    size = np.array(picture.size)
    first = window.corner * size
    (left, top), (right, bottom) = first.tolist(), np.minimum(first + size / window.zoom, size).tolist()
    picture = picture.resize(picture_size(mask.shape, quality), way, box=(left, top, right, bottom))
    if window.sides is Sides.swapped:
        picture = ImageOps.mirror(picture)
    if palette:
        picture.putpalette(palette)
    picture = picture.convert("RGB")
    picture.paste(*_scale(probe, picture.size, window))
    return picture


def label_picture(
    labels: np.ndarray, colours: Sequence[Colour], probe: Probe, quality: Quality, window: Window = WHOLE
) -> Image.Image:
    """A segmentation, each tissue in its colour.

    Parameters
    ----------
    labels : (H, W) uint8
        0 outside the fan, i + 1 for the tissue i.
    colours : sequence of Colour
        Of the tissues.
    probe, quality, window
        As of `framed`.
    """
    palette = [round(255 * channel) for colour in ((0.0, 0.0, 0.0), *colours) for channel in colour]
    return framed(labels, labels > 0, probe, quality, palette, window)


def share_picture(
    shares: np.ndarray, mask: np.ndarray, probe: Probe, quality: Quality, window: Window = WHOLE
) -> Image.Image:
    """A map of shares, from dark violet (0) to yellow (1).

    Parameters
    ----------
    shares : (H, W) float
        In [0, 1].
    mask, probe, quality, window
        As of `framed`.
    """
    levels = (1 + 254 * np.clip(shares, 0, 1)).astype(np.uint8)  # 0 is black, outside the fan
    return framed(levels, mask, probe, quality, _INFERNO, window)


def difference_picture(
    a: np.ndarray, b: np.ndarray, mask: np.ndarray, probe: Probe, quality: Quality, window: Window = WHOLE
) -> Image.Image:
    """a - b of two images: red where a is brighter, blue where b is, white where they agree.

    Parameters
    ----------
    a, b : (H, W) uint8
        Grey levels.
    mask, probe, quality, window
        As of `framed`.
    """
    levels = np.clip(a.astype(np.int16) - b + 128, 0, 255).astype(np.uint8)
    return framed(colormaps["RdBu_r"](levels, bytes=True)[..., :3], mask, probe, quality, window=window)


def on_fan(image: np.ndarray, mask: np.ndarray, rows: int) -> np.ndarray:
    """An image to lay on the fan in 3-D, transparent outside of it, (rows, w, 4) uint8."""
    size = max(1, round(image.shape[1] * rows / image.shape[0])), rows
    grey = Image.fromarray(image).resize(size, Image.Resampling.BILINEAR)
    inside = Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).resize(size, Image.Resampling.NEAREST)
    return np.dstack([np.asarray(grey)] * 3 + [np.asarray(inside)])


def empty_picture(words: str, shape: tuple[int, int], quality: Quality) -> Image.Image:
    """Words in place of a missing picture, as large as the picture of an image of this shape."""
    canvas = Image.new("RGB", picture_size(shape, quality), PAPER)
    letters = font(canvas.height / 26)
    middle = (canvas.width / 2, canvas.height / 2)
    ImageDraw.Draw(canvas).text(middle, words, _SCALE, letters, "mm", spacing=0.6 * letters.size, align="center")
    return canvas


def mark(picture: Image.Image, points: np.ndarray, probe: Probe, window: Window = WHOLE) -> None:
    """Draw crosses at points, and what is measured between them.

    Parameters
    ----------
    picture : Image
        Of the window; it is drawn on.
    points : (n, 2) float, mm
        Of the image plane, x and z.
    probe : Probe
        Of the frame.
    window : Window
        The part of the frame that the picture shows.
    """
    draw = ImageDraw.Draw(picture)
    shape = (picture.height, picture.width)
    arm = picture.height / 55
    width = max(1, round(picture.height / 200))
    for x, y in (_pixel(point, shape, probe, window) for point in points):
        draw.line((x - arm, y, x + arm, y), fill=_YELLOW, width=width)
        draw.line((x, y - arm, x, y + arm), fill=_YELLOW, width=width)
    for line in calipers.lines(points):
        draw.line([_pixel(point, shape, probe, window) for point in line], fill=_YELLOW, width=1)
    for point, words in calipers.values(points):
        x, y = _pixel(point, shape, probe, window)
        is_left = x < 0.8 * picture.width  # else there is no room beside it
        place = (x + 1.5 * arm if is_left else x - 1.5 * arm), y
        draw.text(place, words, _YELLOW, font(picture.height / 24), "lm" if is_left else "rm", **_EDGE)


def label_at(labels: np.ndarray, point: np.ndarray, probe: Probe) -> int:
    """Label of a point of the image plane, x and z in mm, in a segmentation, (H, W); 0 outside the picture."""
    column, row = _pixel(point, labels.shape, probe)
    inside = 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]
    return int(labels[int(row), int(column)]) if inside else 0


def place_of(point: np.ndarray, probe: Probe) -> np.ndarray:
    """Where a point of the image plane, x and z in mm, is in an image, as shares of its width and height, (2,)."""
    fan = fan_of(probe)
    height_mm, width_mm = fan.size_mm
    return np.array([point[0] / width_mm + 0.5, (point[1] + fan.sag_mm) / height_mm])


def point_of(place: np.ndarray, probe: Probe, window: Window) -> np.ndarray:
    """x and z, (2,) mm, of a place in a picture, as shares of its width and height."""
    x, y = window.to_image(place)
    fan = fan_of(probe)
    height_mm, width_mm = fan.size_mm
    return np.array([(x - 0.5) * width_mm, y * height_mm - fan.sag_mm])


def _pixel(point: np.ndarray, shape: tuple[int, int], probe: Probe, window: Window = WHOLE) -> tuple[float, float]:
    """Column and row, from the edges of a picture of this shape, of a point, x and z in mm."""
    x, y = window.to_picture(place_of(point, probe)).tolist()
    return x * shape[1], y * shape[0]


def picture_size(shape: tuple[int, int], quality: Quality) -> tuple[int, int]:
    """Width and height of the picture of an image with this shape, px."""
    rows = int(np.clip(shape[0], HEIGHT_PX, 2 * HEIGHT_PX))
    if quality is Quality.coarse:
        rows = 2 * rows // 3
    return max(1, round(shape[1] * rows / shape[0])), rows


@lru_cache(maxsize=8)
def _scale(probe: Probe, size: tuple[int, int], window: Window) -> tuple[Image.Image, tuple[int, int], Image.Image]:
    """A picture of the scale alone, the corner to paste it at, and a mask of what is drawn."""
    canvas = Image.new("RGB", size)
    draw = ImageDraw.Draw(canvas)
    letters = font(size[1] / 26)
    every_mm = _TICK_MM if window.zoom >= _ZOOMED else _LABEL_MM
    unit = " mm"  # behind the first one
    for depth in range(0, int(probe.depth_mm) + 1, _TICK_MM):
        row = int(_pixel(np.array([0.0, depth]), size[::-1], probe, window)[1])
        if not 0 <= row <= size[1]:  # beyond what is seen
            continue
        row = min(row, size[1] - 1)
        long = depth % every_mm == 0
        draw.line((0, row, size[1] / (32 if long else 64), row), fill=_SCALE)
        if long and depth:
            place = size[1] / 26, min(row, size[1] - int(letters.size))
            draw.text(place, f"{depth}{unit}", _SCALE, letters, "lm", **_EDGE)
            unit = ""
    radius = size[1] // 60
    x, y = size[0] // 9, size[1] // 14
    if window.sides is Sides.swapped:
        x = size[0] - x
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_MARK)
    return canvas, (0, 0), Image.fromarray(np.asarray(canvas).any(axis=-1))


@cache
def font(size: float) -> ImageFont.FreeTypeFont:
    """Letters of this height, px."""
    letters = ImageFont.load_default(size)
    assert isinstance(letters, ImageFont.FreeTypeFont)
    return letters
