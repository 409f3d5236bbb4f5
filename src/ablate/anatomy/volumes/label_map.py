"""The `labels` of a scene.yaml, checked: files of volumes, the tissue of each label, and the body around them."""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from ablate.anatomy.scene_values import file_named, mapping, number, one_of, refusal
from ablate.anatomy.tissue import Tissue
from ablate.anatomy.volumes.label_names import names_beside, names_in_header
from ablate.anatomy.volumes.volume_file import SUFFIXES, VolumeFile, check_volume
from ablate.setting import shown

LABELS_VERSION = 4  # of the structures that are made from labels: raised when their surfaces, names or tissues change
TABLE = "totalsegmentator"  # its classes, of which the numbered ones are those of version 2, task `total`
LARGEST_LABEL = 65_535
MOST_STRUCTURES = 254  # they are counted in 8 bits, with the body


@dataclass(frozen=True)
class Label:
    """A label of the volume; without a tissue it is left out."""

    number: int
    name: str
    tissue: Tissue | None
    mask: int | None = None  # the volume that holds it alone, by its place in `LabelMap.volumes`


@dataclass(frozen=True)
class Body:
    """What is above a threshold in an image on the grid of the labels, with all that it encloses."""

    image: VolumeFile
    above: float
    tissue: Tissue


@dataclass(frozen=True)
class LabelMap:
    """Volumes of labels and their structures, in order: of two that touch, the later one's wall is the visible one."""

    volumes: tuple[VolumeFile, ...]  # one that holds all labels or, of one grid, one a label: its voxels that are not 0
    labels: tuple[Label, ...]
    complete: bool  # whether each label must be in the volume
    body: Body | None
    guessed: str = ""  # what was guessed by numbers alone, for whoever looks at a first frame
    table: Path | None = None  # beside the volume, where that names the labels

    @property
    def volume(self) -> VolumeFile:
        """The one of all labels, or the first of the masks: the grid."""
        return self.volumes[0]

    @property
    def has_masks(self) -> bool:
        """Whether each label has a file of its own."""
        return any(label.mask is not None for label in self.labels)

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that the structures are made from."""
        return (*(volume.path for volume in self.volumes), *((self.body.image.path,) if self.body else ()))

    @property
    def structures(self) -> tuple[tuple[str, Tissue], ...]:
        """Name and tissue of all that may become a structure, the body first."""
        body = (("body", self.body.tissue),) if self.body else ()
        return (*body, *((label.name, label.tissue) for label in self.labels if label.tissue))


def checked_labels(content: Any, folder: Path, tissues: Mapping[str, Tissue], where: str) -> LabelMap:
    """Check `{file, tissues, body}` or `{masks, body}`, and the headers of the files that are named.

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
    content = mapping(content, where, ("file", "tissues", "masks", "body"))
    named, guessed, table = content.get("tissues"), "", None
    if "masks" in content:
        if twice := [key for key in ("file", "tissues") if key in content]:
            raise ValueError(f"{where}.{twice[0]}: allowed is either {twice[0]} or masks, which have a file a label")
        volumes, labels = _masks(content["masks"], folder, tissues, f"{where}.masks")
    else:
        volumes = (check_volume(file_named(content.get("file"), SUFFIXES, folder, f"{where}.file"), f"{where}.file"),)
        if named == TABLE:
            labels, guessed = _classes(volumes[0].path, tissues, f"{where}.tissues")
        else:
            labels, table = _labels(named, tissues, volumes[0].path, f"{where}.tissues")
    body = None
    if content.get("body"):
        own, key = mapping(content["body"], f"{where}.body", ("file", "above", "tissue")), f"{where}.body"
        image = check_volume(file_named(own.get("file"), SUFFIXES, folder, f"{key}.file"), f"{key}.file")
        if not image.is_on_grid_of(volumes[0]):
            raise ValueError(f"{key}.file: {image.path} has not the shape and the affine of {volumes[0].path}")
        tissue = tissues[one_of(own.get("tissue", "soft_tissue"), tissues, f"{key}.tissue")]
        body = Body(image, number(own.get("above"), f"{key}.above"), tissue)
    if body is None and not any(label.tissue for label in labels):
        raise ValueError(f"{where}.tissues: every label is null; allowed is at least one with a tissue, or a body")
    return LabelMap(volumes, labels, named != TABLE, body, guessed, table)


