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


def measured(points: np.ndarray, tissue: str, probe: Probe) -> str:
    """The last point's `tissue` and depth, and what so many points measure, in Markdown; points are in the plane."""
    depth_mm = float(fan_of(probe).polar(*(np.asarray(place) for place in points[-1]))[0])
    said = f"**{tissue}**, {depth_mm:.0f} mm deep. "
    if len(points) == 2:
        said += f"Distance **{math.dist(*points):.1f} mm**."
    elif len(points) == 3:
        one, other = points[0] - points[1], points[2] - points[1]
        turn = abs(math.atan2(one[0] * other[1] - one[1] * other[0], float(one @ other)))
        said += f"Angle at the second point **{math.degrees(turn):.0f}°**."
    elif len(points) == MOST_POINTS:
        axes = math.dist(*points[:2]), math.dist(*points[2:])
        along, across = points[1] - points[0], points[3] - points[2]
        apart = math.dist(points[:2].mean(axis=0), points[2:].mean(axis=0))
        said += f"Axes **{axes[0]:.1f}** and **{axes[1]:.1f} mm**, circumference **{circumference(points):.0f} mm**."
        if abs(along @ across) > _SKEW * math.prod(axes) or apart > _SKEW * min(axes):
            said += " The axes are not perpendicular, or do not cross in their middles: this is not their ellipse."
    return said


def circumference(points: np.ndarray) -> float:
    """Of the ellipse with the axes from the first to the second and from the third to the fourth point, mm.

    It is 2 d E(1 - (e / d)^2) with the longer axis d, the other one e, and the complete elliptic integral E.
    """
    short, long = sorted((math.dist(*points[:2]), math.dist(*points[2:])))
    return float(2 * long * ellipe(1 - (short / max(long, 1e-9)) ** 2))
