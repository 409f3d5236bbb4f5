"""Smooth closed surfaces around the voxels of one label, in blocks, so that memory does not grow with the volume.

The surface is a level of the smoothed distance to the label's boundary, in mm. Labels that touch would share a wall,
and coincident walls break the counting of crossings. So the structure that stands earlier in the list is continued
under those that stand later, which own the place anyway: the visible wall is the later structure's own, and no volume
changes hands.
"""

import logging
import math
from collections.abc import Sequence
from itertools import product
from pathlib import Path

import numpy as np
import trimesh
from scipy import ndimage
from scipy.ndimage import gaussian_filter
from skimage.measure import marching_cubes

from ablate.anatomy.meshes.repair import repair
from ablate.anatomy.scene import ANATOMY_VERSION, Scene, Structure, cached_scene
from ablate.anatomy.tissue import load_tissues
from ablate.anatomy.volumes.label_map import LABELS_VERSION, LabelMap
from ablate.anatomy.volumes.label_order import read_order
from ablate.storage import digest_of_files

BLOCK = 64  # voxels along a side
SMOOTHING = 0.7  # standard deviation of the Gaussian, voxels
_TRUNCATE = 3.0  # of the Gaussian, standard deviations
_REACH, _HIDDEN = 3.0, 1.25  # distances are cut there, and walls hidden that deep, in the voxels' longest side
_SLOPE = 0.5  # a hidden wall leaves the visible one by this much a unit of length, so that they do not coincide
#: Levels tried for the volume, first far apart, then nearer about the one found, in the voxels' longest side.
_LEVELS = (np.linspace(-1.5, 0.75, 7), np.linspace(-0.225, 0.225, 5), np.linspace(-0.0375, 0.0375, 5))
_FRACTION = 2.0**-14  # of a voxel, to which vertices are rounded, so that those of neighbouring blocks are equal
Blocks = list[tuple[np.ndarray, np.ndarray]]  # first voxel, (3,), and content with margins, of each

logger = logging.getLogger(__name__)


