"""Where a volume ends within a body: the scene is closed there by a flat wall, with only background behind it."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from ablate.anatomy.scene import Scene, Structure
from ablate.anatomy.volumes.volume_file import VolumeFile

_FEWEST = 3  # vertices of a wall


def end_walls(structures: Sequence[Structure], volume: VolumeFile) -> tuple[np.ndarray, ...]:
    """The flat walls that close structures at the ends of their volume.

    Each is a transform, (4, 4) float64, of the world, mm: x and y of the wall lie between 0 and 1, and z is above 0
    behind it.
    """
    to_voxels = np.linalg.inv(volume.affine)
    world = np.concatenate([structure.mesh.vertices for structure in structures])
    voxels = world @ to_voxels[:3, :3].T + to_voxels[:3, 3]
    walls = []
    for axis, is_last in product(range(3), (False, True)):
        end = volume.shape[axis] - 0.5 if is_last else -0.5
        at_end = voxels[np.abs(voxels[:, axis] - end) <= 1]
        others = [other for other in range(3) if other != axis]
        if len(at_end) < _FEWEST or (sides := np.ptp(at_end[:, others], axis=0)).min() < 1:
            continue
        to_wall = np.zeros((4, 4))
        to_wall[[0, 1], others] = 1 / sides
        to_wall[:2, 3] = -at_end[:, others].min(axis=0) / sides
        to_wall[2, axis] = 1.0 if is_last else -1.0
        to_wall[2, 3] = -to_wall[2, axis] * end
        to_wall[3, 3] = 1.0
        walls.append(to_wall @ to_voxels)
    return tuple(walls)


def is_behind_walls(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Whether points of the world, (..., 3) mm, lie straight behind a wall of `Scene.end_walls`, (...) bool."""
    behind = np.zeros(points.shape[:-1], bool)
    for wall in scene.end_walls:
        x, y, z = np.moveaxis(points @ wall[:3, :3].T + wall[:3, 3], -1, 0)
        behind |= (z > 0) & (x >= 0) & (x <= 1) & (y >= 0) & (y <= 1)
    return behind
