"""Axes of the fetus at 22 weeks, of its trunk and of its head, and the outline of the trunk.

Fetal axes in mm: x to its left, y to its back, z to its head. Organs and bones of the trunk are built in a straight
trunk (x, y, s) and bent forward afterwards; cross-sections at constant s keep their shape. The head has axes of its
own, which are parallel to the fetal ones before the neck is bent.
"""

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from ablate.anatomy.fetal import sdf

BEND_RADIUS_MM = 125.0  # of the curve of the back; its centre lies in front of the belly
BEND_REACH_MM = 52.0  # the trunk is bent for |s| below this and straight beyond
SIDES = (1.0, -1.0)  # signs of x: left, right
NAVEL_IN_TRUNK = (0.0, -36.0, -27.0)
NECK_TOP = (0.0, 5.0, 55.0)  # in the trunk
NECK_IN_HEAD = (0.0, 10.0, -25.0)
HEAD_FLEXION_DEG = 34.0
TRUNK_BOX: sdf.Bounds = ((-40.0, -40.0, -75.0), (40.0, 40.0, 75.0))
WALL_OUTSIDE_MM, WALL_INSIDE_MM = 2.6, 5.8  # depth of the muscles of the trunk under its skin
ABDOMEN_S_MM = -17.0  # level of the stomach, where the abdominal circumference is taken
#: Outline of the trunk, mm: levels s, and there the half width, the half depth and the middle in y.
_OUTLINE = np.array(
    [
        (-66.0, -64.0, -59.0, -50.0, -36.0, -24.0, -17.0, -8.0, 4.0, 20.0, 33.0, 42.0, 49.0, 60.0, 66.0),
        (1.0, 7.0, 15.0, 21.5, 25.8, 27.8, 28.0, 27.8, 26.6, 25.4, 24.6, 19.0, 12.5, 11.5, 11.0),
        (1.0, 6.0, 13.0, 19.0, 24.6, 27.2, 27.7, 27.4, 26.0, 23.6, 20.5, 16.0, 12.5, 11.5, 11.0),
        (3.0, 3.0, 2.5, 1.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.5, 4.0, 5.0, 5.0),
    ]
)
_LEVELS = np.linspace(_OUTLINE[0, 0], _OUTLINE[0, -1], 400)
_SMOOTH_OUTLINE = PchipInterpolator(_OUTLINE[0], _OUTLINE[1:].T)(_LEVELS)

HEAD_ROTATION = Rotation.from_euler("x", HEAD_FLEXION_DEG, degrees=True).as_matrix()


def outline(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half width, half depth and middle in y of the trunk at level s; all mm, the shape of s."""
    width, depth, middle = (np.interp(s, _LEVELS, _SMOOTH_OUTLINE[:, i]).astype(np.float32) for i in range(3))
    return width, depth, middle


def trunk(x: np.ndarray, y: np.ndarray, s: np.ndarray) -> np.ndarray:
    """About the distance to the skin of the straight trunk, mm, negative inside."""
    width, depth, middle = outline(s)
    u, v = x / width, (y - middle) / depth
    level = np.sqrt(u * u + v * v)
    slope = np.sqrt((u / width) ** 2 + (v / depth) ** 2)
    around = sdf.first_order_distance(level, slope, np.minimum(width, depth))
    return sdf.smooth_max(around, np.abs(s) - 65.0, 2.0)


def spine_y(s: np.ndarray | float) -> np.ndarray:
    """Depth of the middle of the vertebral bodies at level s, mm."""
    _, depth, middle = outline(np.asarray(s, float))
    return middle + depth - 10.0


def above_diaphragm(gap_mm: float) -> sdf.Field:
    """The space of the straight trunk at least `gap_mm` above the two-domed diaphragm."""
    return lambda x, y, s: 0.8 * (8.0 - (x * x + (y - 2.0) ** 2) / 62.0 + gap_mm - s)


def curl(points: np.ndarray) -> np.ndarray:
    """From the straight trunk (n, 3) to fetal axes (n, 3), mm."""
    x, y, s = np.asarray(points, float).T
    bent = np.clip(s, -BEND_REACH_MM, BEND_REACH_MM)
    angle = bent / BEND_RADIUS_MM
    beyond = s - bent
    arm = BEND_RADIUS_MM + y
    forward = arm * np.cos(angle) - BEND_RADIUS_MM - beyond * np.sin(angle)
    return np.stack([x, forward, arm * np.sin(angle) + beyond * np.cos(angle)], axis=1)


def curled(field: sdf.Field) -> sdf.Field:
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


HEAD_ORIGIN = curl(np.array([NECK_TOP]))[0] - HEAD_ROTATION @ np.array(NECK_IN_HEAD)  # of the skull, in fetal axes


def head_to_fetus(points: np.ndarray) -> np.ndarray:
    """From the head's axes (n, 3) to the fetus's (n, 3), mm."""
    return np.asarray(points) @ HEAD_ROTATION.T + HEAD_ORIGIN


def in_head(field: sdf.Field) -> sdf.Field:
    """A field of the head's axes as a field in fetal axes."""

    def placed(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = (p - start for p, start in zip((x, y, z), HEAD_ORIGIN, strict=True))
        return field(*(i * u + j * v + k * w for i, j, k in HEAD_ROTATION.T))

    return placed
