"""Triangles of a scene's structures, ready to be hit."""

import weakref
from collections.abc import Sequence
from copy import copy
from typing import NamedTuple, Self

import numpy as np

from ablate.anatomy import Structure
from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.surfaces import embree
from ablate.ultrasound.surfaces.embree import asked_ray, at, closest_of

_TRIANGLES = _INDICES = 0  # rtcore.h
_VERTICES = 1
_UINT3, _FLOAT3 = 0x5003, 0x9003
_ROBUST, _FILTER_IN_ARGUMENTS = 4, 8


class Hits(NamedTuple):
    """Closest hits of n rays, as in `Hit`."""

    distance_mm: np.ndarray  # (n,) float32
    structure: np.ndarray  # (n,) int32
    triangle: np.ndarray  # (n,) int32
    normal: np.ndarray  # (n, 3) float32


class Geometry:
    """Triangles of some structures, possibly none, ready to be hit; Embree works in float32.

    `bounds_mm`, (2, 3), are those of the whole scene, so that what is left out of it moves nothing. `origin_mm`, (3,),
    is subtracted from every vertex, so that far-away worlds keep their precision. `extent_mm` is the largest distance
    that rays go; with the scene's own it sets `step_mm`, how far a ray is put beyond a surface that it has crossed: a
    few times float32's spacing. With a smaller one, a grazing ray would meet a surface twice; with a larger one, it
    would jump over the second side of a corner that it clips. Compiled code hands `address` to `closest_of`, `all_of`.
    """

    def __init__(
        self, structures: Sequence[Structure], bounds_mm: np.ndarray, origin_mm: np.ndarray, extent_mm: float
    ) -> None:
        self.structures = len(structures)
        device = embree.library.rtcNewDevice(None)
        scene = embree.library.rtcNewScene(device)
        embree.library.rtcSetSceneFlags(scene, _ROBUST | _FILTER_IN_ARGUMENTS)
        self._kept: list[object] = []  # Embree reads the arrays themselves
        for mesh in (structure.mesh for structure in structures):
            places = np.zeros((len(mesh.vertices) + 1, 3), np.float32)  # Embree reads 4 bytes beyond the last vertex
            places[:-1] = np.asarray(mesh.vertices, np.float64) - origin_mm
            corners = np.ascontiguousarray(mesh.faces, np.uint32)
            self._kept.append((places, corners))
            triangles = embree.library.rtcNewGeometry(device, _TRIANGLES)
            for kind, form, values, count in (
                (_VERTICES, _FLOAT3, places, len(places) - 1),
                (_INDICES, _UINT3, corners, len(corners)),
            ):
                embree.library.rtcSetSharedGeometryBuffer(triangles, kind, 0, form, values.ctypes.data, 0, 12, count)
            embree.library.rtcCommitGeometry(triangles)
            embree.library.rtcAttachGeometry(scene, triangles)
            embree.library.rtcReleaseGeometry(triangles)
        weakref.finalize(self, embree.library.rtcReleaseDevice, device)  # the last one first
        embree.library.rtcCommitScene(scene)
        weakref.finalize(self, embree.library.rtcReleaseScene, scene)
        self.address = int(scene)
        self._centre_mm = np.mean(bounds_mm, axis=0) - origin_mm
        self._radius_mm = float(np.linalg.norm(bounds_mm[1] - bounds_mm[0])) / 2
        self.step_mm = self._step_for(extent_mm)

    def _step_for(self, extent_mm: float) -> float:
        return 2e-7 * max(2 * self._radius_mm, extent_mm)

    def reaching(self, extent_mm: float) -> Self:
        """The same triangles for rays of another `extent_mm`; Embree does not sort them again."""
        other = copy(self)
        other._kept = [self]  # which gives the triangles back when it goes
        other.step_mm = self._step_for(extent_mm)
        return other

    def closest(self, origins: np.ndarray, directions: np.ndarray, reach_mm: np.ndarray) -> Hits:
        """The first surface within `reach_mm`, (n,), of rays: origins and unit directions, (n, 3), all float32.

        Origins are relative to the geometry's origin.
        """
        return _closest_of_all(self.address, origins, directions, reach_mm)

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
def _closest_of_all(address: int, origins: np.ndarray, directions: np.ndarray, reach_mm: np.ndarray) -> Hits:
    n = len(origins)
    hits = Hits(np.empty(n, np.float32), np.empty(n, np.int32), np.empty(n, np.int32), np.empty((n, 3), np.float32))
    asked = asked_ray()
    for i in range(n):
        hit = closest_of(address, asked, at(origins, i), at(directions, i), reach_mm[i])
        hits.distance_mm[i], hits.structure[i], hits.triangle[i] = hit.distance_mm, hit.structure, hit.triangle
        hits.normal[i, 0], hits.normal[i, 1], hits.normal[i, 2] = hit.normal
    return hits
