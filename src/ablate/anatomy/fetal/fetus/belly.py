"""Wall of the fetal trunk and the organs of its belly. Straight trunk (x, y, s), mm."""

import numpy as np

from ablate.anatomy.fetal.fetus.axes import (
    SIDES,
    TRUNK_BOX,
    WALL_INSIDE_MM,
    WALL_OUTSIDE_MM,
    above_diaphragm,
    spine_y,
    trunk,
)  # fmt: skip
from ablate.anatomy.fetal.part import Part
from ablate.anatomy.shapes import sdf
from ablate.anatomy.shapes.tubes import joined, smooth_path, tube
from ablate.anatomy.shapes.vectors import Vector

#: x, y and s of the umbilical vein, from the navel into the liver, where it turns to the right (the portal sinus).
UMBILICAL_VEIN = (
    (0.0, 0.2, 0.4, 0.0, -2.0, -6.0, -10.5, -14.0),
    (-24.5, -19.5, -14.0, -8.5, -3.8, -1.2, -0.8, -2.2),
    (-27.0, -20.5, -17.4, -16.8, -16.8, -16.9, -17.2, -17.6),
)


def fetal_belly(scale: float, seed: int) -> list[Part]:
    """The wall of the trunk and the organs of the belly, outermost first."""

    def solid(field: sdf.Field, tissue: str, pitch_mm: float, name: str, coarsest_mm: float = 7.0) -> Part:
        return Part(sdf.mesh_field(field, TRUNK_BOX, min(pitch_mm * scale, coarsest_mm), name), tissue)

    pylorus = sdf.capsule((12.0, -2.0, -17.0), (5.5, -5.0, -20.0), 4.6, 2.6)
    stomach = sdf.union([sdf.ellipsoid((12.5, 2.5, -14.5), (6.0, 7.0, 7.5)), pylorus], 3.0)
    stomach = sdf.rippled(stomach, seed + 1, 0.3, 14.0)
    liver = sdf.intersection(
        [
            sdf.shrunk(trunk, 6.8),
            sdf.outside(above_diaphragm(-1.6)),
            sdf.half_space((-0.45, -0.10, 0.89), -20.0),
            sdf.outside(sdf.ellipsoid((0.0, 21.0, -10.0), (9.0, 11.0, 62.0))),
            sdf.outside(sdf.shrunk(stomach, -2.2)),
        ],
        2.5,
    )
    bladder = sdf.ellipsoid((0.0, -8.0, -46.0), (5.4, 5.0, 6.6))
    wall = sdf.intersection([sdf.shrunk(trunk, WALL_OUTSIDE_MM), sdf.half_space((0.0, 0.0, 1.0), -52.0)], 2.0)
    belly = sdf.intersection([sdf.shrunk(trunk, WALL_INSIDE_MM), sdf.outside(above_diaphragm(-0.6))], 2.0)
    return [
        solid(wall, "muscle", 1.0, "trunk muscles and diaphragm"),
        solid(belly, "soft_tissue", 1.0, "abdominal contents"),
        solid(sdf.rippled(liver, seed + 3, 0.25, 15.0), "liver", 0.85, "liver"),
        solid(sdf.shrunk(stomach, -1.1), "stomach_wall", 0.7, "stomach wall"),
        solid(stomach, "amniotic_fluid", 0.7, "stomach"),
        solid(sdf.ellipsoid((-9.0, -13.0, -25.0), (2.4, 3.0, 6.0)), "bile", 0.5, "gallbladder", 1.5),
        _pair("kidney", "kidneys", (10.8, 13.0, -29.0), (6.0, 5.6, 10.5), 0.65 * scale, seed + 4),
        _pair("urine", "renal pelves", (8.6, 12.0, -29.0), (1.6, 1.3, 3.4), min(0.4 * scale, 1.1)),
        _pair("adrenal", "adrenals", (8.5, 11.5, -14.0), (3.6, 2.0, 3.0), min(0.5 * scale, 1.8)),
        solid(sdf.shrunk(bladder, -0.9), "muscle", 0.6, "fetal bladder wall"),
        solid(bladder, "urine", 0.6, "fetal bladder"),
        *_umbilical_vessels(scale),
    ]


def _pair(tissue: str, name: str, center: Vector, radii: Vector, pitch_mm: float, seed: int | None = None) -> Part:
    """An ellipsoid and its mirror image as one part."""
    meshes = []
    for side in SIDES:
        field = sdf.ellipsoid((side * center[0], *center[1:]), radii)
        if seed is not None:
            field = sdf.rippled(field, seed, 0.3, 10.0)
        meshes.append(sdf.mesh_field(field, TRUNK_BOX, min(pitch_mm, 4.0), name))
    return Part(joined(meshes, name), tissue)


def _umbilical_vessels(scale: float) -> list[Part]:
    """The vein's wall and blood, and the two arteries that run from the navel beside the bladder to the aorta."""
    sides, count = max(4, round(14 / scale)), max(8, round(60 / scale))
    up = (1.0, 0.2, 0.1)
    vein = smooth_path(np.transpose(UMBILICAL_VEIN), count)
    radius = np.linspace(2.3, 1.5, count)
    end = float(spine_y(-36.0)) - 5.4
    arteries = []
    for side in SIDES:
        course = [(side * 1.8, -25.0, -29.5), (side * 5.6, -17.0, -38.5), (side * 7.6, -8.0, -45.0)]
        course += [(side * 8.4, 1.0, -45.0), (side * 4.0, end, -37.5)]
        arteries.append(tube(smooth_path(course, count), np.full(count, 0.9), sides, up))
    return [
        Part(joined([tube(vein, radius + 0.5, sides, up)], "umbilical vein wall"), "vessel_wall"),
        Part(joined([tube(vein[1:-1], radius[1:-1], sides, up)], "umbilical vein"), "blood"),
        Part(joined(arteries, "umbilical arteries"), "blood"),
    ]
