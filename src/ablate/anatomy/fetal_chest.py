"""Inside of the fetal chest: lungs, a heart with four chambers, great vessels. Straight trunk (x, y, s), mm."""

from __future__ import annotations

import numpy as np
import trimesh

from ablate.anatomy.fetal_frame import TRUNK_BOX, WALL_INSIDE_MM, above_diaphragm, from_trunk, spine_y, trunk
from ablate.anatomy.implicit import (
    Field,
    capsule,
    ellipsoid,
    half_space,
    intersection,
    mesh_field,
    outside,
    rippled,
    shrunk,
    union,
)
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, smooth_path, spindle, tube

HEART_CENTER = np.array([2.6, -3.6, 17.0])
#: The heart's axes as columns: to the apex (left, forward, down), to its left, and up; made orthonormal.
HEART_TOWARDS = np.array([[0.64, 0.62, 0.2], [-0.70, 0.76, 0.0], [-0.26, 0.05, 1.0]])
HEART_AXES = np.linalg.qr(HEART_TOWARDS)[0]
HEART_AXES *= np.sign((HEART_AXES * HEART_TOWARDS).sum(axis=0))


def fetal_chest(tissues: dict[str, Tissue], scale: float, seed: int) -> list[Structure]:
    """The organs of the chest in fetal axes, later ones owning where two overlap.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every grid spacing.
    seed : int
        Of the surface displacements.
    """

    def solid(field: Field, tissue: str, pitch_mm: float, name: str) -> Structure:
        return Structure(from_trunk(mesh_field(field, TRUNK_BOX, min(pitch_mm * scale, 7.0), name)), tissues[tissue])

    room = intersection([shrunk(trunk, WALL_INSIDE_MM), above_diaphragm(0.6), half_space((0.0, 0.0, -1.0), -39.0)], 2.0)
    heart = intersection([_myocardium(seed), shrunk(trunk, WALL_INSIDE_MM + 0.4)], 1.0)
    band = spindle(_in_heart((3.9, -0.8, -0.5)), _in_heart((3.4, -7.4, 0.5)), (0.6, 0.8), max(4, round(10 / scale)))
    return [
        solid(room, "soft_tissue", 1.0, "mediastinum"),
        _lungs(tissues, min(0.85 * scale, 7.0), outside(shrunk(heart, -1.0)), seed + 2),
        solid(heart, "myocardium", 0.65, "heart"),
        _chambers(tissues, scale, seed),
        Structure(from_trunk(joined([band], "moderator band")), tissues["myocardium"]),
        *_great_vessels(tissues, scale),
    ]


def _in_heart(point: tuple[float, float, float]) -> np.ndarray:
    """A point given to the apex, to the heart's left and up, in the straight trunk."""
    return HEART_CENTER + HEART_AXES @ np.array(point)


def _chamber_fields() -> list[Field]:
    """Two ventricles and two atria; what is left between them are septa and valves.

    The left ventricle reaches farther to the apex, the right one's valve lies nearer to it.
    """

    def ventricle(base: tuple[float, float], apex: tuple[float, float], radii: tuple[float, float]) -> Field:
        return union([capsule(_in_heart((*base, up)), _in_heart((*apex, up)), *radii) for up in (-1.2, 1.2)], 2.0)

    return [
        ventricle((-1.2, 4.2), (8.0, 1.7), (3.2, 1.8)),
        ventricle((-0.2, -4.5), (6.0, -3.6), (3.2, 1.9)),
        ellipsoid(_in_heart((-8.5, 3.9, 0.0)), (3.3, 3.5, 4.0), HEART_AXES),
        ellipsoid(_in_heart((-7.8, -4.1, 0.0)), (3.5, 3.7, 4.2), HEART_AXES),
    ]


def _myocardium(seed: int) -> Field:
    """The chambers in their walls, which are thickest around the left ventricle."""
    walls = [shrunk(field, -wall_mm) for field, wall_mm in zip(_chamber_fields(), (2.8, 2.3, 1.7, 1.7), strict=True)]
    return rippled(union(walls, 4.0), seed, 0.12, 14.0)


def _lungs(tissues: dict[str, Tissue], pitch_mm: float, beside_heart: Field, seed: int) -> Structure:
    """Two lungs on the diaphragm, around heart and spine."""
    room = [
        shrunk(trunk, WALL_INSIDE_MM + 0.6),
        above_diaphragm(1.4),
        half_space((0.0, 0.0, -1.0), -36.0),
        beside_heart,
        outside(ellipsoid((0.0, 21.0, -10.0), (9.0, 11.0, 62.0))),
    ]
    meshes = []
    for side in (1.0, -1.0):
        field = rippled(intersection([*room, half_space((side, 0.0, 0.0), 2.8)], 3.0), seed, 0.2, 12.0)
        meshes.append(mesh_field(field, TRUNK_BOX, pitch_mm, "lung"))
    return Structure(from_trunk(joined(meshes, "lungs")), tissues["lung"])


def _chambers(tissues: dict[str, Tissue], scale: float, seed: int) -> Structure:
    """Blood in ventricles and atria."""
    pitch_mm = min(0.5 * scale, 1.6)
    meshes = [
        mesh_field(rippled(field, seed + 60, 0.06, 9.0), TRUNK_BOX, pitch_mm, "chamber") for field in _chamber_fields()
    ]
    return Structure(from_trunk(joined(meshes, "heart chambers")), tissues["blood"])


def _great_vessels(tissues: dict[str, Tissue], scale: float) -> list[Structure]:
    """Aorta with its arch, both venae cavae; the pulmonary trunk, which the duct joins to the aorta."""
    sides, count = max(4, round(14 / scale)), max(6, round(70 / scale))
    down = np.linspace(23.0, -36.0, 6)
    aorta = [(0.5, -1.5, 23.0), (0.8, -2.0, 28.0), (2.2, 2.0, 32.0), (3.2, 6.5, 28.5)]
    aorta += [(3.2, float(spine_y(s)) - 5.4, float(s)) for s in down]
    lower = [(-4.2, float(spine_y(s)) - 5.6, float(s)) for s in np.linspace(-36.0, 2.0, 5)]
    upper = [(-5.6, -2.0, 38.0), (-5.8, -1.0, 31.0), (-5.6, 0.5, 24.0)]
    trunk_ = [(3.0, -8.5, 23.0), (4.6, -5.5, 27.0), (5.6, 0.0, 27.0), (5.2, 5.5, 23.5)]

    def vessels(name: str, *courses: tuple[list[tuple[float, float, float]], float, float]) -> Structure:
        meshes: list[trimesh.Trimesh] = [
            tube(smooth_path(points, count), np.linspace(first, last, count), sides, up=(1.0, 0.2, 0.1))
            for points, first, last in courses
        ]
        return Structure(from_trunk(joined(meshes, name)), tissues["blood"])

    return [
        vessels("aorta and venae cavae", (aorta, 2.1, 1.6), (lower, 1.6, 1.9), (upper, 1.5, 1.6)),
        vessels("pulmonary trunk", (trunk_, 2.0, 1.6)),
    ]