def _masks(
    named: Any, folder: Path, tissues: Mapping[str, Tissue], where: str
) -> tuple[tuple[VolumeFile, ...], tuple[Label, ...]]:
    """The volumes of `{file: tissue}`, of one grid, and their labels, which are called as the files."""
    if not isinstance(named, Mapping) or not 0 < len(named) <= MOST_STRUCTURES:
        raise refusal(where, named, f"mappings of 1 to {MOST_STRUCTURES} files to tissues")
    volumes, labels = [], dict[str, Label]()
    for position, (file, name) in enumerate(named.items()):
        key = f"{where}.{file}"
        volumes.append(check_volume(file_named(file, SUFFIXES, folder, key), key))
        if not volumes[-1].is_on_grid_of(volumes[0]):
            raise ValueError(f"{key}: {volumes[-1].path} has not the shape and the affine of {volumes[0].path}")
        stem = stem_of(volumes[-1].path)
        if stem in labels:
            raise ValueError(f"{key}: another mask is called {stem}, too; allowed are names of their own")
        tissue = None if name is None else tissues[one_of(name, tissues, key)]
        labels[stem] = Label(position + 1, stem, tissue, position)
    return tuple(volumes), tuple(labels.values())


def _classes(path: Path, tissues: Mapping[str, Tissue], where: str) -> tuple[tuple[Label, ...], str]:
    """The classes of `TABLE`, by the names in the header, else by number; and what was guessed."""
    names = names_in_header(path)
    if not names:
        guessed = f"{path.name} names no label, so its numbers are taken for TotalSegmentator's of version 2"
        return tuple(Label(n, name, tissues[one_of(t, tissues, where)]) for n, name, t in numbered_classes()), guessed
    classes: dict[int, tuple[str, str]] = {}
    for label, name in names.items():
        if (found := class_called(name)) is None:
            raise ValueError(
                f"{where}: {path} calls its label {label} {shown(name)}, which is no class of TotalSegmentator that is "
                "known; allowed are mappings of labels to tissues, as task=describe proposes them"
            )
        classes[label] = found
    called = {label: name for label, (name, _) in classes.items()}  # parts of one organ have one name
    by_number = sorted(classes.items())
    return tuple(Label(n, _called(n, called), tissues[one_of(t, tissues, where)]) for n, (_, t) in by_number), ""


def _labels(named: Any, tissues: Mapping[str, Tissue], path: Path, where: str) -> tuple[tuple[Label, ...], Path | None]:
    """The labels of `{number: tissue}`, called as the volume or a table beside it calls them; and that table."""
    if not isinstance(named, Mapping) or not named:
        raise refusal(where, named, f"{TABLE}, or mappings of labels to tissues")
    names, table = names_in_header(path), ""
    if not names:
        names, table = names_beside(path, [label for label in named if isinstance(label, int)])
    labels = []
    for label, name in named.items():
        if not isinstance(label, int) or isinstance(label, bool) or not 1 <= label <= LARGEST_LABEL:
            raise refusal(f"{where}: label", label, f"whole numbers from 1 to {LARGEST_LABEL}")
        tissue = None if name is None else tissues[one_of(name, tissues, f"{where}.{label}")]
        labels.append(Label(label, _called(label, names), tissue))
    if (count := sum(label.tissue is not None for label in labels)) > MOST_STRUCTURES:
        raise ValueError(f"{where}: {count} labels with a tissue; allowed are at most {MOST_STRUCTURES}")
    return tuple(labels), path.with_name(table) if table else None


def _called(label: int, names: Mapping[int, str]) -> str:
    """What a label is called; those that share a name have their number, too, and so has one that is called `body`."""
    name = names.get(label)
    if name is None:
        return f"label {label}"
    is_alone = list(names.values()).count(name) == 1 and name != "body"
    return name if is_alone else f"{name} {label}"


def numbered_classes() -> list[tuple[int, str, str]]:
    """Label, name and tissue of each class of version 2, task `total`."""
    return [(int(row["label"]), row["name"], row["tissue"]) for row in _table().values() if row["label"]]


def class_called(name: str) -> tuple[str, str] | None:
    """Name and tissue of the class of any version or task that has this name, in whatever case and with blanks."""
    row = _table().get(_in_lower_case(name))
    return (row["name"], row["tissue"]) if row else None


def stem_of(path: Path) -> str:
    """The name of a volume's file without its ending."""
    return re.sub(r"(\.seg)?(\.nii|\.nii\.gz|\.nrrd)$", "", path.name, flags=re.IGNORECASE)


def _in_lower_case(name: str) -> str:
    return re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_")


@cache
def _table() -> dict[str, dict[str, str]]:
    with files("ablate.anatomy.volumes").joinpath(f"{TABLE}.csv").open(encoding="utf-8") as stream:
        return {_in_lower_case(row["name"]): row for row in csv.DictReader(stream)}
