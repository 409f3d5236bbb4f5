"""Closest hits of rays with a scene's triangles, by the Embree that embreex brings along.

embreex takes and returns whole arrays. What a ray does at a surface is compiled, too, and asking from there, one ray at
a time, saves the arrays in between, and the way through Python at every bounce. Where the library is not found,
`available` is False and embreex is asked.
"""

import ctypes
import weakref
from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple, Self

import embreex
import llvmlite.binding
import numpy as np
from embreex.mesh_construction import TriangleMesh
from embreex.rtcore_scene import EmbreeScene
from numba import types
from numba.core.types import ExternalFunction

from ablate.anatomy import Structure
from ablate.ultrasound.compiled import compiled

_PLACES = ("../embreex.libs/*embree4*", ".dylibs/*embree4*", "*embree4*.dll")  # of wheels: Linux, macOS, Windows
_SYMBOL = "rtcIntersect1"
_TRIANGLES, _INDICES, _VERTICES, _UINT3, _FLOAT3, _ROBUST = 0, 0, 1, 0x5003, 0x9003, 4  # rtcore.h
_FLOATS = 24  # of RTCRayHit, which is aligned to 16 bytes
_TFAR, _MASK, _NORMAL, _TRIANGLE, _STRUCTURE, _INSTANCE = 8, 9, 12, 17, 18, 19  # places in it
_NONE = np.uint32(0xFFFFFFFF)
_POINTER, _WORD, _SIZE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "rtcNewDevice": (_POINTER, (ctypes.c_char_p,)),
    "rtcNewScene": (_POINTER, (_POINTER,)),
    "rtcNewGeometry": (_POINTER, (_POINTER, ctypes.c_int)),
    "rtcSetSceneFlags": (None, (_POINTER, ctypes.c_int)),
    "rtcSetSharedGeometryBuffer": (None, (_POINTER, ctypes.c_int, _WORD, ctypes.c_int, _POINTER, _SIZE, _SIZE, _SIZE)),
    "rtcCommitGeometry": (None, (_POINTER,)),
    "rtcAttachGeometry": (_WORD, (_POINTER, _POINTER)),
    "rtcCommitScene": (None, (_POINTER,)),
    "rtcReleaseGeometry": (None, (_POINTER,)),
    "rtcReleaseScene": (None, (_POINTER,)),
    "rtcReleaseDevice": (None, (_POINTER,)),
}


def _found() -> ctypes.CDLL | None:
    """The library with everything that is called of it, known to compiled code; None where there is none such."""
    room = Path(embreex.__file__).parent
    for file in (file for place in _PLACES for file in sorted(room.glob(place))):
        try:
            library = ctypes.CDLL(str(file))
            for name, (result, arguments) in _SIGNATURES.items():
                function = getattr(library, name)
                function.restype, function.argtypes = result, arguments
            address = ctypes.cast(getattr(library, _SYMBOL), _POINTER).value
        except (OSError, AttributeError):
            continue
        llvmlite.binding.add_symbol(_SYMBOL, address)
        return library
    return None


_library = _found()
available = _library is not None
_intersect_one: Any = ExternalFunction(_SYMBOL, types.void(types.intp, types.intp, types.intp))


class Triangles:
    """Triangle meshes, (vertices (n, 3) float, faces (m, 3) int) each, that Embree has sorted.

    `address` is what compiled code is given. Embree reads the arrays themselves, so they are kept.
    """

    def __init__(self, meshes: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        assert _library is not None
        device = _library.rtcNewDevice(None)
        scene = _library.rtcNewScene(device)
        _library.rtcSetSceneFlags(scene, _ROBUST)
        self._kept = []
        for vertices, faces in meshes:
            places = np.zeros((len(vertices) + 1, 3), np.float32)  # Embree reads 4 bytes beyond the last vertex
            places[:-1] = vertices
            corners = np.ascontiguousarray(faces, np.uint32)
            self._kept.append((places, corners))
            mesh = _library.rtcNewGeometry(device, _TRIANGLES)
            for kind, form, values, count in (
                (_VERTICES, _FLOAT3, places, len(vertices)),
                (_INDICES, _UINT3, corners, len(corners)),
            ):
                _library.rtcSetSharedGeometryBuffer(mesh, kind, 0, form, values.ctypes.data, 0, 12, count)
            _library.rtcCommitGeometry(mesh)
            _library.rtcAttachGeometry(scene, mesh)
            _library.rtcReleaseGeometry(mesh)
        _library.rtcCommitScene(scene)
        self.address = int(scene)
        weakref.finalize(self, _release, scene, device)


def _release(scene: int, device: int) -> None:
    assert _library is not None
    _library.rtcReleaseScene(scene)
    _library.rtcReleaseDevice(device)


@compiled
def asked_ray() -> np.ndarray:
    """Room for one ray and its hit, RTCRayHit as (24,) float32, aligned."""
    room = np.zeros(_FLOATS + 16, np.float32)
    past = (room.ctypes.data & 63) // 4
    return room[16 - past : 16 - past + _FLOATS] if past else room[:_FLOATS]


@compiled
def closest_of(
    address: int, asked: np.ndarray, origin: np.ndarray, direction: np.ndarray, reach_mm: float
) -> tuple[np.float32, np.int32, np.int32]:
    """Distance, structure (-1 for none) and triangle of the first surface; its normal is at `normal_in(asked)`."""
    words = asked.view(np.uint32)
    for axis in range(3):
        asked[axis], asked[4 + axis] = origin[axis], direction[axis]
    asked[3] = asked[7] = np.float32(0)
    asked[_TFAR] = reach_mm
    words[_MASK], words[10], words[11] = _NONE, np.uint32(0), np.uint32(0)
    words[_TRIANGLE] = words[_STRUCTURE] = words[_INSTANCE] = _NONE
    _intersect_one(address, asked.ctypes.data, 0)
    return asked[_TFAR], np.int32(words[_STRUCTURE]), np.int32(words[_TRIANGLE])


@compiled
def normal_in(asked: np.ndarray) -> np.ndarray:
    """The normal of what was met, (3,) float32, of any length."""
    return asked[_NORMAL : _NORMAL + 3]


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