def label_surface(
    order: np.ndarray, number: int, box: Sequence[slice], spacing_mm: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """The surface around the voxels of one number.

    Its level is the one at which the volume that the structure owns is that of its voxels. What lies outside the
    volume counts as 0, so a structure that is cut by the volume's border is closed there.

    Parameters
    ----------
    order : (x, y, z) uint8
        Which structure each voxel belongs to, 1 and up in the order of the list, 0 for none.
    number : int
        The structure.
    box : sequence of slice
        Holds all its voxels, as `scipy.ndimage.find_objects` gives it.
    spacing_mm : (3,) float
        From voxel to voxel.

    Returns
    -------
    vertices : (n, 3) float64
        In voxel indices.
    faces : (m, 3) int
        Of the surface.
    """
    blocks = _blocks(order, number, box, _margin(spacing_mm))
    level, voxels = 0.0, int((order[tuple(box)] == number).sum())
    for steps in _LEVELS:
        level = _level_of_volume(blocks, number, spacing_mm, level + max(spacing_mm) * steps, voxels)
    parts = (_triangles(_fields(block, number, spacing_mm)[0], level, start) for start, block in blocks)
    vertices, faces = trimesh.util.append_faces(*zip(*parts, strict=True))
    return np.round(vertices / _FRACTION) * _FRACTION, faces


def _level_of_volume(
    blocks: Blocks, number: int, spacing_mm: Sequence[float], levels: np.ndarray, voxels: int
) -> float:
    """The level at which the volume that a structure owns is that of its voxels, from rising levels (n,), mm."""
    volumes = np.zeros(len(levels))
    for start, block in blocks:
        field, later = _fields(block, number, spacing_mm)
        for i, level in enumerate(levels):
            visible = field - level if later is None else np.minimum(field - level, -later)
            vertices, faces = _triangles(visible, 0.0, start)
            a, b, c = (vertices[faces[:, corner]] for corner in range(3))
            volumes[i] += float((a * np.cross(b, c)).sum()) / 6  # of all blocks: that of a closed surface
    # the cube root, because it is nearly linear; volumes fall with the level
    return float(np.interp(np.cbrt(voxels), np.cbrt(np.abs(volumes[::-1])), levels[::-1]))


def _margin(spacing_mm: Sequence[float]) -> np.ndarray:
    """Voxels beyond a block that its field depends on, (3,)."""
    smoothing = math.ceil(_TRUNCATE * SMOOTHING)
    return np.array([math.ceil(_REACH * max(spacing_mm) / side) + smoothing for side in spacing_mm])


def _blocks(order: np.ndarray, number: int, box: Sequence[slice], margin: np.ndarray) -> Blocks:
    """First voxel, (3,), and content, with margins, of each block that the surface can pass.

    A block has its last voxels in common with the next one, so that no cell lies between two blocks.
    """
    lower, upper = (np.array([getattr(side, end) for side in box]) for end in ("start", "stop"))
    first, stop = lower - 2 * margin, upper + 2 * margin
    inside = np.ascontiguousarray(order[tuple(slice(max(a, 0), b) for a, b in zip(first, stop, strict=True))])
    before = np.maximum(-first, 0)
    content = np.pad(inside, np.stack([before, stop - first - before - inside.shape], axis=1))  # 0 beyond the volume
    blocks = []
    for start in product(*(range(0, int(n), BLOCK) for n in stop - first - 2 * margin - 1)):
        block = content[tuple(slice(s, s + BLOCK + 1 + 2 * m) for s, m in zip(start, margin, strict=True))]
        is_own = block == number
        if is_own.any() and not is_own.all():
            blocks.append((lower - margin + start, block))
    return blocks


def _fields(block: np.ndarray, number: int, spacing_mm: Sequence[float]) -> tuple[np.ndarray, np.ndarray | None]:
    """The structure's field, above 0 inside, and that of all later ones, None where there are none; without margins."""
    margin = _margin(spacing_mm)
    reach_mm, hidden_mm = _REACH * max(spacing_mm), _HIDDEN * max(spacing_mm)
    to_own, to_earlier = (_distance(mask, spacing_mm, reach_mm) for mask in (block == number, block < number))
    inner = tuple(slice(m, n - m) for m, n in zip(margin, block.shape, strict=True))

    def smoothed(distance: np.ndarray) -> np.ndarray:
        return gaussian_filter(distance, SMOOTHING, truncate=_TRUNCATE, mode="nearest")[inner]

    if block.max() <= number:
        return smoothed(to_earlier - to_own), None
    to_later = _distance(block > number, spacing_mm, reach_mm)
    this = smoothed(np.minimum(to_earlier, to_later) - to_own)
    both = smoothed(to_earlier - np.minimum(to_own, to_later))
    later = smoothed(np.minimum(to_earlier, to_own) - to_later)
    return np.minimum((both + _SLOPE * this) / (1 + _SLOPE), this + hidden_mm), later


def _distance(mask: np.ndarray, spacing_mm: Sequence[float], reach_mm: float) -> np.ndarray:
    """Distance to the nearest voxel of a mask, mm, float32, at most `reach_mm`.

    Squared distances are separable: along each axis the least of the neighbours' plus the square of the step.
    """
    squared = np.where(mask, np.float32(0), np.float32(reach_mm**2))
    for axis, side_mm in enumerate(spacing_mm):
        along, least = np.moveaxis(squared, axis, 0), np.moveaxis(squared.copy(), axis, 0)
        for step in range(1, math.ceil(reach_mm / side_mm)):
            added = np.float32((step * side_mm) ** 2)
            np.minimum(least[step:], along[:-step] + added, out=least[step:])
            np.minimum(least[:-step], along[step:] + added, out=least[:-step])
        squared = np.moveaxis(least, 0, axis)
    return np.sqrt(squared)


def _triangles(field: np.ndarray, level: float, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Vertices, float64, in voxel indices, and faces where a field passes a level."""
    if not field.min() < level < field.max():
        return np.empty((0, 3)), np.empty((0, 3), np.int64)
    vertices, faces, _, _ = marching_cubes(field, level, gradient_direction="ascent")
    return vertices.astype(np.float64) + start, faces.astype(np.int64)


def labelled_structures(labels: LabelMap, where: str, cache_dir: Path | None = None) -> tuple[Structure, ...]:
    """Closed surfaces in world mm, in the order of the labels; `mesh.metadata["name"]` is the name of the label.

    Labels that touch share no wall: the earlier one is continued under the later one. The surfaces are kept in
    `cache_dir`, where it is given. Raises ValueError when a file cannot be read to its end, holds what is no label, or
    has a label without a tissue or a tissue without a voxel; `where` stands before the key.
    """
    made_from = {
        "labels": [(label.number, label.name, label.tissue is None) for label in labels.labels],
        "above": labels.body and labels.body.above,
        "masks": labels.has_masks,
        "files": digest_of_files(labels.files),
        "version": [LABELS_VERSION, ANATOMY_VERSION],  # the second is that of mesh repair, too
    }
    scene = cached_scene(cache_dir, lambda: _surfaces(labels, where), **made_from)
    surfaces = [structure.mesh for structure in scene.structures]
    structures = []
    for name, tissue in labels.structures:  # by their order, as two may have one name
        if surfaces and surfaces[0].metadata["name"] == Path(name).name:  # else a class of the table without a voxel
            mesh = surfaces.pop(0)
            mesh.metadata["name"] = name
            structures.append(Structure(mesh, tissue))
    return tuple(structures)


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
