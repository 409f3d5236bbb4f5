"""The Embree that embreex brings along, called without Python: compiled code asks for one ray at a time.

embreex takes and returns whole arrays. What a ray does at a surface is compiled, too, and asking from there saves the
arrays in between, and the way through Python at every bounce. Where the library is not found, `available` is False and
embreex is asked.
"""

import ctypes
import weakref
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import embreex
import llvmlite.binding
import numpy as np
from numba import types
from numba.core.types import ExternalFunction

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
