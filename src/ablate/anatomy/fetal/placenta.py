"""The placenta: a lobed disc on the uterine wall, with vessels on its fetal face and lakes of blood in its lobes.

World frame, mm. Directions are taken from the middle of the uterus, in units of its radii, so that the wall is
about a sphere of radius 1.
"""

import numpy as np
import trimesh

from ablate.anatomy.fetal import sdf
from ablate.anatomy.fetal.mother import BODY_BOX, UTERUS_CENTER, UTERUS_RADII, cavity
from ablate.anatomy.fetal.parts import Part
from ablate.anatomy.fetal.tubes import joined, smooth_path, spindle, tube, unit

THICKNESS_MM = 22.0
REACH_DEG = 50.0  # of the disc, seen from the middle of the uterus
LOBE_MM = 36.0  # from the middle of a lobe to the next one's, on the wall
GROOVE_MM = 3.2  # depth of the groove between two lobes
GOLDEN_ANGLE = 2.399963  # rad
_WALL_MM = 80.0  # mean distance of the wall from the middle
_RADII = np.array(UTERUS_RADII)


def lobes(seed: int, towards: np.ndarray) -> np.ndarray:
    """Unit directions of the lobes' middles, (n, 3): a sunflower pattern about the placenta's middle, disturbed."""
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


def placenta_field(seed: int, towards: np.ndarray) -> sdf.Field:
    """The placenta, thickest in its middle, whose unit direction is `towards` (3,); it reaches 3 mm into the wall."""
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
        to_second, to_nearest = (np.sqrt(2.0 - 2.0 * np.minimum(cosines, 1.0)) for cosines in (second, nearest))
        apart = _WALL_MM * (to_second - to_nearest)
        thickness = THICKNESS_MM * (1.0 - opening**3) - GROOVE_MM * np.exp(-((apart / 9.0) ** 2))
        return -(inner(x, y, z) + np.maximum(thickness, -12.0))

    return sdf.intersection([sdf.rippled(face, seed + 2, 0.5, 20.0), sdf.shrunk(inner, -3.0)], 3.0)


def placenta(scale: float, seed: int, towards: np.ndarray, insertion: np.ndarray) -> list[Part]:
    """Tissue, lakes of blood in the inner lobes, and vessels, which start at the cord's `insertion` (3,), mm."""
    field = placenta_field(seed, towards)
    lower = np.array(BODY_BOX[0]) * 0.75
    box: sdf.Bounds = (tuple(lower), tuple(-lower))
    sides = max(3, round(12 / scale))
    inner = lobes(seed, towards)
    inner = inner[inner @ towards > np.cos(np.deg2rad(0.72 * REACH_DEG))]
    sizes = np.random.default_rng([seed, 3]).uniform(2.0, 4.0, len(inner))  # half lengths, mm
    lakes = []
    for direction, size in zip(inner, sizes, strict=True):
        on_face = face_points(field, direction[None])[0]
        outward = unit(direction * _RADII)
        middle = on_face + 0.45 * THICKNESS_MM * outward
        lakes.append(spindle(middle - size * outward, middle + size * outward, (0.7 * size, 0.6 * size), sides))
    return [
        Part(sdf.mesh_field(field, box, 1.6 * scale, "placenta"), "placenta"),
        Part(joined(lakes, "placental lakes"), "blood"),
        Part(joined(_vessels(field, towards, insertion, sides, scale), "placental vessels"), "blood"),
    ]


def face_points(field: sdf.Field, directions: np.ndarray) -> np.ndarray:
    """Where rays from the middle of the uterus, along directions (n, 3), meet the fetal face; (n, 3), mm."""
    along = np.linspace(0.1, 1.3, 121)
    points = np.array(UTERUS_CENTER) + along[:, None, None] * directions * _RADII
    value = field(*np.moveaxis(points, -1, 0))
    first = np.maximum(np.argmax(value < 0.0, axis=0), 1)
    ray = np.arange(len(directions))
    share = value[first - 1, ray] / (value[first - 1, ray] - value[first, ray])
    return points[first - 1, ray] + share[:, None] * (points[first, ray] - points[first - 1, ray])


def _vessels(
    field: sdf.Field, towards: np.ndarray, insertion: np.ndarray, sides: int, scale: float
) -> list[trimesh.Trimesh]:
    """Branches from the cord's insertion, first under the fetal face and then into the lobes, but not to the rim."""
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
