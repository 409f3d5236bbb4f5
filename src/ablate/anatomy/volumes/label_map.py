"""The `labels` of a scene.yaml, checked: files of volumes, the tissue of each label, and the body around them."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from ablate.anatomy.scene_values import file_named, mapping, number, one_of, refusal
from ablate.anatomy.tissue import Tissue
from ablate.anatomy.volumes.volume_file import SUFFIXES, VolumeFile, check_volume

LABELS_VERSION = 2  # of the surfaces that are made from labels: raised when they change
TABLE = "totalsegmentator"  # classes of its task `total`, version 2
LARGEST_LABEL = 65_535
MOST_STRUCTURES = 254  # they are counted in 8 bits, with the body


@dataclass(frozen=True)
class Label:
    """A label of the volume; without a tissue it is left out."""

    number: int
    name: str
    tissue: Tissue | None


@dataclass(frozen=True)
class Body:
    """What is above a threshold in an image on the grid of the labels, with all that it encloses."""

    image: VolumeFile
    above: float
    tissue: Tissue


@dataclass(frozen=True)
class LabelMap:
    """A volume of labels, its structures in their order: of two that touch, the later one's wall is the visible one."""

    volume: VolumeFile
    labels: tuple[Label, ...]
    complete: bool  # whether each label must be in the volume
    body: Body | None

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that the structures are made from."""
        return (self.volume.path, *((self.body.image.path,) if self.body else ()))

    @property
    def structures(self) -> tuple[tuple[str, Tissue], ...]:
        """Name and tissue of all that may become a structure, the body first."""
        body = (("body", self.body.tissue),) if self.body else ()
        return (*body, *((label.name, label.tissue) for label in self.labels if label.tissue))


def checked_labels(content: Any, folder: Path, tissues: Mapping[str, Tissue], where: str) -> LabelMap:
    """Check `{file, tissues, body}`, and the headers of the files that it names.

    Parameters
    ----------
    content : object
        What stands in the `scene.yaml`.
    folder : Path
        Where it lies.
    tissues : mapping of str to Tissue
        Those that may be named.
    where : str
        The key, for messages.

    Raises
    ------
    FileNotFoundError or ValueError
        When a file is missing or cannot be used, or a key or value is not as it should be.
    """
    content = mapping(content, where, ("file", "tissues", "body"))
    volume = check_volume(file_named(content.get("file"), SUFFIXES, folder, f"{where}.file"), f"{where}.file")
    named = content.get("tissues")
    if named == TABLE:
        labels = tuple(Label(n, name, tissues[one_of(t, tissues, where)]) for n, name, t in _table())
    else:
        labels = _labels(named, tissues, f"{where}.tissues")
    body = None
    if content.get("body"):
        own, key = mapping(content["body"], f"{where}.body", ("file", "above", "tissue")), f"{where}.body"
        image = check_volume(file_named(own.get("file"), SUFFIXES, folder, f"{key}.file"), f"{key}.file")
        if image.shape != volume.shape or not np.allclose(image.affine, volume.affine, atol=1e-3):
            raise ValueError(f"{key}.file: {image.path} has not the shape and the affine of {volume.path}")
        tissue = tissues[one_of(own.get("tissue", "soft_tissue"), tissues, f"{key}.tissue")]
        body = Body(image, number(own.get("above"), f"{key}.above"), tissue)
    if body is None and not any(label.tissue for label in labels):
        raise ValueError(f"{where}.tissues: every label is null; allowed is at least one with a tissue, or a body")
    return LabelMap(volume, labels, named != TABLE, body)


def _labels(named: Any, tissues: Mapping[str, Tissue], where: str) -> tuple[Label, ...]:
    if not isinstance(named, Mapping) or not named:
        raise refusal(where, named, f"{TABLE}, or mappings of labels to tissues")
    labels = []
    for label, name in named.items():
        if not isinstance(label, int) or isinstance(label, bool) or not 1 <= label <= LARGEST_LABEL:
            raise refusal(f"{where}: label", label, f"whole numbers from 1 to {LARGEST_LABEL}")
        tissue = None if name is None else tissues[one_of(name, tissues, f"{where}.{label}")]
        labels.append(Label(label, f"label {label}", tissue))
    if sum(label.tissue is not None for label in labels) > MOST_STRUCTURES:
        raise ValueError(f"{where}: {len(labels)} labels; allowed are at most {MOST_STRUCTURES}")
    return tuple(labels)


def _table() -> list[tuple[int, str, str]]:
    """Label, name and tissue of each class of `TABLE`."""
    with files("ablate.anatomy.volumes").joinpath(f"{TABLE}.csv").open(encoding="utf-8") as stream:
        return [(int(row["label"]), row["name"], row["tissue"]) for row in csv.DictReader(stream)]
