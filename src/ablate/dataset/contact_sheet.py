"""A picture of a data set, written beside it: where people would rather look than read."""

from __future__ import annotations

from pathlib import Path
from uuid import uuid4

import numpy as np
from skimage.color import hsv2rgb
from skimage.io import imsave
from skimage.transform import resize
from skimage.util import montage

from ablate.dataset.pairs import Pairs
from ablate.dataset.split import Part

_THUMBNAIL_PX = 320
# A colour a label, the same in every frame: hues a golden angle apart, outside the fan black.
_HUES = np.arange(256) * 0.381966 % 1
_COLOURS = hsv2rgb(np.stack([_HUES, np.full(256, 0.55), np.where(np.arange(256) % 2, 0.95, 0.7)], axis=-1))
_COLOURS[0] = 0


def write_contact_sheet(pairs: Pairs, path: Path, per_part: int = 8) -> None:
    """Write frames of each part as B-mode with their segmentation below, train first, as one PNG.

    Parameters
    ----------
    pairs : Pairs
        With `segmentation` and `high` filled.
    path : Path
    per_part : int
        Frames shown of train, validation and test each, equally spaced; one row of the sheet.
    """
    tiles = []
    for part in Part:
        frames = pairs.frames(part)
        shown = frames[np.linspace(0, len(frames) - 1, per_part).round().astype(int)]  # repeated where there are few
        images = pairs.read("high", shown) / 255.0
        labels = pairs.read("segmentation", shown)
        tiles += [np.repeat(_thumbnail(i)[..., None], 3, axis=2) for i in images]
        tiles += [_thumbnail(_COLOURS[s]) for s in labels]
    sheet = montage(np.stack(tiles), channel_axis=3, grid_shape=(2 * len(Part), per_part), padding_width=4)
    partial = path.with_name(f"{path.stem}.{uuid4().hex}.partial.png")  # others that filled the set write it too
    imsave(partial, (np.clip(sheet, 0, 1) * 255).astype(np.uint8), check_contrast=False)
    partial.replace(path)


def _thumbnail(image: np.ndarray) -> np.ndarray:
    height = round(image.shape[0] * _THUMBNAIL_PX / image.shape[1])
    return resize(image, (height, _THUMBNAIL_PX), anti_aliasing=True)
