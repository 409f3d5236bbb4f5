"""Who owns a point: structures are toggled at each crossing, and the last of those one is inside owns it.

Winding and normals play no part, so meshes may be inside out. The set that a ray is inside of is a row of 32-bit
words, bit i % 32 of word i // 32 for structure i; an owner is i + 1, and 0 is the background.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ablate.ultrasound.embree import Geometry

_ATTEMPTS = 4
_ASIDE_STEPS = 300


@dataclass(frozen=True)
class Crossings:
    """Where rays change owner, in the order of the walk: within a row, distance never falls.

    Every row has a first entry at distance 0: the owner of its start.
    """

    row: np.ndarray
    distance_mm: np.ndarray
    owner: np.ndarray


def nowhere(rows: int, structures: int) -> np.ndarray:
    """The empty sets of `rows` rays outside everything, (rows, words) uint32."""
    return np.zeros((rows, max(1, -(-structures // 32))), np.uint32)


def toggle(inside: np.ndarray, structure: np.ndarray) -> np.ndarray:
    """The sets after crossing one surface each, (n, words) uint32."""
    bit = np.left_shift(np.uint32(1), (structure & 31).astype(np.uint32))
    if inside.shape[1] == 1:
        return inside ^ bit[:, None]
    after = inside.copy()
    after[np.arange(len(inside)), structure >> 5] ^= bit
    return after


def owner(inside: np.ndarray) -> np.ndarray:
    """1 + the last structure of each set, 0 where it is empty, (n,) int32."""
    last = np.zeros(len(inside), np.int32)
    for word in range(inside.shape[1]):
        bits = inside[:, word]
        highest = np.frexp(bits.astype(np.float64))[1]  # exact: 32 bits fit a double's fraction
        last = np.where(bits > 0, 32 * word + highest, last)
    return last.astype(np.int32, copy=False)


def next_step(step_mm: np.ndarray, fresh: np.ndarray, geometry: Geometry) -> np.ndarray:
    """How far to go beyond a surface just met, (n,) float32, mm.

    Twice as far each time that the same triangle is met again: a ray that runs along it would take it in steps
    of a tenth of a micrometre.
    """
    return np.where(fresh, np.float32(geometry.step_mm), np.maximum(2 * step_mm, np.float32(geometry.step_mm)))


def walk(
    geometry: Geometry, origins: np.ndarray, directions: np.ndarray, length_mm: np.ndarray, inside: np.ndarray
) -> Crossings:
    """Follow straight rays through every surface, by re-stepping from each hit.

    Parameters
    ----------
    geometry : Geometry
    origins, directions : (n, 3) float32, mm
    length_mm : (n,) float32
    inside : (n, words) uint32
        The sets at the origins; changed in place to those at the ends.

    Returns
    -------
    Crossings
    """
    active = np.arange(len(origins))
    distance = np.zeros(len(origins), np.float32)
    here = owner(inside)
    rows, distances, owners = [active], [distance], [here]
    triangle = np.full((2, len(origins)), -1, np.int32)
    step = np.full(len(origins), geometry.step_mm, np.float32)
    while active.size:
        hits = geometry.closest(origins, directions, length_mm - distance)
        found = np.flatnonzero(hits.structure >= 0)
        hits, active, triangle = hits.take(found), active[found], triangle[:, found]
        origins, directions, length_mm = origins[found], directions[found], length_mm[found]
        here, distance = here[found], distance[found] + hits.distance_mm
        again = (hits.structure == triangle[0]) & (hits.triangle == triangle[1])  # a plane is met only once
        crossed = np.flatnonzero(~again)
        step = next_step(step[found], ~again, geometry)
        chosen = active[crossed]
        inside[chosen] = after = toggle(inside[chosen], hits.structure[crossed])
        there = here.copy()
        there[crossed] = owner(after)
        changed = there != here
        rows.append(active[changed])
        distances.append(distance[changed])
        owners.append(there[changed])
        here, triangle = there, np.stack([hits.structure, hits.triangle])
        origins = origins + (hits.distance_mm + step)[:, None] * directions
        distance = distance + step
    return Crossings(np.concatenate(rows), np.concatenate(distances), np.concatenate(owners))


def walk_lines(geometry: Geometry, starts: np.ndarray, directions: np.ndarray, structures: int) -> Crossings:
    """Owners along lines that are followed from outside everything to outside everything.

    A line that does not end inside nothing has missed a surface: it jumped over a corner, or ran along an edge. It
    is followed again a few hundredths of a millimetre beside, so that one slip does not run down the whole line.

    Parameters
    ----------
    geometry : Geometry
    starts, directions : (n, 3) float, mm
        Where distances count from; what lies before is at distance 0.
    structures : int

    Returns
    -------
    Crossings
    """
    back, ahead = geometry.through(starts, directions)
    crossings: list[Crossings] = []
    rows = np.arange(len(starts))
    for attempt in range(_ATTEMPTS):
        aside = attempt * _ASIDE_STEPS * geometry.step_mm * np.roll(directions[rows], 1, axis=-1)
        origins = starts[rows] + aside - back[rows, None] * directions[rows]
        inside = nowhere(len(rows), structures)
        found = walk(
            geometry,
            origins.astype(np.float32),
            directions[rows].astype(np.float32),
            (back + ahead)[rows].astype(np.float32),
            inside,
        )
        failed = (inside != 0).any(axis=1) & (attempt < _ATTEMPTS - 1)
        kept = ~failed[found.row]
        row = rows[found.row[kept]]
        distance = np.maximum(found.distance_mm[kept] - back[row], 0)
        crossings.append(Crossings(row, distance, found.owner[kept]))
        rows = rows[failed]
        if not rows.size:
            break
    return Crossings(
        np.concatenate([c.row for c in crossings]),
        np.concatenate([c.distance_mm for c in crossings]),
        np.concatenate([c.owner for c in crossings]),
    )


def inside_at(geometry: Geometry, point: np.ndarray, structures: int) -> np.ndarray:
    """The set that one point is inside of, by a ray that comes from outside everything.

    Parameters
    ----------
    geometry : Geometry
    point : (3,) float, mm, relative to the geometry's origin
    structures : int

    Returns
    -------
    (1, words) uint32
    """
    direction = np.array([[0.57735026, 0.57735026, 0.57735026]])
    back, _ = geometry.through(point[None], direction)
    inside = nowhere(1, structures)
    start = point[None] - back[:, None] * direction
    walk(geometry, start.astype(np.float32), direction.astype(np.float32), back.astype(np.float32), inside)
    return inside


def carry(geometry: Geometry, inside: np.ndarray, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """The sets at other points, by straight walks from points whose sets are known.

    Parameters
    ----------
    geometry : Geometry
    inside : (n, words) uint32
        The sets at `start`.
    start, ends : (n, 3) float, mm

    Returns
    -------
    (n, words) uint32
    """
    offset = ends - start
    length = np.linalg.norm(offset, axis=-1)
    direction = offset / np.maximum(length, 1e-12)[:, None]
    inside = inside.copy()
    walk(geometry, start.astype(np.float32), direction.astype(np.float32), length.astype(np.float32), inside)
    return inside
