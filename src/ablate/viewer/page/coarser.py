"""Fewer triangles for the eye; the simulator keeps them all."""

import numpy as np
import trimesh

_MOST_ROUNDS = 12


def fewer_triangles(mesh: trimesh.Trimesh, most: int) -> trimesh.Trimesh:
    """A mesh with about `most` triangles or fewer: vertices that share a cube become their mean.

    A mesh that has few enough is returned as it is.
    """
    cube = float(np.sqrt(4 * mesh.area / max(most, 1))) / 2
    result = mesh
    for _ in range(_MOST_ROUNDS):
        if len(result.faces) <= most:
            break
        result = _clustered(mesh, cube)
        cube *= 1.2
    return result


def _clustered(mesh: trimesh.Trimesh, cube: float) -> trimesh.Trimesh:
    cells = np.floor((mesh.vertices - mesh.bounds[0]) / cube).astype(np.int64)
    _, owner = np.unique(cells, axis=0, return_inverse=True)
    owner = owner.ravel()
    counts = np.bincount(owner)
    points = np.stack([np.bincount(owner, mesh.vertices[:, k]) / counts for k in range(3)], axis=-1)
    faces = owner[mesh.faces]
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    return trimesh.Trimesh(points, faces, process=False)
