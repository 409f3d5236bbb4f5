"""The fluid that is left in the uterus: how far every point of it is from wall, placenta and fetus."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from ablate.anatomy.fetal.mother import UTERUS_CENTER, UTERUS_RADII, cavity
from ablate.anatomy.fetal.placenta import placenta_field

PITCH_MM = 4.0


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """Clearance on a grid of spacing `PITCH_MM`: about the distance to the nearest surface."""

    first: np.ndarray  # (3,): world position of the first grid point, mm
    clearance: np.ndarray  # (i, j, k), mm; negative where there is no fluid

    def at(self, points: np.ndarray) -> np.ndarray:
        """Clearance at world points (..., 3), interpolated; (...) mm."""
        index = np.moveaxis((points - self.first) / PITCH_MM, -1, 0)
        return map_coordinates(self.clearance, index, order=1, mode="nearest")

    @property
    def points(self) -> np.ndarray:
        """World positions of the grid, (i, j, k, 3) mm."""
        return self.first + PITCH_MM * np.moveaxis(np.indices(self.clearance.shape), 0, -1)

    def without(self, balls: np.ndarray) -> FreeSpace:
        """The space that balls, (n, 4) centre and radius, leave."""
        points = self.points.reshape(-1, 3).astype(np.float32)
        clearance = self.clearance.reshape(-1).copy()
        for x, y, z, radius in balls.astype(np.float32):
            distance = np.sqrt(((points - (x, y, z)) ** 2).sum(axis=1)) - radius
            np.minimum(clearance, distance, out=clearance)
        return replace(self, clearance=clearance.reshape(self.clearance.shape))


def uterine_space(seed: int, towards: np.ndarray) -> FreeSpace:
    """The space between wall and placenta; arguments as for `placenta_field`."""
    reach = np.array(UTERUS_RADII) + PITCH_MM
    low = np.array(UTERUS_CENTER) - reach
    shape = np.ceil(2.0 * reach / PITCH_MM).astype(int) + 1
    x, y, z = np.meshgrid(*(low[i] + PITCH_MM * np.arange(shape[i]) for i in range(3)), indexing="ij", sparse=True)
    field = np.minimum(-cavity(seed)(x, y, z), placenta_field(seed, towards)(x, y, z)).astype(np.float32)
    space = FreeSpace(low, field)
    corners, faces, _, _ = marching_cubes(field, 0.0)
    surface = low + PITCH_MM * np.concatenate([corners, corners[faces].mean(axis=1)])
    free = np.flatnonzero(field > 0.0)
    clearance = field.ravel().copy()  # the field is a distance near the surface only
    distance = cKDTree(surface).query(space.points.reshape(-1, 3)[free])[0]
    clearance[free] = np.minimum(clearance[free], distance)
    return replace(space, clearance=clearance.reshape(field.shape))
