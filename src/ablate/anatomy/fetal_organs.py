"""Soft organs of the fetal trunk: lungs, heart with four chambers, liver, gut, kidneys, vessels."""

from __future__ import annotations

import numpy as np

from ablate.anatomy.fetal_frame import outline, trunk, trunk_to_world
from ablate.anatomy.implicit import (
    Bounds,
    Field,
    ellipsoid,
    intersection,
    mesh_field,
    outside,
    rippled,
    shrunk,
)
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, smooth_path, tube

TRUNK_BOX: Bounds = ((-40.0, -40.0, -75.0), (40.0, 40.0, 75.0))
WALL_OUTSIDE_MM, WALL_INSIDE_MM = 2.6, 5.8  # depth of the muscles of the trunk under its skin
HEART_CENTER = np.array([4.0, -5.0, 17.5])
#: The heart's axes as columns: to the apex (left, forward, down), to its left, and up; made orthonormal.
HEART_TOWARDS = np.array([[0.64, 0.62, 0.2], [-0.70, 0.76, 0.0], [-0.26, 0.05, 1.0]])
HEART_AXES = np.linalg.qr(HEART_TOWARDS)[0]
HEART_AXES *= np.sign((HEART_AXES * HEART_TOWARDS).sum(axis=0))
#: Chambers in the heart's axes (to the apex, to its left, up): center and radii, mm.
CHAMBERS = (
    ((3.2, 3.7, 0.0), (6.2, 2.6, 4.2)),
    ((2.6, -3.8, 0.0), (5.6, 2.7, 4.4)),
    ((-6.4, 3.4, 0.0), (2.8, 2.9, 3.8)),
    ((-6.4, -3.7, 0.0), (2.8, 3.0, 3.9)),
)


def _above_diaphragm(gap_mm: float) -> Field:
    """The space at least `gap_mm` above the two-domed diaphragm."""

    def field(x: np.ndarray, y: np.ndarray, s: np.ndarray) -> np.ndarray:
        dome = 8.0 - (x * x + (y - 2.0) ** 2) / 62.0
        return 0.8 * (dome + gap_mm - s)

    return field


def _beyond(normal: tuple[float, float, float], at_mm: float) -> Field:
    """The half space where normal . p > at_mm."""
    i, j, k = np.array(normal) / np.linalg.norm(normal)
    return lambda x, y, s: at_mm - (i * x + j * y + k * s)


def fetal_organs(tissues: dict[str, Tissue], scale: float, seed: int) -> list[Structure]:
    """The soft organs of the trunk, in world mm, later ones owning where two overlap.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every grid spacing.
    seed : int
        Of the surface displacements.
    """

    def solid(field: Field, tissue: str, pitch_mm: float, name: str, coarsest_mm: float = 7.0) -> Structure:
        mesh = mesh_field(field, TRUNK_BOX, min(pitch_mm * scale, coarsest_mm), name)
        return Structure(trunk_to_world(mesh), tissues[tissue])

    heart = rippled(ellipsoid(HEART_CENTER, (12.0, 9.4, 9.4), HEART_AXES), seed, 0.25, 14.0)
    spine = ellipsoid((0.0, 21.0, -10.0), (9.0, 11.0, 62.0))
    liver = intersection(
        [
            shrunk(trunk, 6.8),
            outside(_above_diaphragm(-1.6)),
            _beyond((-0.60, -0.12, 0.79), -11.5),
            outside(spine),
        ],
        3.0,
    )
    stomach = rippled(ellipsoid((12.0, 1.0, -15.0), (6.3, 8.5, 8.0)), seed + 1, 0.4, 14.0)
    bladder = ellipsoid((0.0, -8.0, -46.0), (5.4, 5.0, 6.6))
    wall = intersection([shrunk(trunk, WALL_OUTSIDE_MM), _beyond((0.0, 0.0, 1.0), -52.0)], 2.0)
    inside = shrunk(trunk, WALL_INSIDE_MM)
    belly = intersection([inside, outside(_above_diaphragm(-0.6))], 2.0)
    chest = intersection([inside, _above_diaphragm(0.6), _beyond((0.0, 0.0, -1.0), -39.0)], 2.0)
    return [
        solid(wall, "muscle", 1.0, "trunk muscles and diaphragm"),
        solid(belly, "soft_tissue", 1.0, "abdominal contents"),
        solid(chest, "soft_tissue", 1.0, "mediastinum"),
        _lungs(tissues, min(0.85 * scale, 7.0), [outside(shrunk(heart, -1.3)), outside(spine)], seed + 2),
        solid(heart, "myocardium", 0.7, "heart"),
        _chambers(tissues, scale, seed),
        solid(rippled(liver, seed + 3, 0.25, 15.0), "liver", 0.85, "liver"),
        solid(shrunk(stomach, -1.1), "stomach_wall", 0.7, "stomach wall"),
        solid(stomach, "amniotic_fluid", 0.7, "stomach"),
        solid(ellipsoid((-8.0, -12.5, -17.5), (2.4, 3.0, 6.0)), "bile", 0.5, "gallbladder", 1.5),
        _pair("kidney", "kidneys", (10.8, 13.0, -27.5), (6.0, 5.6, 10.5), tissues, 0.65 * scale, seed + 4),
        _pair("urine", "renal pelves", (8.6, 12.0, -27.5), (1.6, 1.3, 3.4), tissues, min(0.4 * scale, 1.1), None),
        _pair("adrenal", "adrenals", (8.5, 11.5, -14.0), (3.6, 2.0, 3.0), tissues, min(0.5 * scale, 1.8), None),
        solid(shrunk(bladder, -0.9), "muscle", 0.6, "bladder wall"),
        solid(bladder, "urine", 0.6, "bladder"),
        _great_vessels(tissues, scale),
    ]


