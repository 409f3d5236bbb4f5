"""An overview picture of a data set, written beside it."""

from pathlib import Path

import numpy as np
from skimage.color import hsv2rgb
from skimage.io import imsave
from skimage.transform import resize
from skimage.util import montage

from ablate.dataset.pairs import Pairs
from ablate.dataset.split import Part
from ablate.storage import written_whole

_THUMBNAIL_PX = 320
# A colour a label, the same in every frame: hues a golden angle apart, outside the fan black.
_HUES = np.arange(256) * 0.381966 % 1
_COLOURS = hsv2rgb(np.stack([_HUES, np.full(256, 0.55), np.where(np.arange(256) % 2, 0.95, 0.7)], axis=-1))
_COLOURS[0] = 0


def write_contact_sheet(pairs: Pairs, path: Path, per_part: int = 8) -> None:
    """Write frames of each part as B-mode with their segmentation below, train first, as one PNG.

    `segmentation` and `target` must be filled. Of each part, `per_part` frames are shown, equally spaced, in one row.
    """
    tiles = []
    for part in Part:
        frames = pairs.frames(part)
        shown = frames[np.linspace(0, len(frames) - 1, per_part).round().astype(int)]  # repeated where there are few
        images = pairs.read("target", shown) / 255.0
        labels = pairs.read("segmentation", shown)
        tiles += [np.repeat(_thumbnail(i)[..., None], 3, axis=2) for i in images]
        tiles += [_thumbnail(_COLOURS[s]) for s in labels]
    sheet = montage(np.stack(tiles), channel_axis=3, grid_shape=(2 * len(Part), per_part), padding_width=4)
    with written_whole(path) as partial:  # other processes that filled the set write it too
        imsave(partial, (np.clip(sheet, 0, 1) * 255).astype(np.uint8), check_contrast=False)


def _thumbnail(image: np.ndarray) -> np.ndarray:
    height = round(image.shape[0] * _THUMBNAIL_PX / image.shape[1])
    return resize(image, (height, _THUMBNAIL_PX), anti_aliasing=True)
