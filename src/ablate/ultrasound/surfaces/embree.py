"""Closest hits of rays with a scene's triangles, by the Embree that embreex brings along.

embreex takes and returns whole arrays. What a ray does at a surface is compiled, and asking Embree itself from there,
one ray at a time, saves the arrays in between, and the way through Python at every bounce.
"""

import ctypes
import os
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding
import numpy as np
from embreex import rtcore_scene
from numba import cfunc, types
from numba.core.types import ExternalFunction

from ablate.ultrasound.compiled import Vector, compiled

_ASK_FILTER = 2  # rtcore.h
#: The version of Embree whose structs are written here; another one may have other fields.
MAJOR_VERSION = 4
_VERSION_MAJOR = 1  # RTC_DEVICE_PROPERTY_VERSION_MAJOR
_RAY = ("org_x", "org_y", "org_z", "tnear", "dir_x", "dir_y", "dir_z", "time", "tfar", "mask", "id", "flags")
_HIT = ("Ng_x", "Ng_y", "Ng_z", "u", "v", "primID", "geomID", "instID")
#: The fields of RTCRayHit (rtcore_ray.h) in their order, of four bytes each.
RAY_HIT = (*_RAY, *_HIT)
_FLOATS = 24  # those of RTCRayHit and what may follow: it is aligned to 16 bytes
_TNEAR = RAY_HIT.index("tnear")
_DIRECTION = RAY_HIT.index("dir_x")
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
_COHERENT = 1 << 16  # rtcore.h: the rays of a packet go nearly the same way
PACKET = 16  # rays of a packet
_PACKET_FIELDS = len(RAY_HIT) + 1  # instPrimID follows
_NATIVE_PACKET = 34  # RTC_DEVICE_PROPERTY_NATIVE_RAY16_SUPPORTED
_POINTER, _WORD, _SIZE = ctypes.c_void_p, ctypes.c_uint, ctypes.c_size_t
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "rtcNewDevice": (_POINTER, (ctypes.c_char_p,)),
    "rtcGetDeviceProperty": (ctypes.c_ssize_t, (_POINTER, ctypes.c_int)),
    "rtcNewScene": (_POINTER, (_POINTER,)),
    "rtcNewGeometry": (_POINTER, (_POINTER, ctypes.c_int)),
    "rtcSetSceneFlags": (None, (_POINTER, ctypes.c_int)),
    "rtcSetSharedGeometryBuffer": (None, (_POINTER, ctypes.c_int, _WORD, ctypes.c_int, _POINTER, _SIZE, _SIZE, _SIZE)),
    "rtcIntersect16": (None, (_POINTER, _POINTER, _POINTER, _POINTER)),
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
    major = _property_of(library, _VERSION_MAJOR)
    if major != MAJOR_VERSION:
        raise ImportError(f"embreex brings Embree {major}: allowed is embreex>=4,<5")
    for name in ("rtcIntersect1", "rtcIntersect16"):
        llvmlite.binding.add_symbol(name, ctypes.cast(getattr(library, name), _POINTER).value)
    return library


def _property_of(library: ctypes.CDLL, number: int) -> int:
    """A property of Embree on this processor."""
    device = library.rtcNewDevice(None)
    value = int(library.rtcGetDeviceProperty(device, number))
    library.rtcReleaseDevice(device)
    return value


#: Embree's own functions.
library = _loaded()
_intersect_one: Any = ExternalFunction("rtcIntersect1", types.void(types.intp, types.intp, types.intp))
_intersect_packet: Any = ExternalFunction("rtcIntersect16", types.void(types.intp, types.intp, types.intp, types.intp))
#: Whether the processor has vectors of 16 numbers; with shorter ones a packet takes longer than its rays.
HAS_PACKETS = bool(_property_of(library, _NATIVE_PACKET))


Asked = tuple[np.ndarray, np.ndarray, int]  # see `asked_ray`
Packet = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # see `asked_packet`
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
    asked = _aligned(_FLOATS)
    return asked, asked.view(np.uint32), asked.ctypes.data