def _lungs(tissues: dict[str, Tissue], pitch_mm: float, spared: list[Field], seed: int) -> Structure:
    """Two lungs on the diaphragm, around heart and spine."""
    room = [
        shrunk(trunk, WALL_INSIDE_MM + 0.6),
        _above_diaphragm(1.4),
        _beyond((0.0, 0.0, -1.0), -36.0),
        *spared,
    ]
    meshes = []
    for side in (1.0, -1.0):
        field = rippled(intersection([*room, _beyond((side, 0.0, 0.0), 2.8)], 3.0), seed, 0.2, 12.0)
        meshes.append(mesh_field(field, TRUNK_BOX, pitch_mm, "lung"))
    return Structure(trunk_to_world(joined(meshes, "lungs")), tissues["lung"])


def _pair(
    tissue: str,
    name: str,
    center: tuple[float, float, float],
    radii: tuple[float, float, float],
    tissues: dict[str, Tissue],
    pitch_mm: float,
    seed: int | None,
) -> Structure:
    """An ellipsoid and its mirror image, as one structure."""
    meshes = []
    for side in (1.0, -1.0):
        field = ellipsoid((side * center[0], *center[1:]), radii)
        if seed is not None:
            field = rippled(field, seed, 0.3, 10.0)
        meshes.append(mesh_field(field, TRUNK_BOX, min(pitch_mm, 4.0), name))
    return Structure(trunk_to_world(joined(meshes, name)), tissues[tissue])


def _chambers(tissues: dict[str, Tissue], scale: float, seed: int) -> Structure:
    """Blood in two ventricles and two atria, apart by septa and valves."""
    meshes = [
        mesh_field(
            rippled(ellipsoid(HEART_CENTER + HEART_AXES @ np.array(center), radii, HEART_AXES), seed + i, 0.2, 9.0),
            TRUNK_BOX,
            min(0.5 * scale, 2.2),
            "chamber",
        )
        for i, (center, radii) in enumerate(CHAMBERS, start=60)
    ]
    return Structure(trunk_to_world(joined(meshes, "heart chambers")), tissues["blood"])


def spine_y(s: np.ndarray) -> np.ndarray:
    """Depth of the middle of the vertebral bodies at level s, mm."""
    _, depth, middle = outline(s)
    return middle + depth - 10.0


def _great_vessels(tissues: dict[str, Tissue], scale: float) -> Structure:
    """Aorta with its arch, inferior vena cava, and the umbilical vein's way through the liver."""
    sides = max(3, round(14 / scale))
    count = max(6, round(70 / scale))
    down = np.linspace(22.0, -36.0, 6)
    aorta = [(2.0, -1.0, 22.0), (1.5, 1.0, 28.0), (3.0, 6.0, 29.0)]
    aorta += [(3.2, float(spine_y(s)) - 5.4, float(s)) for s in down]
    cava = [(-4.2, float(spine_y(s)) - 5.6, float(s)) for s in np.linspace(-36.0, 4.0, 5)]
    vein = [
        (0.0, -24.0, -26.0),
        (-0.5, -17.0, -19.0),
        (-2.0, -10.0, -12.5),
        (-6.0, -5.0, -10.5),
        (-11.0, -4.0, -12.0),
    ]
    meshes = [
        tube(smooth_path(points, count), np.linspace(first, last, count), sides, up=(1.0, 0.2, 0.1))
        for points, first, last in ((aorta, 2.1, 1.5), (cava, 1.5, 1.8), (vein, 1.7, 1.4))
    ]
    return Structure(trunk_to_world(joined(meshes, "great vessels")), tissues["blood"])
