"""From views to pictures with a scale: RGB arrays, ready to be shown or saved."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from matplotlib import colormaps
from PIL import Image, ImageDraw, ImageFont

from ablate.analysis.figures.scene_parts import Colour
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import face_sag_mm, pixel_coordinates_mm, pixel_size_mm

_HEIGHT_PX = 384  # a picture has at least so many rows, for its letters, and at most twice as many
_TICK_MM, _LABEL_MM = 10, 50
_SCALE = (150, 160, 170)
_MARK = (44, 160, 44)
_PAPER = (16, 18, 22)
_MOST_DIFFERENCE = 128.0  # grey levels, fully red or blue


def framed(colours: np.ndarray, mask: np.ndarray, probe: Probe) -> np.ndarray:
    """Grey levels, (H, W), or colours, (H, W, 3), of the fan, with a scale of depth and the mark of one side.

    The picture is (h, w, 3) uint8.
    """
    size = _size(mask.shape)
    shown = colours.copy()
    shown[~mask] = 0
    picture = Image.fromarray(shown.astype(np.uint8)).resize(size, Image.Resampling.BILINEAR).convert("RGB")
    picture.paste(*_scale(probe, size))
    return np.asarray(picture)


def label_picture(labels: np.ndarray, colours: Sequence[Colour], probe: Probe) -> np.ndarray:
    """A segmentation, (H, W) uint8, each tissue in its colour."""
    table = (255 * np.array([(0.0, 0.0, 0.0), *colours])).astype(np.uint8)
    return framed(table[labels], labels > 0, probe)


def share_picture(shares: np.ndarray, mask: np.ndarray, probe: Probe) -> np.ndarray:
    """A map of shares in [0, 1], (H, W), from dark violet (0) to yellow (1)."""
    levels = (255 * np.clip(shares, 0, 1)).astype(np.uint8)
    return framed(colormaps["inferno"](levels, bytes=True)[..., :3], mask, probe)


def difference_picture(a: np.ndarray, b: np.ndarray, mask: np.ndarray, probe: Probe) -> np.ndarray:
    """a - b of two images, (H, W) uint8 each: red where a is brighter, blue where b is, white where they agree."""
    share = np.clip((a.astype(np.float32) - b) / _MOST_DIFFERENCE, -1, 1)[..., None]
    red, blue = np.array([178, 24, 43]), np.array([33, 102, 172])
    ink = np.where(share > 0, red, blue)
    return framed((245 + np.abs(share) * (ink - 245.0)).astype(np.uint8), mask, probe)


def on_fan(image: np.ndarray, mask: np.ndarray, rows: int = 160) -> np.ndarray:
    """An image to lay on the fan in 3-D, transparent outside of it, (rows, w, 4) uint8."""
    size = max(1, round(image.shape[1] * rows / image.shape[0])), rows
    grey = Image.fromarray(image).resize(size, Image.Resampling.BILINEAR)
    inside = Image.fromarray(np.where(mask, np.uint8(255), np.uint8(0))).resize(size, Image.Resampling.NEAREST)
    return np.dstack([np.asarray(grey)] * 3 + [np.asarray(inside)])


def empty_picture(words: str, shape: tuple[int, int]) -> np.ndarray:
    """Words in place of a missing picture, as large as the picture of an image of this shape."""
    canvas = Image.new("RGB", _size(shape), _PAPER)
    draw, font = ImageDraw.Draw(canvas), _font(_size(shape)[1])
    lines = words.split("\n")
    for number, line in enumerate(lines):
        y = canvas.height / 2 + (number - len(lines) / 2) * 1.6 * font.size
        draw.text((canvas.width / 2, y), line, fill=_SCALE, font=font, anchor="mm")
    return np.asarray(canvas)


def marked(picture: np.ndarray, points: Sequence[tuple[float, float]], probe: Probe) -> np.ndarray:
    """A picture with crosses at points of the image plane, x and z in mm, and lines between pairs of them."""
    if not points:
        return picture
    canvas = Image.fromarray(picture)
    draw = ImageDraw.Draw(canvas)
    tall, wide = pixel_size_mm(probe, (canvas.height, canvas.width))
    seen = [(x / wide + canvas.width / 2, (z + face_sag_mm(probe)) / tall) for x, z in points]
    for x, y in seen:
        draw.line((x - 7, y, x + 7, y), fill="#ffd400", width=2)
        draw.line((x, y - 7, x, y + 7), fill="#ffd400", width=2)
    for start, end in zip(seen[::2], seen[1::2], strict=False):
        draw.line((*start, *end), fill="#ffd400", width=1)
    return np.asarray(canvas)


def label_at(labels: np.ndarray, point: tuple[float, float], probe: Probe) -> int:
    """Label of a point of the image plane, x and z in mm, in a segmentation, (H, W); 0 outside the picture."""
    tall, wide = pixel_size_mm(probe, labels.shape)
    row = int(np.floor((point[1] + face_sag_mm(probe)) / tall))
    column = int(np.floor(point[0] / wide + labels.shape[1] / 2))
    if 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]:
        return int(labels[row, column])
    return 0


def _size(shape: tuple[int, int]) -> tuple[int, int]:
    """Width and height of the picture of an image with this shape, px."""
    rows = int(np.clip(shape[0], _HEIGHT_PX, 2 * _HEIGHT_PX))
    return max(1, round(shape[1] * rows / shape[0])), rows


@lru_cache(maxsize=8)
def _scale(probe: Probe, size: tuple[int, int]) -> tuple[Image.Image, tuple[int, int], Image.Image]:
    """A picture of the scale alone, the corner to paste it at, and a mask of what is drawn."""
    canvas = Image.new("RGB", size)
    draw, font = ImageDraw.Draw(canvas), _font(size[1])
    rows = pixel_coordinates_mm(probe, (size[1], size[0]))[1]
    for depth in range(0, int(probe.depth_mm) + 1, _TICK_MM):
        row = min(int(np.searchsorted(rows, depth)), size[1] - 1)
        long = depth % _LABEL_MM == 0
        draw.line((0, row, 12 if long else 6, row), fill=_SCALE)
        if long and depth:
            words = f"{depth} mm" if depth == _LABEL_MM else f"{depth}"
            place = 15, min(row, size[1] - int(font.size))
            draw.text(place, words, fill=_SCALE, font=font, anchor="lm", stroke_width=2, stroke_fill=_PAPER)
    radius = size[1] // 60
    x, y = size[0] // 9, size[1] // 14
    draw.ellipse((x - radius, y - radius, x + radius, y + radius), fill=_MARK)
    return canvas, (0, 0), Image.fromarray(np.asarray(canvas).any(axis=-1))


def _font(height_px: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size=max(11.0, height_px / 26))
    assert isinstance(font, ImageFont.FreeTypeFont)
    return font
