"""Inside of the fetal belly: wall, liver with the umbilical vein, stomach, kidneys, bladder. Straight trunk, mm."""

from __future__ import annotations

import numpy as np

from ablate.anatomy.fetal_frame import (
    TRUNK_BOX,
    WALL_INSIDE_MM,
    WALL_OUTSIDE_MM,
    above_diaphragm,
    from_trunk,
    spine_y,
    trunk,
)
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
from ablate.anatomy.sweep import joined, smooth_path, tube

#: The umbilical vein from the navel into the liver, where it turns to the right (the portal sinus): a J.
UMBILICAL_VEIN = (
    (0.0, -24.5, -27.0),
    (0.2, -19.5, -20.5),
    (0.4, -14.0, -17.4),
    (0.0, -8.5, -16.8),
    (-2.0, -3.8, -16.8),
    (-6.0, -1.2, -16.9),
    (-10.5, -0.8, -17.2),
    (-14.0, -2.2, -17.6),
)


def fetal_belly(tissues: dict[str, Tissue], scale: float, seed: int) -> list[Structure]:
    """The wall of the trunk and the organs of the belly in fetal axes, later ones owning where two overlap.

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
        return Structure(from_trunk(mesh), tissues[tissue])

    stomach = union(
        [ellipsoid((12.5, 2.5, -14.5), (6.0, 7.0, 7.5)), capsule((12.0, -2.0, -17.0), (5.5, -5.0, -20.0), 4.6, 2.6)],
        3.0,
    )
    stomach = rippled(stomach, seed + 1, 0.3, 14.0)
    liver = intersection(
        [
            shrunk(trunk, 6.8),
            outside(above_diaphragm(-1.6)),
            half_space((-0.45, -0.10, 0.89), -20.0),
            outside(ellipsoid((0.0, 21.0, -10.0), (9.0, 11.0, 62.0))),
            outside(shrunk(stomach, -2.2)),
        ],
        2.5,
    )
    bladder = ellipsoid((0.0, -8.0, -46.0), (5.4, 5.0, 6.6))
    wall = intersection([shrunk(trunk, WALL_OUTSIDE_MM), half_space((0.0, 0.0, 1.0), -52.0)], 2.0)
    belly = intersection([shrunk(trunk, WALL_INSIDE_MM), outside(above_diaphragm(-0.6))], 2.0)
    return [
        solid(wall, "muscle", 1.0, "trunk muscles and diaphragm"),
        solid(belly, "soft_tissue", 1.0, "abdominal contents"),
        solid(rippled(liver, seed + 3, 0.25, 15.0), "liver", 0.85, "liver"),
        solid(shrunk(stomach, -1.1), "stomach_wall", 0.7, "stomach wall"),
        solid(stomach, "amniotic_fluid", 0.7, "stomach"),
        solid(ellipsoid((-9.0, -13.0, -25.0), (2.4, 3.0, 6.0)), "bile", 0.5, "gallbladder", 1.5),
        _pair("kidney", "kidneys", (10.8, 13.0, -29.0), (6.0, 5.6, 10.5), tissues, 0.65 * scale, seed + 4),
        _pair("urine", "renal pelves", (8.6, 12.0, -29.0), (1.6, 1.3, 3.4), tissues, min(0.4 * scale, 1.1), None),
        _pair("adrenal", "adrenals", (8.5, 11.5, -14.0), (3.6, 2.0, 3.0), tissues, min(0.5 * scale, 1.8), None),
        solid(shrunk(bladder, -0.9), "muscle", 0.6, "fetal bladder wall"),
        solid(bladder, "urine", 0.6, "fetal bladder"),
        *_umbilical_vessels(tissues, scale),
    ]


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
    return Structure(from_trunk(joined(meshes, name)), tissues[tissue])


def _umbilical_vessels(tissues: dict[str, Tissue], scale: float) -> list[Structure]:
    """The vein's wall and blood, and the two arteries that run from the navel beside the bladder to the aorta."""
    sides, count = max(4, round(14 / scale)), max(8, round(60 / scale))
    vein = smooth_path(np.array(UMBILICAL_VEIN), count)
    radius = np.linspace(2.3, 1.5, count)
    arteries = []
    for side in (1.0, -1.0):
        end = float(spine_y(-36.0)) - 5.4
        course = [(side * 1.8, -25.0, -29.5), (side * 5.6, -17.0, -38.5), (side * 7.6, -8.0, -45.0)]
        course += [(side * 8.4, 1.0, -45.0), (side * 4.0, end, -37.5)]
        arteries.append(tube(smooth_path(course, count), np.full(count, 0.9), sides, up=(1.0, 0.2, 0.1)))
    up = (1.0, 0.2, 0.1)
    return [
        Structure(
            from_trunk(joined([tube(vein, radius + 0.5, sides, up)], "umbilical vein wall")), tissues["vessel_wall"]
        ),
        Structure(from_trunk(joined([tube(vein[1:-1], radius[1:-1], sides, up)], "umbilical vein")), tissues["blood"]),
        Structure(from_trunk(joined(arteries, "umbilical arteries")), tissues["blood"]),
    ]
