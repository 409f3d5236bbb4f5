"""Embree asked for eight rays at once, against one at a time as the simulator asks it: microseconds a ray, and hits.

python benchmarks/packets.py

The rays are those of frames of the built-in abdomen at the paper's size, bounce by bounce, in the simulator's order.
One thread; the two ways take turns; every ray is checked for the same hit.
"""

import ctypes
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import llvmlite.binding
import numpy as np
import torch
from numba import njit, types
from numba.core.types import ExternalFunction

from ablate.anatomy import fetal_abdomen, fetal_sites
from ablate.dataset import probe_poses
from ablate.tracking import hardware
from ablate.ultrasound import Simulator
from ablate.ultrasound.surfaces import embree
from yardstick import Yardstick

SIDE = 8
POSES, TURNS = 6, 3
_SYMBOL = "rtcIntersect8"
# First places of the eight values in RTCRayHit8, in rows of eight.
_ORIGIN, _NEAR, _DIRECTION, _TIME, _FAR, _MASK, _NORMAL, _TRIANGLE, _STRUCTURE, _ROWS = 0, 3, 4, 7, 8, 9, 12, 17, 18, 24
_NONE = np.uint32(0xFFFFFFFF)
_intersect_eight: Any = ExternalFunction(_SYMBOL, types.void(types.intp, types.intp, types.intp, types.intp))


@njit(nogil=True, error_model="numpy")
def eight_at_once(
    address: int, origins: np.ndarray, directions: np.ndarray, reach_mm: np.ndarray, hits: embree.Hits
) -> None:
    """What `Geometry.closest` does, by packets."""
    room = np.zeros(_ROWS * SIDE + 16, np.float32)
    past = (room.ctypes.data & 63) // 4
    flat = room[16 - past : 16 - past + _ROWS * SIDE] if past else room[: _ROWS * SIDE]
    rows, words = flat.reshape(_ROWS, SIDE), flat.view(np.uint32).reshape(_ROWS, SIDE)
    valid = np.empty(SIDE, np.int32)
    for begin in range(0, len(origins), SIDE):
        count = min(SIDE, len(origins) - begin)
        for k in range(SIDE):
            ray = begin + min(k, count - 1)
            for axis in range(3):
                rows[_ORIGIN + axis, k], rows[_DIRECTION + axis, k] = origins[ray, axis], directions[ray, axis]
            rows[_NEAR, k] = rows[_TIME, k] = np.float32(0)
            rows[_FAR, k] = max(reach_mm[ray], np.float32(0))
            words[_MASK, k], words[_MASK + 1, k], words[_MASK + 2, k] = _NONE, np.uint32(0), np.uint32(0)
            words[_TRIANGLE, k] = words[_STRUCTURE, k] = words[_STRUCTURE + 1, k] = _NONE
            valid[k] = -1 if k < count else 0
        _intersect_eight(valid.ctypes.data, address, flat.ctypes.data, 0)
        for k in range(count):
            hits.distance_mm[begin + k] = rows[_FAR, k]
            hits.structure[begin + k], hits.triangle[begin + k] = np.int32(words[_STRUCTURE, k]), words[_TRIANGLE, k]
            for axis in range(3):
                hits.normal[begin + k, axis] = rows[_NORMAL + axis, k]


@contextmanager
def recorded() -> Iterator[list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """The rays of every question to Embree while it is asked by arrays."""
    questions: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    asked, address = embree.Geometry.closest, embree.Geometry.address

    def closest(self: embree.Geometry, *rays: np.ndarray) -> embree.Hits:
        questions.append((rays[0].copy(), rays[1].copy(), np.array(rays[2])))
        return asked(self, *rays)

    embree.Geometry.closest = closest  # type: ignore[method-assign, assignment]
    embree.Geometry.address = property(lambda self: 0)  # type: ignore[method-assign, assignment]  # noqa: ARG005
    try:
        yield questions
    finally:
        embree.Geometry.closest = asked  # type: ignore[method-assign]
        embree.Geometry.address = address  # type: ignore[method-assign]


def main() -> None:
    """Print the table."""
    library = embree._library
    if library is None or not hasattr(library, _SYMBOL):
        raise SystemExit("the Embree beside embreex was not found, or has no packets")
    llvmlite.binding.add_symbol(_SYMBOL, ctypes.cast(getattr(library, _SYMBOL), ctypes.c_void_p).value)
    torch.set_num_threads(1)
    scene = fetal_abdomen()
    simulator = Simulator(scene)
    placed = probe_poses(scene, fetal_sites(), 8)
    with recorded() as questions:
        for number in np.linspace(0, len(placed) - 1, POSES).astype(int):
            simulator.image(placed[number].probe_to_world)
    address = simulator._geometry.address
    seconds, different, fixed = np.zeros((TURNS + 1, 2)), 0, Yardstick()
    for turn in seconds:
        fixed.tick()
        for rays in questions:
            found = embree.empty_hits(len(rays[0])), embree.empty_hits(len(rays[0]))
            for way, (ask, hits) in enumerate(zip((embree._closest_of_all, eight_at_once), found, strict=True)):
                start = time.perf_counter()
                ask(address, *rays, hits)
                turn[way] += time.perf_counter() - start
            hit = found[0].structure >= 0
            same = [np.array_equal(one[hit], other[hit]) for one, other in zip(*found, strict=True)]
            different += not (all(same) and np.array_equal(*(hits.structure for hits in found)))
    count = sum(len(rays[0]) for rays in questions)
    one, eight = 1e6 * np.median(seconds[1:], axis=0) / count
    print(f"{hardware()}; {count / POSES:,.0f} rays a frame, {POSES} frames, medians of {TURNS} turns.\n")
    print("| Embree is asked for | us a ray | ms a frame |\n| --- | --- | --- |")
    for name, each in (("one ray", one), ("eight rays", eight)):
        print(f"| {name} | {each:.3f} | {1e-3 * each * count / POSES:.0f} |")
    print(f"\n{fixed.line()}")
    print(f"\nQuestions with another hit, distance or normal: {different} of {len(questions) * (TURNS + 1)}.")


if __name__ == "__main__":
    main()
