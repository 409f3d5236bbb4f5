"""Measuring: one point names the tissue, two are a distance, three an angle, and four the axes of an ellipse.

Points are in the world, (n, 3) mm, so that they stay with the anatomy when the probe moves.
"""

import math

import numpy as np
from scipy.special import ellipe

from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of

MOST_POINTS = 4
_IN_PLANE_MM = 1.0  # a point farther off the image plane is not on the image
_SKEW = 0.17  # cosine of 80 degrees, and the share of an axis by which middles may differ
_STEPS = 64  # of an ellipse's outline


def on_plane(pose: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Where a line of sight meets the image plane of a pose, (3,); a ValueError where it runs along it."""
    falls = direction @ pose[:3, 1]
    if abs(falls) < 1e-6:
        raise ValueError("the fan is seen edge on: turn the body, then click again")
    return np.asarray(origin - direction * ((origin - pose[:3, 3]) @ pose[:3, 1]) / falls)


def in_plane(points: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """x and z of points in the image plane, (n, 2) mm; (0, 2) where one of them is off the plane."""
    seen = (np.reshape(points, (-1, 3)) - pose[:3, 3]) @ pose[:3, :3]
    return seen[:, ::2] if (np.abs(seen[:, 1]) <= _IN_PLANE_MM).all() else np.empty((0, 2))


def lines(points: np.ndarray) -> list[np.ndarray]:
    """What is drawn between points of the image plane, (n, 2) mm: polygons, (m, 2) each."""
    if len(points) < MOST_POINTS:
        return [points] if len(points) > 1 else []
    along, across = points[1] - points[0], points[3] - points[2]
    turn = 2 * np.pi * np.arange(_STEPS + 1)[:, None] / _STEPS
    normal = np.array([-along[1], along[0]]) * (math.hypot(*across) / max(math.hypot(*along), 1e-9))
    return [points[:2], points[2:], points.mean(axis=0) + (np.cos(turn) * along + np.sin(turn) * normal) / 2]


def values(points: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """What points of the image plane, (n, 2) mm, measure, each value with the point that it is written beside."""
    if len(points) == 2:
        return [(points[1], f"{math.dist(*points):.1f} mm")]
    if len(points) == 3:
        return [(points[1], f"{math.degrees(_angle(points)):.0f}°")]
    if len(points) == MOST_POINTS:
        return [(points[end], f"{math.dist(points[end - 1], points[end]):.1f} mm") for end in (1, 3)]
    return []


def measured(points: np.ndarray, tissue: str, probe: Probe) -> str:
    """The last point's `tissue` and depth, and what so many points measure, in Markdown; points are in the plane."""
    x, z = points[-1]
    depth_mm = float(fan_of(probe).polar(np.asarray(x), np.asarray(z))[0])
    words = f"**{tissue}**, {depth_mm:.0f} mm deep. "
    if len(points) == 2:
        words += f"Distance **{math.dist(*points):.1f} mm**."
    elif len(points) == 3:
        words += f"Angle at the second point **{math.degrees(_angle(points)):.0f}°**."
    elif len(points) == MOST_POINTS:
        first_mm, second_mm = math.dist(*points[:2]), math.dist(*points[2:])
        words += f"Axes **{first_mm:.1f}** and **{second_mm:.1f} mm**, "
        words += f"circumference **{circumference(points):.0f} mm**."
        if not _are_axes(points):
            words += " The axes are not perpendicular, or do not cross in their middles: this is not their ellipse."
    return words


def _angle(points: np.ndarray) -> float:
    """The angle at the second of three points, rad, in [0, pi]."""
    first, second = points[0] - points[1], points[2] - points[1]
    return abs(math.atan2(first[0] * second[1] - first[1] * second[0], float(first @ second)))


def _are_axes(points: np.ndarray) -> bool:
    """Whether four points can be the ends of the axes of an ellipse."""
    first, second = points[1] - points[0], points[3] - points[2]
    lengths = math.hypot(*first), math.hypot(*second)
    apart = math.dist(points[:2].mean(axis=0), points[2:].mean(axis=0))
    return abs(first @ second) <= _SKEW * math.prod(lengths) and apart <= _SKEW * min(lengths)


def circumference(points: np.ndarray) -> float:
    """Of the ellipse with the axes from the first to the second and from the third to the fourth point, mm.

    It is 2 d E(1 - (e / d)^2) with the longer axis d, the other one e, and the complete elliptic integral E.
    """
    short, long = sorted((math.dist(*points[:2]), math.dist(*points[2:])))
    return float(2 * long * ellipe(1 - (short / max(long, 1e-9)) ** 2))
