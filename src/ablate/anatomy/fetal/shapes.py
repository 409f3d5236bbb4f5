"""Shapes of the built-in anatomy: signed distance fields (SDF) and their meshes.

A field is a function of three broadcastable arrays x, y, z (mm) that is negative inside the shape and, near
the surface, about the distance to it in mm. Formulas after I. Quilez, "distance functions" (ellipsoid bound,
polynomial smooth minimum).
"""

from collections.abc import Callable, Sequence
from functools import reduce
from typing import Any, NamedTuple

import numpy as np
import trimesh
from skimage.measure import marching_cubes

Vector = Sequence[float] | np.ndarray
Field = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
Bounds = tuple[tuple[float, float, float], tuple[float, float, float]]
COARSE_CELLS = 28  # a side, of the grid that finds the box around a shape


def ellipsoid(center: Vector, radii: Vector, turn: np.ndarray | None = None) -> Field:
    """Ellipsoid; `turn` (3, 3), if given, has its axes as columns."""
    a, b, c = (float(radius) for radius in radii)

    def field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = x - center[0], y - center[1], z - center[2]
        if turn is not None:
            u, v, w = (turn[0, i] * u + turn[1, i] * v + turn[2, i] * w for i in range(3))
        level = np.sqrt((u / a) ** 2 + (v / b) ** 2 + (w / c) ** 2)
        slope = np.sqrt((u / a**2) ** 2 + (v / b**2) ** 2 + (w / c**2) ** 2)
        return first_order_distance(level, slope, min(a, b, c))

    return field


def box(center: Vector, half: Vector, round_mm: float) -> Field:
    """Box with its edges rounded; `half` are its half lengths."""

    def field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = (np.abs(p - c) - h + round_mm for p, c, h in zip((x, y, z), center, half, strict=True))
        beyond = np.sqrt(np.maximum(u, 0.0) ** 2 + np.maximum(v, 0.0) ** 2 + np.maximum(w, 0.0) ** 2)
        return beyond + np.minimum(np.maximum(u, np.maximum(v, w)), 0.0) - round_mm

    return field


def first_order_distance(level: np.ndarray, slope: np.ndarray, radius_mm: np.ndarray | float) -> np.ndarray:
    """Distance to where level = 1, given level = |p / r| and slope = |p / r^2|; about -`radius_mm` in the middle."""
    return (level - 1.0) * (level + 1e-3) / (slope + 1e-3 / radius_mm)


def capsule(start: Vector, end: Vector, radius: float, end_radius: float) -> Field:
    """Tapered rod with round ends.

    Parameters
    ----------
    start, end : (3,) float
        Middles of its ends, mm.
    radius, end_radius : float
        At the start and at the end, mm.
    """
    axis = np.subtract(end, start)
    length2 = float(axis @ axis)

    def field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = x - start[0], y - start[1], z - start[2]
        t = np.clip((axis[0] * u + axis[1] * v + axis[2] * w) / length2, 0.0, 1.0)
        distance = np.sqrt((u - t * axis[0]) ** 2 + (v - t * axis[1]) ** 2 + (w - t * axis[2]) ** 2)
        return distance - (radius + t * (end_radius - radius))

    return field


def smooth_min(a: np.ndarray, b: np.ndarray, blend_mm: float) -> np.ndarray:
    """Polynomial smooth minimum: equal to the minimum where |a - b| > `blend_mm`."""
    h = np.maximum(blend_mm - np.abs(a - b), 0.0) / blend_mm
    return np.minimum(a, b) - h * h * blend_mm / 4.0


def smooth_max(a: np.ndarray, b: np.ndarray, blend_mm: float) -> np.ndarray:
    """Polynomial smooth maximum."""
    return -smooth_min(-a, -b, blend_mm)


def union(fields: Sequence[Field], blend_mm: float) -> Field:
    """Smooth union of several shapes."""
    return lambda x, y, z: reduce(lambda a, b: smooth_min(a, b, blend_mm), (field(x, y, z) for field in fields))


def intersection(fields: Sequence[Field], blend_mm: float) -> Field:
    """Smooth intersection of several shapes."""
    return outside(union([outside(field) for field in fields], blend_mm))


def half_space(normal: Vector, at_mm: float) -> Field:
    """Everything where normal . p > at_mm; the normal is made a unit vector."""
    i, j, k = unit(normal)
    return lambda x, y, z: at_mm - (i * x + j * y + k * z)


def outside(field: Field) -> Field:
    """Everything that is not in the shape."""
    return lambda x, y, z: -field(x, y, z)


def shrunk(field: Field, by_mm: float) -> Field:
    """The shape without its outer `by_mm` (negative: grown)."""
    return lambda x, y, z: field(x, y, z) + by_mm


