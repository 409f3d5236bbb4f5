"""Which structure each voxel of a scene's labels belongs to: of one volume, of masks, and of the body around them."""

from typing import Any

import numpy as np
from scipy import ndimage

from ablate.anatomy.volumes.label_map import LARGEST_LABEL, Body, Label, LabelMap
from ablate.anatomy.volumes.volume_file import VolumeFile, slabs


def read_order(labels: LabelMap, where: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """Which structure each voxel belongs to, (x, y, z) uint8, 1 and up in the order of their names, 0 for none."""
    if labels.has_masks:
        order = order_of_masks(labels, where)
        if covered := covered_masks(order, labels):
            raise ValueError(
                f"{where}.masks: {covered[0]}: all its voxels are in masks behind it, which own them; allowed is to "
                "name large ones first"
            )
    else:
        order = _order_of_numbers(labels, where)
    if labels.body:
        _add_body(order, labels.body, where)
    return order, tuple(name for name, _ in labels.structures)


def order_of_masks(labels: LabelMap, where: str) -> np.ndarray:
    """`read_order` without the body, from masks: a voxel that is in several belongs to the last."""
    order = np.zeros(labels.volume.shape, np.uint8, order="F")
    for place, label in _places(labels).items():
        volume = labels.volumes[label.mask or 0]
        holds, value = f"{where}.masks: {volume.path} holds", 0
        for part, values in slabs(volume):
            within = values != 0
            value = value or values.max()
            if np.isnan(value) or (values[within] != value).any():  # a sum of parts, an image
                raise ValueError(f"{holds} more values than 0 and one more; allowed is a mask")
            order[:, :, part][within] = place
        if value == 0:
            raise ValueError(f"{holds} only 0; allowed are masks with at least one voxel")
    return order


def covered_masks(order: np.ndarray, labels: LabelMap) -> list[str]:
    """The names of masks of which no voxel is left to them."""
    left = np.bincount(order.ravel(order="K"), minlength=256)
    return [label.name for place, label in _places(labels).items() if not left[place]]


def _places(labels: LabelMap) -> dict[int, Label]:
    """The labels with a tissue, by their number in `read_order`."""
    kept = (label for label in labels.labels if label.tissue is not None)
    return dict(enumerate(kept, start=2 if labels.body else 1))


def _order_of_numbers(labels: LabelMap, where: str) -> np.ndarray:
    """`read_order` without the body, from one volume of all labels."""
    places = np.zeros(LARGEST_LABEL + 1, np.uint8)
    for place, label in _places(labels).items():
        places[label.number] = place
    order = np.zeros(labels.volume.shape, np.uint8, order="F")
    counts = np.zeros(LARGEST_LABEL + 1, np.int64)
    for part, values in slabs(labels.volume):
        numbers = _whole_numbers(values, labels.volume, where)
        counts += np.bincount(numbers.ravel(order="K"), minlength=len(counts))
        order[:, :, part] = places[numbers]
    _check_counts(counts, labels, where)
    return order


def _whole_numbers(values: np.ndarray, volume: VolumeFile, where: str) -> np.ndarray:
    """Values as labels, uint16."""
    holds = f"{where}.file: {volume.path} holds the value"
    for extreme in (values.min(), values.max()):
        if not 0 <= extreme <= LARGEST_LABEL:  # nan neither
            raise ValueError(f"{holds} {as_it_is(extreme)}; allowed are 0 to {LARGEST_LABEL}")
    numbers = values.astype(np.uint16)
    if (fractions := values[numbers != values]).size:
        raise ValueError(f"{holds} {as_it_is(fractions[0])}; labels are whole numbers")
    return numbers


def as_it_is(value: Any) -> str:
    """The fewest digits that tell a number from every other of its kind: 0.9999999 is not 1."""
    is_fraction = abs(value) < np.finfo(np.float32).max and value % 1
    return str(np.float32(value) if is_fraction and np.float32(value) == value else value)


def _check_counts(counts: np.ndarray, labels: LabelMap, where: str) -> None:
    """Raise ValueError where a label has no tissue, or a tissue no voxel; counts of labels, (65536,)."""
    present = set(np.flatnonzero(counts[1:]) + 1)
    if nameless := sorted(present - {label.number for label in labels.labels}):
        raise ValueError(
            f"{where}.tissues: {labels.volume.path} has label {', '.join(map(str, nameless[:10]))} without a tissue; "
            "allowed is a tissue for every label, or null to leave it out"
        )
    if not present:
        raise ValueError(f"{where}.file: {labels.volume.path} has no label, only 0")
    empty = [label.number for label in labels.labels if label.number not in present]
    if labels.complete and empty:
        shown = ", ".join(map(str, sorted(present)[:20]))
        raise ValueError(f"{where}.tissues.{empty[0]}: no voxel of {labels.volume.path} has this label; it has {shown}")


def _add_body(order: np.ndarray, body: Body, where: str) -> None:
    """Give number 1 to the voxels of the body that no label has; changes `order`.

    The body is the largest connected part above the threshold, which leaves out the table under the patient, and what
    it encloses in each slice across the body, such as lungs and gas.
    """
    mask = order > 0
    for part, values in slabs(body.image):
        mask[:, :, part] |= values > body.above
    numbered, parts = ndimage.label(mask)
    if parts > 1:
        mask = numbered == 1 + np.argmax(np.bincount(numbered.ravel(order="K"))[1:])
    del numbered
    across = int(np.argmax(np.abs(body.image.affine[2, :3]) / body.image.spacing_mm))
    for plane, numbers in zip(np.moveaxis(mask, across, 0), np.moveaxis(order, across, 0), strict=True):
        numbers[(numbers == 0) & ndimage.binary_fill_holes(plane)] = 1
    if not (order == 1).any():
        raise ValueError(f"{where}.body.above: no voxel of {body.image.path} is above {body.above:g} and has no label")