@compiled
def _aligned(count: int) -> np.ndarray:
    """Zeros that begin at a multiple of 64 bytes, (count,) float32."""
    room = np.zeros(count + 16, np.float32)
    past = (room.ctypes.data & 63) // 4
    return room[16 - past : 16 - past + count] if past else room[:count]


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
    """The first surface that a ray meets.

    Parameters
    ----------
    address : int
        That of the geometry.
    asked : Asked
        Room for the question, from `asked_ray`; one thread's own.
    origin, direction : tuple of three float
        mm in the geometry's coordinates, and a unit vector; they are rounded to float32.
    reach_mm : float
        How far from the origin a surface counts.
    """
    _ask(asked, origin, direction, reach_mm)
    _intersect_one(address, asked[2], 0)
    numbers, words, _ = asked
    normal = float(numbers[_NORMAL]), float(numbers[_NORMAL + 1]), float(numbers[_NORMAL + 2])
    return Hit(float(numbers[_TFAR]), np.int32(words[_STRUCTURE]), np.int32(words[_TRIANGLE]), normal)


@compiled
def asked_packet() -> Packet:
    """Room for a packet of rays and hits, RTCRayHit16: its fields, (fields, PACKET) float32, the same in uint32.

    And which of them count, (PACKET,) int32; RTCIntersectArguments, (5,) int64.
    """
    fields = _aligned(_PACKET_FIELDS * PACKET).reshape(_PACKET_FIELDS, PACKET)
    arguments = np.zeros(5, np.int64)
    arguments[0] = _COHERENT - (1 << 32)  # all features
    return fields, fields.view(np.uint32), _aligned(PACKET).view(np.int32), arguments


@compiled
def ask_together(address: int, packet: Packet, rays: np.ndarray, first: int, count: int) -> None:
    """Ask for the closest hits of up to PACKET rays that go nearly the same way; each is the same as `closest_of`.

    Parameters
    ----------
    address : int
        That of the geometry.
    packet : Packet
        Room for the question and the answers, which `hit_of` reads.
    rays : (n,) structured
        Rays with `origin`, `direction` and `reach_mm`.
    first, count : int
        Which of them.
    """
    fields, words, counts, arguments = packet
    fields[_TNEAR], words[_MASK] = 0.0, _NONE
    words[_TRIANGLE], words[_STRUCTURE], words[_INSTANCE] = _NONE, _NONE, _NONE
    for lane in range(PACKET):
        counts[lane] = -1 if lane < count else 0
    for lane in range(count):
        ray = rays[first + lane]
        for axis in range(3):
            fields[axis, lane], fields[_DIRECTION + axis, lane] = ray.origin[axis], ray.direction[axis]
        fields[_TFAR, lane] = max(ray.reach_mm, np.float32(0))
    _intersect_packet(counts.ctypes.data, address, fields.ctypes.data, arguments.ctypes.data)


@compiled
def hit_of(packet: Packet, lane: int) -> Hit:
    """The answer for one of a packet's rays."""
    fields, words, _, _ = packet
    normal = float(fields[_NORMAL, lane]), float(fields[_NORMAL + 1, lane]), float(fields[_NORMAL + 2, lane])
    structure, triangle = np.int32(words[_STRUCTURE, lane]), np.int32(words[_TRIANGLE, lane])
    return Hit(float(fields[_TFAR, lane]), structure, triangle, normal)


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
    """All surfaces that a line meets.

    Parameters
    ----------
    address : int
        That of the geometry.
    asked : Asked
        Room for the question, from `asked_ray`; one thread's own.
    line : Line
        Room for the answer, from `asked_line`.
    origin, direction : tuple of three float
        mm in the geometry's coordinates, and a unit vector; they are rounded to float32.
    reach_mm : float
        Length of the line.

    Returns
    -------
    int
        How many there are.
    Line
        `line`, or a larger one if need be, in which they lie for `surfaces_of`.
    """
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
