"""Closest hits of rays with a scene's triangles, by the Embree that embreex brings along.

embreex takes and returns whole arrays. What a ray does at a surface is compiled, and asking Embree itself from there,
one ray at a time, saves the arrays in between, and the way through Python at every bounce.
"""

import ctypes
import os
import weakref
from collections.abc import Sequence
from copy import copy
from pathlib import Path
from typing import Any, NamedTuple, Self

import llvmlite.binding
import numpy as np
from embreex import rtcore_scene
from numba import cfunc, types
from numba.core.types import ExternalFunction

from ablate.anatomy import Structure
from ablate.ultrasound.compiled import Vector, compiled

_TRIANGLES, _INDICES, _VERTICES, _UINT3, _FLOAT3 = 0, 0, 1, 0x5003, 0x9003  # rtcore.h
_ROBUST, _FILTER_IN_ARGUMENTS, _ASK_FILTER = 4, 8, 2
#: The version of Embree whose structs are written here; another one may have other fields.
MAJOR_VERSION = 4
_VERSION_MAJOR = 1  # RTC_DEVICE_PROPERTY_VERSION_MAJOR
_RAY = ("org_x", "org_y", "org_z", "tnear", "dir_x", "dir_y", "dir_z", "time", "tfar", "mask", "id", "flags")
_HIT = ("Ng_x", "Ng_y", "Ng_z", "u", "v", "primID", "geomID", "instID")
#: The fields of RTCRayHit (rtcore_ray.h) in their order, of four bytes each.
RAY_HIT = (*_RAY, *_HIT)
_FLOATS = 24  # those of RTCRayHit and what may follow: it is aligned to 16 bytes
_TFAR = RAY_HIT.index("tfar")
_MASK = RAY_HIT.index("mask")
_ID = RAY_HIT.index("id")
_FLAGS = RAY_HIT.index("flags")
_NORMAL = RAY_HIT.index("Ng_x")
_TRIANGLE = RAY_HIT.index("primID")
_STRUCTURE = RAY_HIT.index("geomID")
_INSTANCE = RAY_HIT.index("instID")
_NONE = np.uint32(0xFFFFFFFF)
_MET, _FIRST = 4, 5  # behind a query's context: how many surfaces a line has met, and where they begin
_OF_ONE = 2  # numbers that are noted of a surface: distance and structure
_ROOM = 4096  # surfaces of a line, to begin with
_POINTER, _WORD, _SIZE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "rtcNewDevice": (_POINTER, (ctypes.c_char_p,)),
    "rtcGetDeviceProperty": (ctypes.c_ssize_t, (_POINTER, ctypes.c_int)),
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


def _loaded() -> ctypes.CDLL:
    """The library, known to compiled code; through embreex, whose module is linked with it, wherever it lies.

    Raises ImportError where it is another version of Embree, whose functions and structs are not those written here.
    """
    module = Path(rtcore_scene.__file__)
    # Windows looks for a function in one file only
    file = module if os.name != "nt" else next(module.parent.parent.glob("embreex*/**/*embree4*.dll"))
    library = ctypes.CDLL(str(file))
    try:
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(library, name)
            function.restype, function.argtypes = result, arguments
    except AttributeError as missing:
        raise ImportError(f"embreex brings a library without {name}: allowed is embreex>=4,<5") from missing
    device = library.rtcNewDevice(None)
    major = library.rtcGetDeviceProperty(device, _VERSION_MAJOR)
    library.rtcReleaseDevice(device)
    if major != MAJOR_VERSION:
        raise ImportError(f"embreex brings Embree {major}: allowed is embreex>=4,<5")
    llvmlite.binding.add_symbol("rtcIntersect1", ctypes.cast(library.rtcIntersect1, _POINTER).value)
    return library


_embree = _loaded()
_intersect_one: Any = ExternalFunction("rtcIntersect1", types.void(types.intp, types.intp, types.intp))


Asked = tuple[np.ndarray, np.ndarray, int]  # see `asked_ray`
Line = tuple[np.ndarray, np.ndarray]  # see `asked_line`


class Hit(NamedTuple):
    """Closest hit of a ray, in numbers."""

    distance_mm: float
    structure: np.int32  # -1 where nothing was hit
    triangle: np.int32
    normal: Vector  # not of unit length; its sign follows the mesh's winding and means nothing


@compiled
def asked_ray() -> Asked:
    """Room for one ray and its hit, RTCRayHit as (24,) float32, aligned; the same in uint32; its address."""
    room = np.zeros(_FLOATS + 16, np.float32)
    past = (room.ctypes.data & 63) // 4
    asked = room[16 - past : 16 - past + _FLOATS] if past else room[:_FLOATS]
    return asked, asked.view(np.uint32), asked.ctypes.data


@compiled
def _ask(asked: Asked, origin: Vector, direction: Vector, reach_mm: float) -> None:
    numbers, words, _ = asked
    numbers[0], numbers[1], numbers[2], numbers[3] = origin[0], origin[1], origin[2], 0.0
    numbers[4], numbers[5], numbers[6], numbers[7] = direction[0], direction[1], direction[2], 0.0
    numbers[_TFAR] = max(reach_mm, 0.0)
    words[_MASK], words[_ID], words[_FLAGS] = _NONE, np.uint32(0), np.uint32(0)
    words[_TRIANGLE] = words[_STRUCTURE] = words[_INSTANCE] = _NONE