def rippled(field: Field, seed: int, amplitude_mm: float, wavelength_mm: float, waves: int = 8) -> Field:
    """The shape with its surface moved by a seeded sum of plane waves of about one wavelength.

    Parameters
    ----------
    field : Field
        The shape.
    seed : int
        Of the waves.
    amplitude_mm : float
        Standard deviation of the displacement.
    wavelength_mm : float
        From crest to crest, within 30 to 40 %.
    waves : int
        How many are summed.
    """
    generator = np.random.default_rng(seed)
    directions = unit(generator.normal(size=(waves, 3)))
    numbers = 2.0 * np.pi / (wavelength_mm * generator.uniform(0.7, 1.4, waves))
    phases = generator.uniform(0.0, 2.0 * np.pi, waves)
    weight = amplitude_mm * np.sqrt(2.0 / waves)

    def moved(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        result = field(x, y, z)
        for (i, j, k), number, phase in zip(directions, numbers, phases, strict=True):
            angle = np.float32(number * i) * x + np.float32(number * j) * y + np.float32(number * k) * z
            result = result + np.float32(weight) * np.cos(angle + np.float32(phase))
        return result

    return moved


def mesh_field(field: Field, bounds: Bounds, pitch_mm: float | Vector, name: str) -> trimesh.Trimesh:
    """Closed, outward surface where the field is zero, by marching cubes (Lewiner et al. 2003).

    Parameters
    ----------
    field : Field
        The shape: a signed distance, negative within.
    bounds : Bounds
        A box that holds the whole shape, mm; the grid covers only the part of it that the shape fills.
    pitch_mm : float or (3,) float
        Spacing of the grid.
    name : str
        Stands in messages and in `mesh.metadata["name"]`.

    Returns
    -------
    trimesh.Trimesh
        Vertices in mm.

    Raises
    ------
    ValueError
        When the shape is empty or leaves its box.
    """
    pitch = np.broadcast_to(np.asarray(pitch_mm, float), 3)
    lower, upper = np.array(bounds, float)
    step = (upper - lower) / COARSE_CELLS
    coarse = [np.linspace(lower[i], upper[i], COARSE_CELLS + 1, dtype=np.float32) for i in range(3)]
    near = np.argwhere(_on_grid(field, coarse) < np.linalg.norm(step))
    if len(near) == 0:
        raise ValueError(f"{name}: the shape is empty")
    first, last = lower + (near.min(0) - 1) * step, lower + (near.max(0) + 1) * step
    lower, upper = np.maximum(first, lower) - 2.0 * pitch, np.minimum(last, upper) + 2.0 * pitch
    axes = [np.arange(lower[i], upper[i] + pitch[i], pitch[i], dtype=np.float32) for i in range(3)]
    values = _on_grid(field, axes)
    if any(np.take(values, (0, -1), axis).min() < 0 for axis in range(3)):
        raise ValueError(f"{name}: the shape leaves its box {np.array(bounds).tolist()} mm")
    vertices, faces, _, _ = marching_cubes(values, 0.0, gradient_direction="descent", allow_degenerate=False)
    mesh = trimesh.Trimesh(vertices * pitch + [axis[0] for axis in axes], faces, process=False)
    mesh.metadata["name"] = name
    return mesh


def _on_grid(field: Field, axes: Sequence[np.ndarray]) -> np.ndarray:
    x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
    values = np.broadcast_to(field(x, y, z), tuple(len(axis) for axis in axes))
    return np.array(values, dtype=np.float32)  # a writable copy, as marching cubes asks


def unit(vectors: Vector) -> np.ndarray:
    """Vectors (..., 3) of the same directions and of length 1."""
    vectors = np.asarray(vectors, float)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def joined(meshes: Sequence[trimesh.Trimesh], name: str) -> trimesh.Trimesh:
    """Several disjoint closed meshes as one; where they overlapped, crossings would cancel."""
    mesh = trimesh.util.concatenate(meshes)
    mesh.metadata["name"] = name
    return mesh


class Part(NamedTuple):
    """A closed surface, mm, with its name in `mesh.metadata["name"]`, and the name of its tissue in the table."""

    mesh: trimesh.Trimesh
    tissue: str


def several(tissue: str, name: str, fields: Sequence[Field], box: Bounds, pitch_mm: float) -> Part:
    """Shapes that do not overlap, as one part.

    Parameters
    ----------
    tissue, name : str
        Of the part.
    fields : sequence of Field
        The shapes.
    box : Bounds
        Holds all of them, mm.
    pitch_mm : float
        Spacing of the grid, see `mesh_field`.
    """
    return Part(joined([mesh_field(field, box, pitch_mm, name) for field in fields], name), tissue)


def solids_in(box: Bounds, scale: float, coarsest_mm: float | Vector = np.inf) -> Callable[..., Part]:
    """What makes parts of fields in a box: `solid(field, tissue, pitch_mm, name)`, with the pitch at scale 1.

    A part may have its own `coarsest_mm`, beyond which the pitch does not grow.
    """

    def solid(field: Field, tissue: str, pitch_mm: float | Vector, name: str, coarsest: Any = coarsest_mm) -> Part:
        return Part(mesh_field(field, box, np.minimum(np.asarray(pitch_mm) * scale, coarsest), name), tissue)

    return solid


def moved(parts: list[Part], to: Callable[[np.ndarray], np.ndarray]) -> list[Part]:
    """The same parts, with `to` applied to their vertices (n, 3), mm."""
    for part in parts:
        part.mesh.vertices = to(part.mesh.vertices)
    return parts
