"""The structures of a label volume: voxels sorted by structure, and a closed surface around each."""

import logging
from pathlib import Path

import numpy as np
from scipy import ndimage

from ablate.anatomy.meshes.repair import repair
from ablate.anatomy.scene import Scene, Structure
from ablate.anatomy.scene_cache import cached_scene
from ablate.anatomy.tissue import load_tissues
from ablate.anatomy.volumes.label_map import LABELS_VERSION, LARGEST_LABEL, Body, LabelMap
from ablate.anatomy.volumes.label_surface import label_surface
from ablate.anatomy.volumes.volume_file import VolumeFile, slabs
from ablate.storage import digest_of_files

logger = logging.getLogger(__name__)


def labelled_structures(labels: LabelMap, where: str, cache_dir: Path | None = None) -> tuple[Structure, ...]:
    """Closed surfaces in world mm, in the order of the labels; `mesh.metadata["name"]` is the name of the label.

    Labels that touch share no wall: the earlier one is continued under the later one. The surfaces are kept in
    `cache_dir`, where it is given.

    Raises
    ------
    ValueError
        When a file cannot be read to its end, holds what is no label, or has a label without a tissue or a tissue
        without a voxel; `where` stands before the key.
    """
    made_from = {
        "labels": [(label.number, label.name, label.tissue is None) for label in labels.labels],
        "above": labels.body and labels.body.above,
        "files": digest_of_files(labels.files),
        "version": LABELS_VERSION,
    }
    scene = cached_scene(cache_dir, lambda: _surfaces(labels, where), **made_from)
    tissues = dict(labels.structures)
    return tuple(Structure(s.mesh, tissues[s.mesh.metadata["name"]]) for s in scene.structures)


def _surfaces(labels: LabelMap, where: str) -> Scene:
    """All surfaces, as a scene whose tissues mean nothing: they may change without the surfaces."""
    order, names = read_order(labels, where)
    volume, any_tissue = labels.volume, next(iter(load_tissues().values()))
    structures = []
    for number, (name, box) in enumerate(zip(names, ndimage.find_objects(order, len(names)), strict=True), start=1):
        if box is None:  # a class of the table that the volume has not
            continue
        vertices, faces = label_surface(order, number, box, volume.spacing_mm)
        world = vertices @ volume.affine[:3, :3].T + volume.affine[:3, 3]
        structures.append(Structure(repair(world, faces, name), any_tissue))
        logger.info("%s: %s has %d triangles", volume.path.name, name, len(structures[-1].mesh.faces))
    return Scene(tuple(structures), any_tissue, volume.path.name)


def read_order(labels: LabelMap, where: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """Which structure each voxel belongs to, (x, y, z) uint8, 1 and up in the order of their names, 0 for none."""
    kept = [label for label in labels.labels if label.tissue is not None]
    first = 2 if labels.body else 1
    places = np.zeros(LARGEST_LABEL + 1, np.uint8)
    for place, label in enumerate(kept, start=first):
        places[label.number] = place
    order = np.zeros(labels.volume.shape, np.uint8, order="F")
    counts = np.zeros(LARGEST_LABEL + 1, np.int64)
    for part, values in slabs(labels.volume):
        numbers = _whole_numbers(values, labels.volume, where)
        counts += np.bincount(numbers.ravel(order="K"), minlength=len(counts))
        order[:, :, part] = places[numbers]
    _check_counts(counts, labels, where)
    if labels.body:
        _add_body(order, labels.body, where)
    return order, tuple(name for name, _ in labels.structures)


def _whole_numbers(values: np.ndarray, volume: VolumeFile, where: str) -> np.ndarray:
    """Values as labels, uint16."""
    for extreme in (values.min(), values.max()):
        if not 0 <= extreme <= LARGEST_LABEL:  # nan neither
            raise ValueError(
                f"{where}.file: {volume.path} holds the value {extreme:g}; allowed are 0 to {LARGEST_LABEL}"
            )
    numbers = values.astype(np.uint16)
    if (fractions := values[numbers != values]).size:
        raise ValueError(f"{where}.file: {volume.path} holds the value {fractions[0]:g}; labels are whole numbers")
    return numbers


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
    across = int(np.argmax(np.abs(body.image.affine[2, :3])))
    for plane, own in zip(np.moveaxis(mask, across, 0), np.moveaxis(order, across, 0), strict=True):
        own[(own == 0) & ndimage.binary_fill_holes(plane)] = 1
    if not (order == 1).any():
        raise ValueError(f"{where}.body.above: no voxel of {body.image.path} is above {body.above:g} and has no label")
