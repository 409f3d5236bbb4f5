"""Straight rays through every surface: what their samples hold, and which structures their ends are inside of.

Structures are toggled at each crossing, and the last of those that a point is inside of owns it. Winding and normals
play no part, so meshes may be inside out. The set that a ray is inside of is a row of 32-bit words, bit i % 32 of word
i // 32 for structure i; an owner is i + 1, and 0 is the background.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays, compiled
from ablate.ultrasound.surfaces.embree import KEEP, all_of, asked_line, asked_ray, at, surfaces_of
from ablate.ultrasound.surfaces.geometry import Geometry

_ROWS_OF_A_PART = 64
Reach = tuple[np.ndarray, np.ndarray]  # how far before and how far beyond the starts n lines go, (n,) each, mm


@compiled
def toggle(inside: np.ndarray, row: int, structure: np.int32) -> None:
    """Cross a surface: changes one of the sets, (n, words) uint32."""
    inside[row, structure >> 5] ^= np.uint32(1) << np.uint32(structure & 31)


@compiled
def owner(inside: np.ndarray, row: int) -> int:
    """1 + the last structure of one of the sets, (n, words) uint32; 0 where it is empty."""
    for word in range(inside.shape[1] - 1, -1, -1):
        if inside[row, word]:
            highest_bit = math.frexp(float(inside[row, word]))[1]  # exact: 32 bits fit a double's fraction
            return 32 * word + highest_bit
    return 0


@compiled
def owners(inside: np.ndarray) -> np.ndarray:
    """`owner` of each set of (n, words) uint32, (n,) int32."""
    owned_by = np.empty(len(inside), np.int32)
    for i in range(len(inside)):
        owned_by[i] = owner(inside, i)
    return owned_by


class Samples(NamedTuple):
    """Where the samples of a line lie, in displayed lengths, and what each holds; compiled code takes it."""

    first_mm: float
    spacing_mm: float
    number: int
    value_of_owner: np.ndarray  # (structures + 1,) uint8
    stretch_of_owner: np.ndarray = np.empty(0, np.float32)  # (structures + 1,) or (0,): displayed over geometric length


def walk(
    geometry: Geometry, starts: np.ndarray, directions: np.ndarray, reach_mm: Reach, samples: Samples | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Follow straight rays, which begin outside everything, through every surface; all are asked for at once.

    Parameters
    ----------
    geometry : Geometry
        The triangles.
    starts, directions : (n, 3) float64
        mm in the geometry's coordinates, and unit vectors.
    reach_mm : tuple of two (n,) float64
        How far before and how far beyond the starts the lines go.
    samples : Samples, optional
        What is asked of each line; without it only the ends matter.

    Returns
    -------
    inside : (n, words) uint32
        The sets at the ends.
    values : (n, samples) uint8
        The value of each sample's owner.
    ranges_mm : (n, samples) float32
        How far along its line the point lies that a sample displays; (n, 0) where nothing is stretched.
    """
    n, owners_count, (back, ahead) = len(starts), geometry.structures + 1, reach_mm
    samples = samples or Samples(0.0, 1.0, 0, np.zeros(owners_count, np.uint8))
    stretched = samples.stretch_of_owner.size > 0
    given = starts - back[:, None] * directions, directions, back + ahead
    lines = *(values.astype(np.float32, order="C") for values in given), back
    values = np.empty((n, samples.number), np.uint8)
    ranges_mm = np.empty((n, samples.number if stretched else 0), np.float32)
    inside = np.zeros((n, max(1, -(-geometry.structures // 32))), np.uint32)
    samples = samples if stretched else samples._replace(stretch_of_owner=np.ones(owners_count, np.float32))
    follow = partial(_follow, geometry.address, KEEP, geometry.step_mm, lines, samples, (inside, values, ranges_mm))
    in_parts(follow, n, _ROWS_OF_A_PART)
    return inside, values, ranges_mm


@compiled
def _follow(
    address: int, keep: int, least_step_mm: float, lines: Arrays, samples: Samples, rows: Arrays, begin: int, end: int
) -> None:
    """Fill the rows of some lines: origins, directions, lengths, and distances to their starts, all but these float32.

    `rows` are what `walk` returns. Distances are from the line's start, geometric and as they are displayed; `filled`
    samples have their value.
    """
    origins, directions, lengths_mm, before_mm = lines
    inside, values, _ = rows
    asked, line = asked_ray(), asked_line(keep)
    for row in range(begin, end):
        met, line = all_of(address, asked, line, at(origins, row), at(directions, row), lengths_mm[row])
        distances, structures = surfaces_of(line, met)
        last_mm, displayed_mm, filled = -before_mm[row], 0.0, 0
        for number in range(met):
            if again(distances, structures, number, least_step_mm):
                continue
            distance_mm = distances[number] - before_mm[row]
            reached_mm = max(distance_mm - max(last_mm, 0.0), 0.0) * samples.stretch_of_owner[owner(inside, row)]
            reached_mm += displayed_mm
            ahead = math.ceil((reached_mm - samples.first_mm) / samples.spacing_mm)
            ahead = min(max(ahead, 0), values.shape[1])
            _fill(rows, row, filled, ahead, samples, last_mm, displayed_mm)
            toggle(inside, row, structures[number])
            last_mm, displayed_mm, filled = distance_mm, reached_mm, max(filled, ahead)
        _fill(rows, row, filled, values.shape[1], samples, last_mm, displayed_mm)


@compiled
def _fill(
    rows: Arrays, row: int, begin: int, end: int, samples: Samples, surface_mm: float, displayed_mm: float
) -> None:
    """Fill some samples of a line with what it is inside of, behind a surface at two distances from its start."""
    inside, values, ranges_mm = rows
    here = owner(inside, row)
    values[row, begin:end] = samples.value_of_owner[here]
    if ranges_mm.shape[1] > 0:
        for k in range(begin, end):
            beyond_mm = samples.first_mm + k * samples.spacing_mm - displayed_mm
            ranges_mm[row, k] = max(surface_mm, 0.0) + beyond_mm / samples.stretch_of_owner[here]


@compiled
def again(distances: np.ndarray, structures: np.ndarray, number: int, least_mm: float) -> bool:
    """Whether a line has met this structure just before, as where it meets the edge between two triangles.

    Parameters
    ----------
    distances, structures : (surfaces,) float32 and int32
        What the line meets, in order.
    number : int
        Which of them is asked for.
    least_mm : float
        How near counts as just before.
    """
    before = number - 1
    while before >= 0 and distances[number] - distances[before] <= least_mm:
        if structures[before] == structures[number]:
            return True
        before -= 1
    return False


def inside_at(geometry: Geometry, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The sets that points, (n, 3) in the geometry's coordinates, are inside of, (n, words) uint32.

    They are reached from outside everything along `directions`, (n, 3); the less these graze surfaces the better.
    """
    back, _ = geometry.through(points, directions)
    return walk(geometry, points, directions, (back, np.zeros_like(back)))[0]
