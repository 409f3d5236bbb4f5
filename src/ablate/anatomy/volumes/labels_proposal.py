"""The `labels` of a scene.yaml proposed for volumes: which files hold them, the tissue of each, and the body."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from skimage.filters import threshold_otsu

from ablate.anatomy.scene_values import file_named
from ablate.anatomy.tissue import load_tissues
from ablate.anatomy.tissue_names import place_of_tissue, tissue_of_name
from ablate.anatomy.volumes.label_map import (
    MOST_STRUCTURES,
    TABLE,
    LabelMap,
    checked_labels,
    class_called,
    stem_of,
)
from ablate.anatomy.volumes.label_names import names_beside, names_in_header, tables_beside
from ablate.anatomy.volumes.label_order import as_it_is, covered_masks, order_of_masks, read_order
from ablate.anatomy.volumes.volume_file import SUFFIXES, VolumeFile, check_volume, slabs

_MOST = 128  # different whole numbers in a volume of labels; TotalSegmentator has 118
_OF_TABLE = 20  # so many labels of one volume may all be classes of TotalSegmentator
_NUMBERED = range(105, 118)  # the last label of a version 2 that is no other version: version 1 ends at 104, MR at 56
_SHOWN = 3  # names of tables in a line
_AIR, _SKIN = -500, -300  # Hounsfield units: what reaches down to the first is a CT, and a body is above the second
_BODIES = ("body", "skin", "torso", "trunk")  # beginnings of names of masks that are a body

#: A proposal that says nothing yet, as scene.yaml.jinja reads it.
_NOTHING: dict[str, Any] = {"file": "", "masks": [], "tissues": [], "body": None}
_NOTHING |= dict.fromkeys(("table", "why", "maybe", "beside", "unnamed"), "")


@dataclass(frozen=True)
class _Looked:
    """A volume that was read."""

    name: str
    volume: VolumeFile
    count: Counter[int]  # voxels of each value, where these may be labels
    why: str  # it holds no labels, where it does not

    @property
    def labels(self) -> list[int]:
        return sorted(n for n in self.count if n)


def proposed_labels(names: Sequence[str], folder: Path, left_out: dict[str, str]) -> dict[str, Any] | None:
    """Guess which volumes hold labels, and what they are, as scene.yaml.jinja shows it; heights are in mm.

    Parameters
    ----------
    names : sequence of str
        Of the volumes.
    folder : Path
        Where they lie.
    left_out : dict of str
        Receives, by name, why a volume is not used.

    Returns
    -------
    dict or None
        None where none holds labels. What is proposed has been read: it can be used.
    """
    looked = []
    for name in names:
        try:
            looked.append(
                _look_at(name, check_volume(file_named(name, SUFFIXES, folder, "scene.folder"), "scene.folder"))
            )
        except (ValueError, OSError) as error:
            left_out[name] = str(error)
    masks = _largest_group([one for one in looked if len(one.labels) == 1])
    labelled = max(looked, key=lambda one: len(one.labels), default=None)
    if labelled is None or not labelled.labels:
        left_out |= {one.name: one.why for one in looked}
        return None
    if len(masks) > max(len(labelled.labels), 1):
        proposal, used = _of_masks(masks, folder, left_out)
    else:
        proposal, used = _of_numbers(labelled), [labelled]
    volume = used[0].volume
    others = [one for one in looked if one not in used and one.name not in left_out]
    same = [one for one in others if one.volume.is_on_grid_of(volume)]
    for image in sorted(same, key=lambda one: bool(one.labels)):  # an image before a mask
        if proposal["body"] is None:
            _try_as_body(proposal, image, folder, left_out)
    body = proposal["body"]
    for one in others:
        if one.name not in left_out and (body is None or one.name != body[0]):
            grid = "" if one in same else f", and it is not on the grid of {used[0].name}"
            several = f"{len(proposal['masks'])} masks" if proposal["masks"] else used[0].name
            left_out[one.name] = (one.why or f"{several} of the scene have more labels") + grid
    order = read_order(_as_labels(proposal, folder), "labels")[0]
    corners = [volume.affine @ [*corner, 1] for corner in product(*((0, n - 1) for n in volume.shape))]
    heights = {"z_mm": (min(corner[2] for corner in corners), max(corner[2] for corner in corners))}
    return {**proposal, **heights, "share": float((order > 0).mean())}


def _look_at(name: str, volume: VolumeFile) -> _Looked:
    """Count the values of a volume as far as they may be labels."""
    count = Counter[int]()

    def without(held: str) -> _Looked:
        why = f"it has no labels but holds {held}; allowed are up to {_MOST} whole numbers"
        return _Looked(name, volume, Counter(), why)

    for _, values in slabs(volume):
        low, high = values.min(), values.max()
        if not (low >= 0 and high < 2**16):  # nan neither
            return without(as_it_is(high if low >= 0 else low))
        numbers = values.astype(np.uint16)
        if (fractions := values[numbers != values]).size:
            return without(as_it_is(fractions[0]))
        voxels = np.bincount(numbers.ravel(order="K"))
        count.update({int(n): int(voxels[n]) for n in np.flatnonzero(voxels)})
        if len(count) > _MOST:
            return without("more")
    if len(count) == 1:
        return without(f"only {next(iter(count))}")
    return _Looked(name, volume, count, "")


def _largest_group(masks: Sequence[_Looked]) -> list[_Looked]:
    """Those that are on one grid, of the grid of the most."""
    groups: list[list[_Looked]] = []
    for mask in masks:
        group = next((g for g in groups if g[0].volume.is_on_grid_of(mask.volume)), None)
        groups.append([mask]) if group is None else group.append(mask)
    return max(groups, key=len, default=[])


def _of_numbers(labelled: _Looked) -> dict[str, Any]:
    """A proposal for one volume of all labels."""
    path, numbers = labelled.volume.path, labelled.labels
    names, place = names_in_header(path), "its header"
    if not names:
        names, place = names_beside(path, numbers)
    table, why, maybe = "", "", ""
    if len(numbers) >= _OF_TABLE:
        if place == "its header" and all(class_called(names.get(n, "")) for n in numbers):
            table, why = TABLE, f"{len(numbers)} labels are called in its header as classes of TotalSegmentator"
        elif not names and numbers[-1] in _NUMBERED:
            table, why = TABLE, f"guessed: {len(numbers)} labels without names, the last is {numbers[-1]}"
        elif not names and numbers[-1] < _NUMBERED[0]:
            maybe = f"if they are TotalSegmentator's of version 2, task total, write `tissues: {TABLE}`"
    unread = "" if names else ", ".join(_printable(table.name) for table in tables_beside(path)[:_SHOWN])
    if not names and len(numbers) == 1:
        names = {numbers[0]: stem_of(path)}
    tissues = [(n, *_tissue(names.get(n, ""))) for n in numbers]
    beside = place if place != "its header" else ""
    return _NOTHING | {
        "file": labelled.name,
        "tissues": tissues,
        "table": table,
        "why": why,
        "maybe": maybe,
        "beside": beside,
        "unnamed": unread and f"no name was found of each label, in the header nor beside it in {unread}",
    }


def _of_masks(masks: Sequence[_Looked], folder: Path, left_out: dict[str, str]) -> tuple[dict[str, Any], list[_Looked]]:
    """A proposal for a file a label, and the files of it."""
    guessed: dict[str, tuple[str, str]] = {}
    for mask in masks:
        guessed[mask.name] = _tissue(names_in_header(mask.volume.path).get(mask.labels[0], stem_of(mask.volume.path)))
    ordered = sorted(masks, key=lambda m: (place_of_tissue(guessed[m.name][0]), -m.count[m.labels[0]]))
    stems = Counter(stem_of(mask.volume.path) for mask in ordered)
    kept: list[_Looked] = []
    for mask in ordered:
        stem = stem_of(mask.volume.path)
        if any(stem_of(other.volume.path) == stem for other in kept):
            left_out[mask.name] = f"another of the {stems[stem]} masks that are called {stem} is used"
        elif len(kept) == MOST_STRUCTURES - 1:
            left_out[mask.name] = f"a scene has at most {MOST_STRUCTURES} labels, with the body"
        else:
            kept.append(mask)
    proposal = _NOTHING | {"masks": [(mask.name, *guessed[mask.name]) for mask in kept]}
    labels = _as_labels(proposal, folder)
    covered = set(covered_masks(order_of_masks(labels, "labels"), labels))
    for mask in kept:
        if stem_of(mask.volume.path) in covered:
            left_out[mask.name] = "all its voxels are in other masks, which are smaller or harder"
    proposal["masks"] = [mask for mask in proposal["masks"] if mask[0] not in left_out]
    return proposal, [mask for mask in kept if mask.name not in left_out]


def _tissue(name: str) -> tuple[str, str]:
    """The tissue that a name points to, and why, with the name."""
    called = _printable(name)
    tissue, why = tissue_of_name(name)
    return tissue, f"{why}: {called}" if called else why


def _printable(name: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in name)


def _try_as_body(proposal: dict[str, Any], image: _Looked, folder: Path, left_out: dict[str, str]) -> None:
    """Take an image as the body of a proposal, which is changed, if it gives one."""
    if image.labels and not stem_of(image.volume.path).lower().startswith(_BODIES):
        return
    parts = (part[::4, ::4] for _, part in slabs(image.volume))
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not values.size or values.min() == values.max():
        return
    above, why = (0.5, "its name") if image.labels else (float(threshold_otsu(values)), "by Otsu's threshold")
    if not image.labels and values.min() < _AIR:
        above, why = _SKIN, "a CT"
    proposal["body"] = (image.name, above, why)
    try:
        read_order(_as_labels(proposal, folder), "labels")
    except ValueError as error:
        proposal["body"], left_out[image.name] = None, str(error)


def _as_labels(proposal: dict[str, Any], folder: Path) -> LabelMap:
    """What a proposal means, as it is read from a scene.yaml."""
    content: dict[str, Any] = {"file": proposal["file"], "tissues": proposal["table"] or None}
    if proposal["masks"]:
        content = {"masks": {name: tissue for name, tissue, _ in proposal["masks"]}}
    elif not proposal["table"]:
        content["tissues"] = {number: tissue for number, tissue, _ in proposal["tissues"]}
    if proposal["body"]:
        content["body"] = {"file": proposal["body"][0], "above": float(f"{proposal['body'][1]:.6g}")}
    return checked_labels(content, folder, load_tissues(), "labels")
