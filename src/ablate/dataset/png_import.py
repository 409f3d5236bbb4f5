"""From a checked folder of PNGs to the pairs of a data set."""

import time
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from skimage.io import imread

from ablate.dataset.filling import fill_pairs
from ablate.dataset.pairs import Pairs
from ablate.dataset.png_folder import MOST_LABELS, PngFolder

_WAIT_S = 1.0


def read_fan(checked: PngFolder) -> tuple[np.ndarray, int]:
    """Decode every segmentation; return the fan they share, (H, W) bool, where they are not 0, and the highest label.

    Raises
    ------
    ValueError
        Naming the first file whose fan or labels do not fit, or which cannot be decoded.
    """
    highest = 0
    allowed = MOST_LABELS if checked.tissues is None else len(checked.tissues)
    paths = [checked.files["segmentation"][name] for name in checked.names]
    mask = _decoded(paths[0], checked.shape) > 0
    for path in paths:
        labels = _decoded(path, checked.shape)
        found = int(labels.max())
        if found > allowed:
            why = "" if checked.tissues is None else f", those that {checked.folder / 'labels.csv'} names"
            raise ValueError(f"{path}: has label {found}; allowed are 0, outside the fan, to {allowed}{why}")
        highest = max(highest, found)
        differs = int(np.count_nonzero((labels > 0) != mask))
        if differs:
            raise ValueError(
                f"{path}: its fan, the pixels that are not 0, differs at {differs} of {labels.size} pixels from "
                f"that of {paths[0]}; all frames must have one fan"
            )
    if highest == 0:
        raise ValueError(f"{paths[0]}: all its pixels are 0, so there is no fan")
    return mask, highest


def import_pairs(
    checked: PngFolder,
    names: Sequence[str],
    pairs: Pairs,
    maps: frozenset[str],
    progress: Callable[[int], object] = lambda _: None,
) -> None:
    """Fill what is missing of a data set from the PNGs; what lies outside the fan becomes 0.

    `names` are those of the frames, in the order of the data set; `maps` are some of `checked.maps`.

    Raises
    ------
    ValueError
        When a file cannot be decoded.
    OSError
        When a shard cannot be written.
    """
    mask = pairs.mask()

    def image(name: str, frame: int) -> np.ndarray:
        decoded = mask * _decoded(checked.files[name][names[frame]], checked.shape)
        return decoded / np.iinfo(decoded.dtype).max if name == "attenuation" else decoded

    def read(frames: np.ndarray, wanted: frozenset[str]) -> Mapping[str, np.ndarray]:
        return {name: np.stack([image(name, frame) for frame in frames]) for name in wanted}

    while pairs.missing(maps):
        made = 0
        for frames in fill_pairs(pairs, maps, read):
            made += frames
            progress(frames)
        if not made:
            time.sleep(_WAIT_S)  # another process makes the rest


def _decoded(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """The grey levels of a PNG, (H, W) uint8 or uint16."""
    try:
        image: np.ndarray = imread(BytesIO(path.read_bytes()))  # closed, whatever is raised
    except Exception as error:  # every chunk of a PNG raises its own
        raise ValueError(f"{path}: cannot be decoded ({' '.join(str(error).split())})") from error
    if image.shape != shape:
        raise ValueError(f"{path}: is not plain grey (transparent pixels?)")
    return image
