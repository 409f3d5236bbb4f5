"""The placenta: a lobed disc on the uterine wall, with vessels on its fetal face and lakes of blood in its lobes.

World frame, mm. Directions are taken from the middle of the uterus, in units of its radii, so that the wall is
about a sphere of radius 1.
"""

from __future__ import annotations

import numpy as np
import trimesh

from ablate.anatomy.implicit import Bounds, Field, intersection, mesh_field, rippled, shrunk
from ablate.anatomy.mother import BODY_BOX, UTERUS_CENTER, UTERUS_RADII, cavity
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, smooth_path, spindle, tube

THICKNESS_MM = 22.0
REACH_DEG = 50.0  # of the disc, seen from the middle of the uterus
LOBE_MM = 36.0  # from the middle of a lobe to the next one's, on the wall
GROOVE_MM = 3.2  # depth of the groove between two lobes
GOLDEN_ANGLE = 2.399963  # rad
_WALL_MM = 80.0  # mean distance of the wall from the middle
_RADII = np.array(UTERUS_RADII)


def unit(vector: np.ndarray) -> np.ndarray:
    """Directions (..., 3) of length 1."""
    return vector / np.linalg.norm(vector, axis=-1, keepdims=True)


def lobes(seed: int, towards: np.ndarray) -> np.ndarray:
    """Unit directions of the lobes' middles, (n, 3): a shaken sunflower about the placenta's middle."""
    generator = np.random.default_rng([seed, 2])
    count = round(3.6 * (_WALL_MM * np.deg2rad(REACH_DEG) / LOBE_MM) ** 2)
    k = np.arange(count) + 0.5
    polar = np.deg2rad(REACH_DEG) * np.sqrt(k / count)
    turn = GOLDEN_ANGLE * k + generator.uniform(0.0, 2.0 * np.pi)
    polar, turn = polar + generator.normal(0.0, 0.04, count), turn + generator.normal(0.0, 0.1, count)
    return from_middle(towards, polar, turn)


def from_middle(towards: np.ndarray, polar: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Unit directions (n, 3) at angles (n,), rad, from the placenta's middle and about it."""
    first = unit(np.cross(towards, (0.3, 0.2, 0.93)))
    second = np.cross(towards, first)
    around = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
    return np.cos(polar)[:, None] * towards + np.sin(polar)[:, None] * around


def placenta_field(seed: int, towards: np.ndarray) -> Field:
    """The placenta, thickest in its middle; it reaches 3 mm into the uterine wall.

    Parameters
    ----------
    seed : int
        Of the lobes and the surface displacement, and that of `cavity`.
    towards : (3,) float
        Unit direction of its middle.
    """
    inner = cavity(seed)
    middles = lobes(seed, towards).astype(np.float32)

    def face(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = ((p - c) / r for p, c, r in zip((x, y, z), UTERUS_CENTER, UTERUS_RADII, strict=True))
        length = np.maximum(np.sqrt(u * u + v * v + w * w), 1e-3)
        cosine = (towards[0] * u + towards[1] * v + towards[2] * w) / length
        opening = np.arccos(np.clip(cosine, -1.0, 1.0)) / np.deg2rad(REACH_DEG)
        nearest = np.full(np.shape(length), -1.0, np.float32)  # cosines of the two nearest lobes
        second = nearest.copy()
        for i, j, k in middles:
            to_lobe = (i * u + j * v + k * w) / length
            second = np.maximum(second, np.minimum(nearest, to_lobe))
            nearest = np.maximum(nearest, to_lobe)
        apart = _WALL_MM * (
            np.sqrt(2.0 - 2.0 * np.minimum(second, 1.0)) - np.sqrt(2.0 - 2.0 * np.minimum(nearest, 1.0))
        )
        thickness = THICKNESS_MM * (1.0 - opening**3) - GROOVE_MM * np.exp(-((apart / 9.0) ** 2))
        return -(inner(x, y, z) + np.maximum(thickness, -12.0))

    return intersection([rippled(face, seed + 2, 0.5, 20.0), shrunk(inner, -3.0)], 3.0)


def placenta(
    tissues: dict[str, Tissue], scale: float, seed: int, towards: np.ndarray, insertion: np.ndarray
) -> list[Structure]:
    """Tissue, lakes and vessels.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every spacing.
    seed, towards
        As in `placenta_field`.
    insertion : (3,) float
        Where the cord meets the fetal face, mm: the vessels run out from there.
    """
    field = placenta_field(seed, towards)
    low = np.array(BODY_BOX[0]) * 0.75
    box: Bounds = (tuple(low), tuple(-low))
    sides = max(3, round(12 / scale))
    lakes = []
    for direction, size in zip(*_lakes(seed, towards), strict=True):
        on_face = face_points(field, direction[None])[0]
        outward = unit(direction * _RADII)
        middle = on_face + 0.45 * THICKNESS_MM * outward
        lakes.append(spindle(middle - size * outward, middle + size * outward, (0.7 * size, 0.6 * size), sides))
    return [
        Structure(mesh_field(field, box, 1.6 * scale, "placenta"), tissues["placenta"]),
        Structure(joined(lakes, "placental lakes"), tissues["blood"]),
        Structure(joined(_vessels(field, towards, insertion, sides, scale), "placental vessels"), tissues["blood"]),
    ]


def _lakes(seed: int, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) and half lengths (n,), mm, of the blood in the middle of the inner lobes."""
    middles = lobes(seed, towards)
    middles = middles[middles @ towards > np.cos(np.deg2rad(0.72 * REACH_DEG))]
    return middles, np.random.default_rng([seed, 3]).uniform(2.0, 4.0, len(middles))


def face_points(field: Field, directions: np.ndarray) -> np.ndarray:
    """Where rays from the middle of the uterus, along directions (n, 3), meet the fetal face; (n, 3), mm."""
    along = np.linspace(0.1, 1.3, 121)
    points = np.array(UTERUS_CENTER) + along[:, None, None] * directions * _RADII
    value = field(*np.moveaxis(points, -1, 0))
    first = np.maximum(np.argmax(value < 0.0, axis=0), 1)
    ray = np.arange(len(directions))
    share = value[first - 1, ray] / (value[first - 1, ray] - value[first, ray])
    return points[first - 1, ray] + share[:, None] * (points[first, ray] - points[first - 1, ray])


def _vessels(
    field: Field, towards: np.ndarray, insertion: np.ndarray, sides: int, scale: float
) -> list[trimesh.Trimesh]:
    """Branches that run out from the cord's insertion under the fetal face, not to its rim, and dive into the lobes."""
    center = unit((insertion - UTERUS_CENTER) / _RADII)
    count = max(6, round(40 / scale))
    branches = []
    for k in range(7):
        polar = np.linspace(0.1, 0.1 + np.deg2rad(REACH_DEG) * (0.5, 0.36)[k % 2], 40)
        along = from_middle(center, polar, 2.0 * np.pi * k / 7 + 0.35 * (-1.0) ** k * (polar - 0.1))
        along = along[: np.argmax(np.append(along @ towards < np.cos(np.deg2rad(0.7 * REACH_DEG)), True))]
        if len(along) < 8:
            continue
        depth = 4.4 + 7.5 * np.linspace(0.0, 1.0, len(along)) ** 4
        path = (face_points(field, along) + depth[:, None] * unit(along * _RADII))[:: len(along) // 7]
        branches.append(tube(smooth_path(path, count), np.linspace(1.5, 0.7, count), sides))
    return branches
