"""Organs of belly and chest and the wall of the trunk, in the straight trunk; the inside of the head, in its axes."""

import numpy as np
import trimesh

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.body import (
    SIDES,
    TRUNK_BOX,
    WALL_INSIDE_MM,
    WALL_OUTSIDE_MM,
    above_diaphragm,
    inside_muscles,
    spine_y,
    trunk,
)
from ablate.anatomy.fetal.heart import heart, heart_muscle
from ablate.anatomy.fetal.shapes import Part, Vector, joined, solids_in
from ablate.anatomy.fetal.tubes import interpolated, smooth_path, tube

#: x, y and s of the umbilical vein, from the navel into the liver, where it turns to the right (the portal sinus).
UMBILICAL_VEIN = (
    (0.0, 0.2, 0.4, 0.0, -2.0, -6.0, -10.5, -14.0),
    (-24.5, -19.5, -14.0, -8.5, -3.8, -1.2, -0.8, -2.2),
    (-27.0, -20.5, -17.4, -16.8, -16.8, -16.9, -17.2, -17.6),
)
HEAD_BOX: sdf.Bounds = ((-45.0, -55.0, -50.0), (45.0, 50.0, 45.0))
SKULL_RADII = (27.0, 36.35, 29.0)  # BPD 54 mm, HC 200 mm, outer edge to outer edge
SKULL_MM = 0.8
FALX_MM = 1.0
EYE_CENTER = (11.8, -31.0, -17.5)  # of the left one