@compiled
def closest_of(address: int, asked: Asked, origin: Vector, direction: Vector, reach_mm: float) -> Hit:
    """The first surface that a ray meets, of the geometry at `address`."""
    _ask(asked, origin, direction, reach_mm)
    _intersect_one(address, asked[2], 0)
    numbers, words, _ = asked
    normal = float(numbers[_NORMAL]), float(numbers[_NORMAL + 1]), float(numbers[_NORMAL + 2])
    return Hit(float(numbers[_TFAR]), np.int32(words[_STRUCTURE]), np.int32(words[_TRIANGLE]), normal)


@compiled
def at(rows: np.ndarray, row: int) -> Vector:
    """A row of (n, 3) in numbers."""
    return float(rows[row, 0]), float(rows[row, 1]), float(rows[row, 2])


@cfunc(types.void(types.CPointer(types.CPointer(types.float32))), cache=True)
def _keep(given: Any) -> None:
    """RTCFilterFunctionN for one ray: notes what is needed of a hit behind the context, and goes on."""
    valid, context, ray, hit = given[0], given[2], given[3], given[4]
    place = _FIRST + _OF_ONE * int(context[_MET])
    if place < _FIRST + _OF_ONE * int(context[_MET - 1]):
        context[place], context[place + 1] = ray[_TFAR], hit[_STRUCTURE - _NORMAL]
    context[_MET] += types.float32(1)
    valid[0] = 0.0


#: What compiled code hands to `asked_line`.
KEEP = int(_keep.address or 0)


@compiled
def asked_line(keep: int, room: int = _ROOM) -> Line:
    """RTCIntersectArguments as (4,) int64, and its context with room for so many surfaces, (n,) float32."""
    context = np.zeros(_FIRST + _OF_ONE * room, np.float32)
    context.view(np.uint32)[:2] = _NONE  # no instance
    context[_MET - 1] = room
    arguments = np.zeros(4, np.int64)
    arguments[0] = _ASK_FILTER - (1 << 32)  # all features
    arguments[1], arguments[2] = context.ctypes.data, keep
    return arguments, context


@compiled
def all_of(
    address: int, asked: Asked, line: Line, origin: Vector, direction: Vector, reach_mm: float
) -> tuple[int, Line]:
    """How many surfaces a line meets, and `line`, larger if need be, in which they lie for `surfaces_of`."""
    while True:
        arguments, context = line
        context[_MET] = 0
        _ask(asked, origin, direction, reach_mm)
        _intersect_one(address, asked[2], arguments.ctypes.data)
        met = int(context[_MET])
        if met <= int(context[_MET - 1]):
            return met, line
        line = asked_line(arguments[2], 2 * met)


@compiled
def surfaces_of(line: Line, met: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances, float32 in mm, and structures, int32, that `all_of` found, sorted; they lie in `line`."""
    noted = line[1][_FIRST : _FIRST + _OF_ONE * met].reshape(met, _OF_ONE)
    distances, structures = noted[:, 0], noted.view(np.int32)[:, 1]
    for last in range(1, met):
        distance, structure, place = distances[last], structures[last], last
        while place > 0 and (distances[place - 1], structures[place - 1]) > (distance, structure):
            distances[place], structures[place] = distances[place - 1], structures[place - 1]
            place -= 1
        distances[place], structures[place] = distance, structure
    return distances, structures


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
        device = _embree.rtcNewDevice(None)
        scene = _embree.rtcNewScene(device)
        _embree.rtcSetSceneFlags(scene, _ROBUST | _FILTER_IN_ARGUMENTS)
        self._kept: list[object] = []  # Embree reads the arrays themselves
        for mesh in (structure.mesh for structure in structures):
            places = np.zeros((len(mesh.vertices) + 1, 3), np.float32)  # Embree reads 4 bytes beyond the last vertex
            places[:-1] = np.asarray(mesh.vertices, np.float64) - origin_mm
            corners = np.ascontiguousarray(mesh.faces, np.uint32)
            self._kept.append((places, corners))
            triangles = _embree.rtcNewGeometry(device, _TRIANGLES)
            for kind, form, values, count in (
                (_VERTICES, _FLOAT3, places, len(places) - 1),
                (_INDICES, _UINT3, corners, len(corners)),
            ):
                _embree.rtcSetSharedGeometryBuffer(triangles, kind, 0, form, values.ctypes.data, 0, 12, count)
            _embree.rtcCommitGeometry(triangles)
            _embree.rtcAttachGeometry(scene, triangles)
            _embree.rtcReleaseGeometry(triangles)
        weakref.finalize(self, _embree.rtcReleaseDevice, device)  # the last one first
        _embree.rtcCommitScene(scene)
        weakref.finalize(self, _embree.rtcReleaseScene, scene)
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
