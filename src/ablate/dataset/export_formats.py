"""Pairs written for others: an overview picture, PNGs that `scene=pairs` reads, the folder of nnU-Net."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import yaml
from skimage.color import hsv2rgb
from skimage.io import imread
from skimage.transform import resize
from skimage.util import montage

from ablate.anatomy import Tissue, load_tissues
from ablate.dataset.pairs import Pairs
from ablate.dataset.png_folder import FOLDERS
from ablate.dataset.png_tables import fan_values
from ablate.dataset.split import Part
from ablate.storage import write_image, write_json, write_text

if TYPE_CHECKING:
    from ablate.dataset.classes import Classes  # which loads the simulator

_THUMBNAIL_PX = 320
_PER_PART = 8  # frames on the contact sheet
# A colour a label, the same in every frame: hues a golden angle apart, outside the fan black.
_HUES = np.arange(256) * 0.381966 % 1
_COLOURS = hsv2rgb(np.stack([_HUES, np.full(256, 0.55), np.where(np.arange(256) % 2, 0.95, 0.7)], axis=-1))
_COLOURS[0] = 0
_FOLD = {"train": Part.train, "val": Part.validation}  # as nnU-Net calls them


def write_contact_sheet(pairs: Pairs, path: Path) -> None:
    """Write frames of each part as B-mode with their segmentation below, train first, as one PNG.

    `segmentation` and `target` must be filled. Of each part, eight frames are shown, equally spaced, in one row.
    """
    tiles = []
    for part in Part:
        frames = pairs.frames(part)
        shown = frames[np.linspace(0, len(frames) - 1, _PER_PART).round().astype(int)]  # repeated where there are few
        images = pairs.read("target", shown) / 255.0
        labels = pairs.read("segmentation", shown)
        tiles += [np.repeat(_thumbnail(i)[..., None], 3, axis=2) for i in images]
        tiles += [_thumbnail(_COLOURS[s]) for s in labels]
    sheet = montage(np.stack(tiles), channel_axis=3, grid_shape=(2 * len(Part), _PER_PART), padding_width=4)
    write_image(path, (np.clip(sheet, 0, 1) * 255).astype(np.uint8))  # other processes that filled the set write it too


def _thumbnail(image: np.ndarray) -> np.ndarray:
    longer = max(image.shape[:2])  # the sheet of a narrow image would else be gigabytes
    return resize(image, [max(round(n * _THUMBNAIL_PX / longer), 1) for n in image.shape[:2]], anti_aliasing=True)


def write_png(pairs: Pairs, folder: Path, tissues: Sequence[Tissue]) -> None:
    """A folder that `scene=pairs` reads back bit for bit; its labels have names if all tissues are built-in ones."""
    numbers = range(len(pairs))
    for name in sorted(pairs.maps & FOLDERS.keys()):
        if pairs.missing(frozenset({name})):
            continue
        map_folder = folder / FOLDERS[name]
        map_folder.mkdir(parents=True, exist_ok=True)
        for frame in numbers:
            write_image(map_folder / f"{_name(frame)}.png", pairs.stored(name, frame))
    frames = {
        "name": [_name(frame) for frame in numbers],
        "site": [f"site{site}" for site in pairs.sites],
        "part": [Part(part).name for part in pairs.split],
    }
    write_text(folder / "frames.csv", pd.DataFrame(frames).to_csv(index=False))
    if all(load_tissues().get(tissue.name) == tissue for tissue in tissues):
        labels = pd.Series(pairs.tissues, pd.RangeIndex(1, len(pairs.tissues) + 1, name="label"), name="tissue")
        write_text(folder / "labels.csv", labels.to_csv())
    if pairs.probe:
        write_text(folder / "fan.yaml", yaml.safe_dump(fan_values(pairs.probe), sort_keys=False))


def write_nnunet(pairs: Pairs, folder: Path, classes: Classes) -> None:
    """Images and segmentations: test frames in imagesTs and labelsTs, all others in imagesTr and labelsTr.

    Classes are those that occur, numbered one after another, as nnU-Net wants them. `splits_final.json` holds one fold,
    the validation frames of the study; nnU-Net reads it in its folder of preprocessed data.
    """
    ends = ["Ts" if part == Part.test else "Tr" for part in pairs.split]
    for kind, end in product(("images", "labels"), set(ends)):
        (folder / f"{kind}{end}").mkdir(parents=True, exist_ok=True)
    files = [folder / f"labels{end}" / f"{_name(frame)}.png" for frame, end in enumerate(ends)]
    occurring = {0}
    for frame, (end, file) in enumerate(zip(ends, files, strict=True)):
        write_image(folder / f"images{end}" / f"{_name(frame)}_0000.png", pairs.stored("target", frame))
        segmentation = classes.labels(frame)
        write_image(file, segmentation)
        occurring.update(np.unique(segmentation).tolist())
    labels = sorted(occurring)
    for file in files:  # numbered anew, now that it is known which occur
        write_image(file, np.searchsorted(labels, imread(file)).astype(np.uint8))
    names = ("background", *(name.replace(" ", "_") for name in classes.names))
    about = {
        "channel_names": {"0": "ultrasound"},
        "labels": {name: number for number, name in enumerate(_class_names(names, labels))},
        "file_ending": ".png",
        "numTraining": int((pairs.split != Part.test).sum()),
    }
    write_json(folder / "dataset.json", about)
    fold = {key: [_name(int(frame)) for frame in pairs.frames(part)] for key, part in _FOLD.items()}
    write_text(folder / "splits_final.json", json.dumps([fold], indent=2))


def _class_names(names: Sequence[str], labels: Sequence[int]) -> list[str]:
    """The name of each label, with its number where another is called so, or where nnU-Net means something by it."""
    called = []
    for label in labels:
        name = names[label]
        if label and (names.count(name) > 1 or name == "ignore"):
            while name in names or name in called:
                name = f"{name}_{label}"
        called.append(name)
    return called


def _name(frame: int) -> str:
    return f"frame{frame:05d}"
