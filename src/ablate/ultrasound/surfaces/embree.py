"""Closest hits of rays with a scene's triangles, by Embree."""

from collections.abc import Sequence
from copy import copy
from typing import NamedTuple, Self

import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene

from ablate.anatomy import Structure
from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.surfaces.embree_library import Triangles, asked_ray, available, closest_of, normal_in


class Hits(NamedTuple):
    """Closest hits of n rays; a tuple, so that compiled code can take it."""

    distance_mm: np.ndarray  # (n,) float32
    structure: np.ndarray  # (n,) int32, -1 where nothing was hit
    triangle: np.ndarray  # (n,) int32
    normal: np.ndarray  # (n, 3) float32, not of unit length; its sign follows the mesh's winding and means nothing


class Geometry:
    """Triangles of some structures, possibly none, ready to be hit; Embree works in float32.

    `bounds_mm`, (2, 3), are those of the whole scene, so that what is left out of it moves nothing. `origin_mm`, (3,),
    is subtracted from every vertex, so that far-away worlds keep their precision. `extent_mm` is the largest distance
    that rays go; with the scene's own it sets `step_mm`, how far a ray is put beyond a surface that it has crossed: a
    few times float32's spacing. With a smaller one, a grazing ray would meet a surface twice; with a larger one, it
    would jump over the second side of a corner that it clips.
    """

    def __init__(
        self, structures: Sequence[Structure], bounds_mm: np.ndarray, origin_mm: np.ndarray, extent_mm: float
    ) -> None:
        self.structures = len(structures)
        meshes = [(np.asarray(s.mesh.vertices, np.float64) - origin_mm, s.mesh.faces) for s in structures]
        self._triangles = Triangles(meshes) if meshes and available else None
        self._scene = EmbreeScene() if meshes and not available else None
        self._meshes = []  # keeps the buffers that embreex reads
        if self._scene is not None:
            for vertices, faces in meshes:
                corners = np.ascontiguousarray(faces, np.int32)
                self._meshes.append(TriangleMesh(self._scene, vertices.astype(np.float32), corners))
        self._centre_mm = np.mean(bounds_mm, axis=0) - origin_mm
        self._radius_mm = float(np.linalg.norm(bounds_mm[1] - bounds_mm[0])) / 2
        self.step_mm = self._step_for(extent_mm)

    def _step_for(self, extent_mm: float) -> float:
        return 2e-7 * max(2 * self._radius_mm, extent_mm)

    def reaching(self, extent_mm: float) -> Self:
        """The same triangles for rays of another `extent_mm`; Embree does not sort them again."""
        other = copy(self)
        other.step_mm = self._step_for(extent_mm)
        return other

    def closest(self, origins: np.ndarray, directions: np.ndarray, reach_mm: np.ndarray) -> Hits:
        """The first surface within `reach_mm`, (n,), of rays: origins and unit directions, (n, 3), all float32.

        Origins are relative to the geometry's origin.
        """
        n = len(origins)
        if self._triangles is not None:
            hits = empty_hits(n)
            _closest_of_all(self._triangles.address, origins, directions, reach_mm, hits)
            return hits
        if self._scene is None or n == 0:
            nothing = np.full(n, -1, np.int32)
            return Hits(reach_mm, nothing, nothing, np.zeros((n, 3), np.float32))
        found = self._scene.run(origins, directions, dists=np.maximum(reach_mm, 0), query="INTERSECT", output=True)
        return Hits(found["tfar"], found["geomID"], found["primID"], found["Ng"])

    @property
    def address(self) -> int:
        """What compiled code hands to `closest_of`; 0 where it cannot ask Embree, or there is nothing to hit."""
        return 0 if self._triangles is None else self._triangles.address

    def through(self, points: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far back and how far ahead along lines everything ends, twice (n,) float64 in mm, at least 0.

        From points along unit directions, both (n, 3), to outside the scene's bounding sphere; 0 where a side never
        meets it.
        """
        from_centre = points - self._centre_mm
        towards = (from_centre * directions).sum(axis=-1)
        off_axis = (from_centre**2).sum(axis=-1) - towards**2
        chord = np.sqrt(np.maximum((1.01 * self._radius_mm) ** 2 - off_axis, 0.0))
        meets = chord > 0
        back, ahead = towards + chord + self.step_mm, chord - towards + self.step_mm
        return np.where(meets, np.maximum(back, 0), 0.0), np.where(meets, np.maximum(ahead, 0), 0.0)


@compiled
def empty_hits(n: int) -> Hits:
    """Room for the hits of n rays."""
    return Hits(np.empty(n, np.float32), np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 3), np.float32))


@compiled
def _closest_of_all(
    address: int, origins: np.ndarray, directions: np.ndarray, reach_mm: np.ndarray, hits: Hits
) -> None:
    asked = asked_ray()
    for i in range(len(origins)):
        reach = max(reach_mm[i], np.float32(0))
        hits.distance_mm[i], hits.structure[i], hits.triangle[i] = closest_of(
            address, asked, origins[i], directions[i], reach
        )
        hits.normal[i] = normal_in(asked)
