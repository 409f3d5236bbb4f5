"""Frames of the fetus at 22 weeks: its curled trunk, its head, and where it lies in the mother.

Fetal axes in mm: x to its left, y to its back, z to its head. Organs and bones of the trunk are designed in a
straight trunk (x, y, s) and bent forward afterwards; cross-sections at constant s keep their shape.
"""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from ablate.anatomy.implicit import Field, first_order_distance, smooth_max

BEND_RADIUS_MM = 125.0  # of the back's curve, with its centre in front of the belly
BEND_REACH_MM = 52.0  # the trunk is bent for |s| below this and straight beyond
NECK_TOP = (0.0, 5.0, 55.0)  # in the trunk
NECK_IN_HEAD = (0.0, 10.0, -25.0)
HEAD_FLEXION_DEG = 36.0
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

#: Fetal left, back and head in the mother: head down, on its right side, its back to her right.
_LIE = np.array([[0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, -1.0]]).T
LIE_ROTATION = Rotation.from_euler("xyz", [4.0, -8.0, -14.5], degrees=True).as_matrix() @ _LIE
LIE_ORIGIN = (-15.5, -18.5, 16.0)
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


def to_world(points: np.ndarray) -> np.ndarray:
    """From fetal axes (n, 3) to the mother's (n, 3), mm."""
    return np.asarray(points) @ LIE_ROTATION.T + np.array(LIE_ORIGIN)


def trunk_to_world(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh, designed in the straight trunk, where it lies in the mother."""
    mesh.vertices = to_world(curl(mesh.vertices))
    return mesh


def head_to_world(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh, designed in the head's axes, where it lies in the mother."""
    mesh.vertices = to_world(head_to_fetus(mesh.vertices))
    return mesh


def fetus_to_world(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh, designed in fetal axes, where it lies in the mother."""
    mesh.vertices = to_world(mesh.vertices)
    return mesh


def head_plane() -> tuple[np.ndarray, np.ndarray]:
    """Point and normal, world mm, of the plane where BPD and HC are measured."""
    return to_world(head_origin()[None])[0], LIE_ROTATION @ HEAD_ROTATION[:, 2]


def abdomen_plane() -> tuple[np.ndarray, np.ndarray]:
    """Point and normal, world mm, of the plane where AC is measured."""
    point, ahead = to_world(curl(np.array([[0.0, 0.0, ABDOMEN_S_MM], [0.0, 0.0, ABDOMEN_S_MM + 1e-3]])))
    return point, (ahead - point) / np.linalg.norm(ahead - point)
