"""Surfaces of two structures that coincide: they break the counting of crossings."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

logger = logging.getLogger(__name__)

TOLERANCE_MM = 1e-3


@dataclass(frozen=True)
class SharedWall:
    """Two meshes with triangles at the same place: their indices, names, and how many."""

    first: int
    second: int
    first_name: str
    second_name: str
    triangles: int


def shared_walls(meshes: Sequence[trimesh.Trimesh], tolerance_mm: float = TOLERANCE_MM) -> list[SharedWall]:
    """Pairs of meshes with triangles whose centroids coincide within the tolerance.

    Parameters
    ----------
    meshes : sequence of trimesh.Trimesh
    tolerance_mm : float
        Centroids are compared on a grid of this spacing and on the same grid shifted by half of it.

    Returns
    -------
    list of SharedWall
        At most one a pair, ordered by the pair.
    """
    if len(meshes) < 2:
        return []
    centroids = np.concatenate([mesh.triangles_center for mesh in meshes])
    owner = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    counts: dict[tuple[int, int], int] = {}
    for shift in (0.0, 0.5):
        cell = np.floor(centroids / tolerance_mm + shift).astype(np.int64)
        order = np.lexsort((owner, *cell.T))
        same = (np.diff(cell[order], axis=0) == 0).all(axis=1) & (np.diff(owner[order]) > 0)
        pairs, number = np.unique(
            np.stack([owner[order[:-1]][same], owner[order[1:]][same]], axis=1), axis=0, return_counts=True
        )
        for (i, j), n in zip(pairs.tolist(), number.tolist(), strict=True):
            counts[i, j] = max(n, counts.get((i, j), 0))
    return [SharedWall(i, j, _name(meshes[i], i), _name(meshes[j], j), n) for (i, j), n in sorted(counts.items())]


def warn_of_shared_walls(meshes: Sequence[trimesh.Trimesh]) -> list[SharedWall]:
    """Log a warning for each pair that `shared_walls` finds, and return them."""
    found = shared_walls(meshes)
    for wall in found:
        logger.warning(
            "%s and %s share a wall (%d triangles coincide within %g mm): ownership there is undefined",
            wall.first_name, wall.second_name, wall.triangles, TOLERANCE_MM,
        )  # fmt: skip
    return found


def _name(mesh: trimesh.Trimesh, index: int) -> str:
    return str(mesh.metadata.get("name", f"structure {index}"))
