"""Frames of the fetus at 22 weeks: its curled trunk and its head.

Fetal axes in mm: x to its left, y to its back, z to its head. Organs and bones of the trunk are designed in a
straight trunk (x, y, s) and bent forward afterwards; cross-sections at constant s keep their shape.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from ablate.anatomy.implicit import Bounds, Field, first_order_distance, smooth_max

BEND_RADIUS_MM = 125.0  # of the back's curve, with its centre in front of the belly
BEND_REACH_MM = 52.0  # the trunk is bent for |s| below this and straight beyond
NECK_TOP = (0.0, 5.0, 55.0)  # in the trunk
NECK_IN_HEAD = (0.0, 10.0, -25.0)
HEAD_FLEXION_DEG = 34.0
TRUNK_BOX: Bounds = ((-40.0, -40.0, -75.0), (40.0, 40.0, 75.0))
WALL_OUTSIDE_MM, WALL_INSIDE_MM = 2.6, 5.8  # depth of the muscles of the trunk under its skin
ABDOMEN_S_MM = -17.0  # level of the stomach, where the abdominal circumference is taken
#: Trunk outline: s, half width, half depth, middle in y (all mm).
TRUNK_OUTLINE = np.array(
    [
        (-66.0, 1.0, 1.0, 3.0),
        (-64.0, 7.0, 6.0, 3.0),
        (-59.0, 15.0, 13.0, 2.5),
        (-50.0, 21.5, 19.0, 1.5),
        (-36.0, 25.8, 24.6, 0.5),
        (-24.0, 27.8, 27.2, 0.0),
        (-17.0, 28.0, 27.7, 0.0),
        (-8.0, 27.8, 27.4, 0.0),
        (4.0, 26.6, 26.0, 0.0),
        (20.0, 25.4, 23.6, 0.0),
        (33.0, 24.6, 20.5, 1.0),
        (42.0, 19.0, 16.0, 2.5),
        (49.0, 12.5, 12.5, 4.0),
        (60.0, 11.5, 11.5, 5.0),
        (66.0, 11.0, 11.0, 5.0),
    ]
)
_LEVELS = np.linspace(TRUNK_OUTLINE[0, 0], TRUNK_OUTLINE[-1, 0], 400)
_OUTLINE = PchipInterpolator(TRUNK_OUTLINE[:, 0], TRUNK_OUTLINE[:, 1:])(_LEVELS)

HEAD_ROTATION = Rotation.from_euler("x", HEAD_FLEXION_DEG, degrees=True).as_matrix()


def outline(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half width, half depth and middle in y of the trunk at level s; all mm, the shape of s."""
    width, depth, middle = (np.interp(s, _LEVELS, _OUTLINE[:, i]).astype(np.float32) for i in range(3))
    return width, depth, middle


def trunk(x: np.ndarray, y: np.ndarray, s: np.ndarray) -> np.ndarray:
    """About the distance to the skin of the straight trunk, mm, negative inside."""
    width, depth, middle = outline(s)
    u, v = x / width, (y - middle) / depth
    level = np.sqrt(u * u + v * v)
    slope = np.sqrt((u / width) ** 2 + (v / depth) ** 2)
    around = first_order_distance(level, slope, np.minimum(width, depth))
    return smooth_max(around, np.abs(s) - 65.0, 2.0)


def spine_y(s: np.ndarray | float) -> np.ndarray:
    """Depth of the middle of the vertebral bodies at level s, mm."""
    _, depth, middle = outline(np.asarray(s, float))
    return middle + depth - 10.0


def above_diaphragm(gap_mm: float) -> Field:
    """The space of the straight trunk at least `gap_mm` above the two-domed diaphragm."""

    def field(x: np.ndarray, y: np.ndarray, s: np.ndarray) -> np.ndarray:
        dome = 8.0 - (x * x + (y - 2.0) ** 2) / 62.0
        return 0.8 * (dome + gap_mm - s)

    return field


def curl(points: np.ndarray) -> np.ndarray:
    """From the straight trunk (n, 3) to fetal axes (n, 3), mm."""
    x, y, s = np.asarray(points, float).T
    bent = np.clip(s, -BEND_REACH_MM, BEND_REACH_MM)
    angle = bent / BEND_RADIUS_MM
    beyond = s - bent
    arm = BEND_RADIUS_MM + y
    return np.stack(
        [
            x,
            arm * np.cos(angle) - BEND_RADIUS_MM - beyond * np.sin(angle),
            arm * np.sin(angle) + beyond * np.cos(angle),
        ],
        axis=1,
    )


def curled(field: Field) -> Field:
    """A field of the straight trunk as a field in fetal axes: the inverse of `curl`."""
    reach = BEND_REACH_MM / BEND_RADIUS_MM

    def bent(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        arm = y + BEND_RADIUS_MM
        angle = np.clip(np.arctan2(z, arm), -reach, reach)
        sine, cosine = np.sin(angle), np.cos(angle)
        depth = arm * cosine + z * sine - BEND_RADIUS_MM
        level = angle * BEND_RADIUS_MM + (z * cosine - arm * sine)
        return field(x, depth, level)

    return bent


def head_origin() -> np.ndarray:
    """Middle of the skull in fetal axes, (3,) mm."""
    return curl(np.array([NECK_TOP]))[0] - HEAD_ROTATION @ np.array(NECK_IN_HEAD)


def head_to_fetus(points: np.ndarray) -> np.ndarray:
    """From the head's axes (n, 3) to the fetus's (n, 3), mm."""
    return np.asarray(points) @ HEAD_ROTATION.T + head_origin()


def in_head(field: Field) -> Field:
    """A field of the head's axes as a field in fetal axes."""
    origin, turn = head_origin(), HEAD_ROTATION

    def placed(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = x - origin[0], y - origin[1], z - origin[2]
        return field(*(turn[0, i] * u + turn[1, i] * v + turn[2, i] * w for i in range(3)))

    return placed


def from_trunk(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh, designed in the straight trunk, in fetal axes."""
    mesh.vertices = curl(mesh.vertices)
    return mesh


def from_head(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh, designed in the head's axes, in fetal axes."""
    mesh.vertices = head_to_fetus(mesh.vertices)
    return mesh
