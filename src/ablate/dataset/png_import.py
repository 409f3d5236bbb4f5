"""From a checked folder of PNGs to the pairs of a data set."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from skimage.io import imread

from ablate.dataset.filling import fill_pairs
from ablate.dataset.pairs import Pairs
from ablate.dataset.png_folder import MOST_LABELS, PngFolder

_WAIT_S = 1.0


def read_fan(checked: PngFolder) -> tuple[np.ndarray, int]:
    """Decode every segmentation and check that all have the same fan and no label too many.

    Parameters
    ----------
    checked : PngFolder

    Returns
    -------
    mask : (H, W) bool
        The fan: where the segmentation is not 0.
    labels : int
        The highest label.

    Raises
    ------
    ValueError
        Naming the first file that does not fit, or cannot be decoded.
    """
    mask: np.ndarray | None = None
    highest = 0
    allowed = MOST_LABELS if checked.tissues is None else len(checked.tissues)
    paths = checked.files["segmentation"]
    for name in checked.names:
        labels = _decoded(paths[name], checked.shape)
        found = int(labels.max())
        if found > allowed:
            why = "" if checked.tissues is None else f", those that {checked.folder / 'labels.csv'} names"
            raise ValueError(f"{paths[name]}: has label {found}; allowed are 0, outside the fan, to {allowed}{why}")
        highest = max(highest, found)
        mask = labels > 0 if mask is None else mask
        differs = int(np.count_nonzero((labels > 0) != mask))
        if differs:
            raise ValueError(
                f"{paths[name]}: its fan, the pixels that are not 0, differs at {differs} of {labels.size} pixels from "
                f"that of {paths[checked.names[0]]}; all frames must have one fan"
            )
    assert mask is not None
    if highest == 0:
        raise ValueError(f"{paths[checked.names[0]]}: all its pixels are 0, so there is no fan")
    return mask, highest


def import_pairs(
    checked: PngFolder,
    names: Sequence[str],
    pairs: Pairs,
    maps: frozenset[str],
    progress: Callable[[int], object] = lambda _: None,
) -> None:
    """Fill what is missing of a data set from the PNGs; what lies outside the fan becomes 0.

    Parameters
    ----------
    checked : PngFolder
    names : sequence of str
        Of the frames, in the order of the data set.
    pairs : Pairs
    maps : frozenset of str
        Out of `checked.maps`.
    progress : callable (frames made since the last call), optional

    Raises
    ------
    ValueError
        When a file cannot be decoded.
    OSError
        When a shard cannot be written.
    """
    mask = pairs.mask()

    def read(frames: np.ndarray, wanted: frozenset[str]) -> Mapping[str, np.ndarray]:
        return {m: np.stack([mask * _map(checked, m, names[f]) for f in frames]) for m in wanted}

    while pairs.missing(maps):
        made = 0
        for frames in fill_pairs(pairs, maps, read):
            made += frames
            progress(frames)
        if not made:
            time.sleep(_WAIT_S)  # another process makes the rest


def _map(checked: PngFolder, name: str, frame: str) -> np.ndarray:
    """One map of one frame as `fill_pairs` takes it: attenuation in [0, 1], the others as they are."""
    image = _decoded(checked.files[name][frame], checked.shape)
    return image / np.iinfo(image.dtype).max if name == "attenuation" else image


def _decoded(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """The grey levels of a PNG, (H, W) uint8 or uint16."""
    try:
        image: np.ndarray = imread(path)
    except (OSError, ValueError, SyntaxError) as error:
        raise ValueError(f"{path}: cannot be decoded ({' '.join(str(error).split())})") from error
    if image.shape != shape:
        raise ValueError(f"{path}: is not plain grey (transparent pixels?)")
    return image