def fetal_belly(scale: float, seed: int) -> list[Part]:
    """The wall of the trunk and the organs of the belly, outermost first."""
    solid = solids_in(TRUNK_BOX, scale, 7.0)
    pylorus = sdf.capsule((12.0, -2.0, -17.0), (5.5, -5.0, -20.0), 4.6, 2.6)
    stomach = sdf.union([sdf.ellipsoid((12.5, 2.5, -14.5), (6.0, 7.0, 7.5)), pylorus], 3.0)
    stomach = sdf.rippled(stomach, seed + 1, 0.3, 14.0)
    below = sdf.outside(above_diaphragm(-0.6))
    belly = sdf.rippled(sdf.intersection([inside_muscles, below], 2.0), seed + 11, 0.35, 15.0)
    liver = sdf.intersection(
        [
            sdf.rippled(sdf.shrunk(trunk, WALL_INSIDE_MM + 0.7), seed + 11, 0.35, 15.0),
            sdf.outside(above_diaphragm(-1.6)),
            sdf.half_space((-0.45, -0.10, 0.89), -20.0),
            sdf.outside(sdf.ellipsoid((0.0, 21.0, -10.0), (9.0, 11.0, 62.0))),
            sdf.outside(sdf.shrunk(stomach, -2.2)),
        ],
        2.5,
    )
    bladder = sdf.ellipsoid((0.0, -8.0, -46.0), (5.4, 5.0, 6.6))
    wall = sdf.intersection([sdf.shrunk(trunk, WALL_OUTSIDE_MM), sdf.half_space((0.0, 0.0, 1.0), -52.0)], 2.0)
    return [
        solid(sdf.rippled(wall, seed + 10, 0.35, 18.0), "muscle", 1.0, "trunk muscles and diaphragm"),
        solid(belly, "soft_tissue", 1.0, "abdominal contents"),
        solid(sdf.rippled(liver, seed + 3, 0.2, 13.0), "liver", 0.85, "liver"),
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
    """An ellipsoid of the trunk and its mirror image as one part."""
    fields = [sdf.ellipsoid((side * center[0], *center[1:]), radii) for side in SIDES]
    if seed is not None:
        fields = [sdf.rippled(field, seed, 0.3, 10.0) for field in fields]
    return sdf.several(tissue, name, fields, TRUNK_BOX, min(pitch_mm, 4.0))


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


def fetal_chest(scale: float, seed: int) -> list[Part]:
    """The organs of the chest, outermost first."""
    solid = solids_in(TRUNK_BOX, scale, 7.0)
    below_neck = sdf.half_space((0.0, 0.0, -1.0), -39.0)
    room = sdf.intersection([inside_muscles, above_diaphragm(0.6), below_neck], 2.0)
    return [
        solid(room, "soft_tissue", 1.0, "mediastinum"),
        _lungs(min(0.85 * scale, 7.0), sdf.outside(sdf.shrunk(heart_muscle(seed), -1.0)), seed + 2),
        *heart(scale, seed),
        *_great_vessels(scale),
    ]


def _lungs(pitch_mm: float, beside_heart: sdf.Field, seed: int) -> Part:
    """Two lungs on the diaphragm, around heart and spine."""
    room = [
        sdf.shrunk(trunk, WALL_INSIDE_MM + 0.6),
        above_diaphragm(1.4),
        sdf.half_space((0.0, 0.0, -1.0), -36.0),
        beside_heart,
        sdf.outside(sdf.ellipsoid((0.0, 21.0, -10.0), (9.0, 11.0, 62.0))),
    ]
    halves = [sdf.intersection([*room, sdf.half_space((side, 0.0, 0.0), 2.8)], 3.0) for side in SIDES]
    return sdf.several("lung", "lungs", [sdf.rippled(half, seed, 0.2, 12.0) for half in halves], TRUNK_BOX, pitch_mm)


def _great_vessels(scale: float) -> list[Part]:
    """Aorta with its arch, both venae cavae; the pulmonary trunk, which the duct joins to the aorta."""
    sides, count = max(4, round(14 / scale)), max(6, round(70 / scale))
    aorta = [(0.5, -1.5, 23.0), (0.8, -2.0, 28.0), (2.2, 2.0, 32.0), (3.2, 6.5, 28.5)]
    aorta += [(3.2, float(spine_y(s)) - 5.4, float(s)) for s in np.linspace(23.0, -36.0, 6)]
    lower = [(-4.2, float(spine_y(s)) - 5.6, float(s)) for s in np.linspace(-36.0, 2.0, 5)]
    upper = [(-5.6, -2.0, 38.0), (-5.8, -1.0, 31.0), (-5.6, 0.5, 24.0)]
    pulmonary = [(3.0, -8.5, 23.0), (4.6, -5.5, 27.0), (5.6, 0.0, 27.0), (5.2, 5.5, 23.5)]
    vessels = [
        tube(smooth_path(points, count), np.linspace(first, last, count), sides, up=(1.0, 0.2, 0.1))
        for points, first, last in ((aorta, 2.1, 1.6), (lower, 1.6, 1.9), (upper, 1.5, 1.6), (pulmonary, 2.0, 1.6))
    ]
    named = {"aorta and venae cavae": vessels[:3], "pulmonary trunk": vessels[3:]}
    return [Part(joined(meshes, name), "blood") for name, meshes in named.items()]


def fetal_head(scale: float, seed: int) -> list[Part]:
    """The head's contents, outermost first."""
    solid = solids_in(HEAD_BOX, scale, 7.0)
    skull = sdf.rippled(sdf.ellipsoid((0.0, 0.0, 0.0), SKULL_RADII), seed, 0.12, 30.0)
    generator = np.random.default_rng([seed, 7])
    wide, long = generator.uniform((5.5, 8.5), (8.0, 11.0))
    gap = sdf.ellipsoid((0.0, -17.5, 25.5), (wide, long, 6.0))  # from outside the skull into it
    bone = [sdf.shrunk(skull, -0.35), sdf.outside(sdf.shrunk(skull, SKULL_MM + 0.35))]
    fontanelle = sdf.intersection([gap, *bone], 0.3)
    cortex = sdf.rippled(sdf.shrunk(skull, SKULL_MM + 1.3), seed + 1, 0.35, 7.0)
    fissures = [sdf.outside(sdf.ellipsoid((s * 24.0, -4.0, -2.0), (4.5, 9.0, 3.0))) for s in SIDES[::-1]]
    brain = sdf.intersection([cortex, *fissures], 1.5)
    behind = sdf.ellipsoid((0.0, 22.0, -14.0), (15.0, 9.5, 8.5))
    cistern = sdf.intersection([behind, sdf.shrunk(skull, SKULL_MM + 0.7)], 1.0)
    cerebellum = sdf.union([sdf.ellipsoid((s * 6.6, 20.0, -13.5), (7.2, 5.8, 5.8)) for s in SIDES[::-1]], 4.0)
    cerebellum = sdf.intersection([cerebellum, sdf.shrunk(cistern, 1.0)], 1.0)
    cavum = sdf.box((0.0, -12.5, 1.0), (2.1, 4.4, 3.2), 1.2)
    third_ventricle = sdf.ellipsoid((0.0, 4.0, 0.0), (0.75, 5.6, 4.5))
    return [
        solid(skull, "fetal_bone", 0.95, "skull", 7.0),
        Part(joined(_sutures(scale, generator), "sutures"), "soft_tissue"),
        solid(fontanelle, "soft_tissue", 0.6, "anterior fontanelle", 2.0),
        solid(sdf.shrunk(skull, SKULL_MM), "csf", 0.95, "subarachnoid space", 7.0),
        solid(brain, "brain", 0.85, "brain", 7.0),
        solid(cistern, "csf", 0.7, "cisterna magna", 3.0),
        solid(cerebellum, "brain", 0.6, "cerebellum", 3.0),
        solid(_falx(skull), "falx", (0.35, 1.0, 1.0), "falx", (0.45, 7.0, 7.0)),
        solid(_thalami(), "thalamus", 0.55, "thalami", 2.5),
        solid(third_ventricle, "csf", (0.35, 0.6, 0.6), "third ventricle", (0.5, 1.5, 1.5)),
        solid(sdf.shrunk(cavum, -0.7), "falx", 0.5, "septa pellucida", 1.4),
        solid(cavum, "csf", 0.5, "cavum septi pellucidi", 1.4),
        *_ventricles(scale),
        *_eyes(scale),
    ]


def _falx(skull: sdf.Field) -> sdf.Field:
    """The sheet between the halves of the brain."""
    return sdf.intersection(
        [
            lambda x, y, z: np.abs(x) - FALX_MM / 2.0 + 0.0 * (y + z),
            sdf.shrunk(skull, SKULL_MM + 0.5),
            sdf.outside(sdf.ellipsoid((0.0, -0.5, -9.0), (40.0, 21.5, 14.0))),
            lambda x, y, z: -9.0 - z + 0.0 * (x + y),
        ],
        0.4,
    )


def _thalami() -> sdf.Field:
    """Two halves, which make a diamond in an axial plane."""
    halves = []
    for side in SIDES[::-1]:
        turn = np.deg2rad(side * 16.0)
        axes = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
        halves.append(sdf.ellipsoid((side * 5.2, 5.0, 0.0), (4.4, 8.2, 5.6), axes))
    return sdf.union(halves, 0.8)


def _eyes(scale: float) -> list[Part]:
    """Both eyes, and the lenses in them."""
    x, y, z = EYE_CENTER
    eyes = [sdf.ellipsoid((side * x, y, z), (5.2, 5.2, 5.2)) for side in SIDES[::-1]]
    lenses = [sdf.ellipsoid((side * x, y - 3.4, z), (1.6, 0.9, 1.6)) for side in SIDES[::-1]]
    return [
        sdf.several("csf", "eyes", eyes, HEAD_BOX, min(0.6 * scale, 3.2)),
        sdf.several("cartilage", "lenses", lenses, HEAD_BOX, min(0.35 * scale, 0.6)),
    ]


def _sutures(scale: float, generator: np.random.Generator) -> list[trimesh.Trimesh]:
    """Gaps of the skull: the coronal, sagittal and lambdoid sutures, wavy, which stop short of each other."""
    sides, count = max(4, round(10 / scale)), max(8, round(40 / scale))
    a, b, c = np.array(SKULL_RADII) - SKULL_MM / 2.0
    t = np.linspace(0.0, 1.0, count)
    lines = [np.stack([0.0 * t, -4.0 + 29.0 * t, np.full(count, 30.0)], axis=1)]
    for side in SIDES[::-1]:
        lines.append(np.stack([side * (8.0 + 19.0 * t), -14.5 - 2.0 * t, 24.0 - 30.0 * t], axis=1))
        lines.append(np.stack([side * (3.0 + 17.0 * t), 28.0 - 4.0 * t, 18.0 - 26.0 * t], axis=1))
    sutures = []
    for line in lines:
        line += 0.6 * np.sin(2.0 * np.pi * generator.uniform(3.0, 5.0) * t)[:, None] * generator.uniform(-1.0, 1.0, 3)
        path = line / np.linalg.norm(line / (a, b, c), axis=1, keepdims=True)
        radii = np.broadcast_to((SKULL_MM / 2.0 + 0.35, generator.uniform(1.0, 1.5)), (count, 2))
        sutures.append(tube(path, radii, sides, up=path[0] / np.array((a, b, c)) ** 2))
    return sutures


def _ventricles(scale: float) -> list[Part]:
    """Lateral ventricles with choroid plexus in their atria."""
    sides, count = max(3, round(14 / scale)), max(6, round(40 / scale))
    t = np.linspace(0.0, 1.0, 6)
    stations = np.array(
        [(4.5, -17.0, 5.0), (5.5, -9.0, 8.0), (7.5, 1.0, 9.0), (10.0, 11.0, 6.0), (11.0, 18.0, 1.0), (9.5, 24.0, -1.0)]
    )
    radii = np.array([0.9, 1.6, 1.9, 3.2, 3.2, 1.0])
    parts = []
    for name, tissue, first, last, share in (
        ("lateral ventricles", "csf", 0.0, 1.0, 1.0),
        ("choroid plexus", "vessel_wall", 0.42, 0.86, 0.66),
    ):
        along = np.linspace(first, last, count)
        path = interpolated(along, t, stations)
        radius = share * np.interp(along, t, radii)
        tubes = [tube(path * (side, 1.0, 1.0), radius, sides) for side in SIDES[::-1]]
        parts.append(Part(joined(tubes, name), tissue))
    return parts
