"""Straight rays through every surface: what their samples hold, and where they end."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.embree import Geometry, Hits
from ablate.ultrasound.ownership import next_step, nowhere, owner, toggle
from ablate.ultrasound.threads import in_parts

_ROWS_OF_A_PART = 256


@dataclass(frozen=True)
class Samples:
    """Where along a line its samples lie, and what each holds.

    Attributes
    ----------
    first_mm, spacing_mm : float
        Of the samples, as displayed.
    count : int
    value_of_owner : (structures + 1,) uint8
    stretch_of_owner : (structures + 1,) float32 or None
        Displayed length over geometric length; None where they are equal.
    """

    first_mm: float
    spacing_mm: float
    count: int
    value_of_owner: np.ndarray
    stretch_of_owner: np.ndarray | None = None

    def empty(self, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Room for the values, and for where the displayed points lie."""
        stretched = 0 if self.stretch_of_owner is None else self.count
        return np.empty((rows, self.count), np.uint8), np.empty((rows, stretched), np.float32)


class Walkers(NamedTuple):
    """Straight rays under way through every surface, one row a ray.

    Attributes
    ----------
    row : (n,) int32
        Which line this is.
    origin, direction : (n, 3) float32, mm
        From where the next surface is looked for.
    distance_mm, shown_mm : (n,) float64
        Of the last surface from the line's start: as it is, negative before the start, and as displayed.
    reach_mm : (n,) float32
        How far there is still to go.
    step_mm : (n,) float32
        From the last surface to `origin`.
    structure, triangle : (n,) int32
        Of the last surface.
    filled : (n,) int32
        Samples that already have their value.
    """

    row: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    distance_mm: np.ndarray
    shown_mm: np.ndarray
    reach_mm: np.ndarray
    step_mm: np.ndarray
    structure: np.ndarray
    triangle: np.ndarray
    filled: np.ndarray


def walk(
    geometry: Geometry,
    origins: np.ndarray,
    directions: np.ndarray,
    length_mm: np.ndarray,
    inside: np.ndarray,
    samples: Samples | None = None,
    before_mm: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Follow straight rays through every surface, by re-stepping from each hit.

    Parameters
    ----------
    geometry : Geometry
    origins, directions : (n, 3) float, mm
    length_mm : (n,) float
    inside : (n, words) uint32
        The sets at the origins.
    samples : Samples, optional
        None where only the ends matter.
    before_mm : (n,) float, optional
        How far in front of its line's start each ray begins.

    Returns
    -------
    inside : (n, words) uint32
        The sets at the ends.
    values : (n, samples) uint8
        Of each sample's owner.
    ranges_mm : (n, samples) float32
        How far along its line the point lies that each sample displays; (n, 0) where nothing is stretched.
    """
    owners = geometry.structures + 1
    samples = samples or Samples(0.0, 1.0, 0, np.zeros(owners, np.uint8))
    stretch = samples.stretch_of_owner
    stretch = np.ones(owners, np.float32) if stretch is None else stretch
    places = samples.first_mm, samples.spacing_mm, samples.value_of_owner, stretch
    before = np.zeros(len(origins)) if before_mm is None else before_mm
    inside, (values, ranges_mm) = inside.copy(), samples.empty(len(origins))

    def part(begin: int, end: int) -> None:
        n = end - begin
        walkers = Walkers(
            row=np.arange(begin, end, dtype=np.int32),
            origin=np.array(origins[begin:end], np.float32),
            direction=np.array(directions[begin:end], np.float32),
            distance_mm=-before[begin:end].astype(np.float64),
            shown_mm=np.zeros(n),
            reach_mm=length_mm[begin:end].astype(np.float32),
            step_mm=np.zeros(n, np.float32),
            structure=np.full(n, -1, np.int32),
            triangle=np.full(n, -1, np.int32),
            filled=np.zeros(n, np.int32),
        )
        while n:
            hits = geometry.closest(walkers.origin[:n], walkers.direction[:n], walkers.reach_mm[:n])
            n = _cross(walkers, hits, geometry.step_mm, places, inside, values, ranges_mm)

    in_parts(part, len(origins), _ROWS_OF_A_PART)
    return inside, values, ranges_mm


@compiled
def _cross(
    walkers: Walkers,
    hits: Hits,
    least_step_mm: float,
    places: tuple[float, float, np.ndarray, np.ndarray],
    inside: np.ndarray,
    values: np.ndarray,
    ranges_mm: np.ndarray,
) -> int:
    """Move walkers to the surfaces that they hit; those that go on are moved up and counted."""
    first_mm, spacing_mm, value_of_owner, stretch_of_owner = places
    samples, stretched = values.shape[1], ranges_mm.shape[1] > 0
    left = 0
    for i in range(len(hits.structure)):
        row, last, shown = walkers.row[i], walkers.distance_mm[i], walkers.shown_mm[i]
        here = owner(inside[row])
        ends = hits.structure[i] < 0
        distance, reached, end = last, shown, samples
        if not ends:
            distance = last + walkers.step_mm[i] + hits.distance_mm[i]
            reached = shown + max(distance - max(last, 0.0), 0.0) * stretch_of_owner[here]
            end = min(max(math.ceil((reached - first_mm) / spacing_mm), 0), samples)
        for k in range(walkers.filled[i], end):
            values[row, k] = value_of_owner[here]
            if stretched:
                beyond = (first_mm + k * spacing_mm - shown) / stretch_of_owner[here]
                ranges_mm[row, k] = max(last, 0.0) + beyond
        if ends:
            continue
        fresh = hits.structure[i] != walkers.structure[i] or hits.triangle[i] != walkers.triangle[i]
        if fresh:  # a plane is met only once
            toggle(inside[row], hits.structure[i])
        away = fresh and hits.distance_mm[i] > walkers.step_mm[i]
        step = next_step(walkers.step_mm[i], away, least_step_mm)
        ahead = hits.distance_mm[i] + step
        for axis in range(3):
            direction = walkers.direction[i, axis]
            walkers.origin[left, axis] = walkers.origin[i, axis] + ahead * direction
            walkers.direction[left, axis] = direction
        walkers.row[left] = row
        walkers.distance_mm[left], walkers.shown_mm[left] = distance, reached
        walkers.reach_mm[left] = walkers.reach_mm[i] - ahead
        walkers.step_mm[left] = step
        walkers.structure[left], walkers.triangle[left] = hits.structure[i], hits.triangle[i]
        walkers.filled[left] = max(walkers.filled[i], end)
        left += 1
    return left


def inside_at(geometry: Geometry, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """The sets that points are inside of, by rays that come from outside everything.

    Parameters
    ----------
    geometry : Geometry
    points : (n, 3) float, mm
        Relative to the geometry's origin.
    directions : (n, 3) float
        In which they are reached; the less it grazes surfaces the better.

    Returns
    -------
    (n, words) uint32
    """
    back, _ = geometry.through(points, directions)
    outside = nowhere(len(points), geometry.structures)
    return walk(geometry, points - back[:, None] * directions, directions, back, outside)[0]
