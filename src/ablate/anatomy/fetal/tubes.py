"""Tubes swept along a curve: vessels, long bones, what tapers at both ends."""

from collections.abc import Sequence

import numpy as np
import trimesh
from scipy.interpolate import make_interp_spline

from ablate.anatomy.fetal.shapes import Vector, unit


def tube(path: np.ndarray, radii: np.ndarray, sides: int, up: Vector = (0.0, 0.0, 1.0)) -> trimesh.Trimesh:
    """Closed, outward tube of 2 n `sides` triangles with an elliptical cross-section.

    Parameters
    ----------
    path : (n, 3) float
        Its centre line, mm; its ends are closed flat, so the tube is as long as the path.
    radii : (n,) or (n, 2) float
        Along `up` and across it, mm.
    sides : int
        Of the cross-section.
    up : (3,) float
        First axis of the cross-section at the start, made normal to the path; from there on it does not twist.

    Returns
    -------
    trimesh.Trimesh
        Vertices in mm.
    """
    path = np.asarray(path, float)
    radii = np.broadcast_to(np.asarray(radii, float).reshape(len(path), -1), (len(path), 2))
    first, second = frames(path, up)
    angle = 2.0 * np.pi * np.arange(sides) / sides
    along = radii[:, :1, None] * np.cos(angle)[None, :, None] * first[:, None]
    across = radii[:, 1:, None] * np.sin(angle)[None, :, None] * second[:, None]
    vertices = np.concatenate([(path[:, None] + (along + across)).reshape(-1, 3), path[[0, -1]]])
    i, j = np.meshgrid(np.arange(len(path) - 1), np.arange(sides), indexing="ij")
    a, b = i * sides + j, i * sides + (j + 1) % sides
    c, d = a + sides, b + sides
    wall = np.stack([np.stack([a, b, d], -1), np.stack([a, d, c], -1)], 2).reshape(-1, 3)
    k = np.arange(sides)
    last = (len(path) - 1) * sides
    start_cap = np.stack([np.full(sides, len(vertices) - 2), (k + 1) % sides, k], -1)
    end_cap = np.stack([np.full(sides, len(vertices) - 1), last + k, last + (k + 1) % sides], -1)
    return trimesh.Trimesh(vertices, np.concatenate([wall, start_cap, end_cap]), process=False)


def frames(path: np.ndarray, up: Vector) -> tuple[np.ndarray, np.ndarray]:
    """Two unit normals along a path (n, 3), each (n, 3), carried along without twist (parallel transport)."""
    tangent = unit(np.gradient(path, axis=0))
    first = np.empty_like(path)
    normal = np.asarray(up, float)
    for i, direction in enumerate(tangent):
        first[i] = normal = unit(normal - direction * (direction @ normal))
    return first, np.cross(tangent, first)


def arc_length(path: np.ndarray) -> np.ndarray:
    """Length of a path (n, 3) from its start to each of its points, (n,)."""
    return np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]


def interpolated(parameters: np.ndarray, knots: np.ndarray, path: np.ndarray) -> np.ndarray:
    """A path (n, 3), which is given at `knots` (n,), at other parameters (m,), linearly: (m, 3)."""
    return np.stack([np.interp(parameters, knots, path[:, i]) for i in range(3)], axis=1)


def smooth_path(points: Sequence[Vector] | np.ndarray, count: int) -> np.ndarray:
    """A cubic spline through the points (n, 3), sampled evenly in its parameter: (count, 3), mm."""
    knots = np.asarray(points, float)
    steps = arc_length(knots)
    return make_interp_spline(steps, knots, k=min(3, len(knots) - 1))(np.linspace(0.0, steps[-1], count))


def spindle(start: Vector, end: Vector, radii: Vector, sides: int, up: Vector = (0.0, 0.0, 1.0)) -> trimesh.Trimesh:
    """Ellipsoid with its long axis from `start` to `end`.

    Parameters
    ----------
    start, end : (3,) float
        mm.
    radii : (2,) float
        Along `up` and normal to it, mm.
    sides : int
        Of the cross-section.
    up : (3,) float
        First axis of the cross-section.
    """
    turn = np.linspace(0.04, np.pi - 0.04, max(4, sides // 2 + 1))
    t = (1.0 - np.cos(turn))[:, None] / 2.0
    path = (1.0 - t) * np.asarray(start, float) + t * np.asarray(end, float)
    return tube(path, np.sin(turn)[:, None] * np.asarray(radii, float), sides, up)


def rod(start: Vector, end: Vector, radius: float, sides: int, bow_mm: float = 0.0) -> trimesh.Trimesh:
    """Long bone: blunt, flared ends, a waist, and a slight bow.

    Parameters
    ----------
    start, end : (3,) float
        Its ends, mm.
    radius : float
        Near the ends, mm.
    sides : int
        Of the cross-section.
    bow_mm : float
        How far its middle lies off the straight line.
    """
    start, end = np.asarray(start, float), np.asarray(end, float)
    t = (1.0 - np.cos(np.pi * np.linspace(0.0, 1.0, max(6, 2 * sides)))) / 2.0
    along = end - start
    side = unit(np.cross(along, [0.3, 0.5, 0.8]))
    path = start + t[:, None] * along + bow_mm * (4.0 * t * (1.0 - t))[:, None] ** 2 * side
    flare = 0.7 + 0.4 * np.exp(-((np.minimum(t, 1.0 - t) / 0.13) ** 2))
    blunt = np.minimum(1.0, 0.72 + 12.0 * np.minimum(t, 1.0 - t))
    return tube(path, radius * flare * blunt, sides, up=side)
