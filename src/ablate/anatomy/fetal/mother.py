"""The mother's abdomen in the second trimester: wall, uterus, bladder, bowel, vessels, spine, placenta.

World frame in mm: x to her left, y to her back, z up; the navel is near (0, -133, 2). The placenta is a lobed disc on
the uterine wall, with vessels on its fetal face and lakes of blood in its lobes. Its directions are taken from the
middle of the uterus, in units of its radii, so that the wall is about a sphere of radius 1.
"""

import numpy as np
import trimesh

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.shapes import Part, joined, smooth_path, solids_in, spindle, tube, unit

BODY_BOX: sdf.Bounds = ((-175.0, -150.0, -185.0), (175.0, 150.0, 185.0))
SKIN_MM = 2.0
FAT_MM = 15.0
MUSCLE_MM = 10.0
UTERUS_WALL_MM = 8.0
UTERUS_CENTER = (0.0, -33.0, 4.0)
UTERUS_RADII = (77.0, 64.0, 111.0)
UTERUS_POWER = 2.5
#: Centre and radius of each pocket of gas, mm; the bowel around it is 3 mm thick.
GAS_POCKETS = (
    ((105.0, -30.0, 66.0), 10.0), ((108.0, -12.0, 22.0), 8.0), ((104.0, -26.0, -34.0), 11.0),
    ((-104.0, -28.0, -56.0), 10.0), ((-107.0, -10.0, 10.0), 9.0), ((-104.0, -26.0, 66.0), 11.0),
)  # fmt: skip
THICKNESS_MM = 22.0
REACH_DEG = 50.0  # of the disc, seen from the middle of the uterus
LOBE_MM = 36.0  # from the middle of a lobe to the next one's, on the wall
GROOVE_MM = 3.2  # depth of the groove between two lobes
GOLDEN_ANGLE = 2.399963  # rad
_WALL_MM = 80.0  # mean distance of the wall from the middle
_RADII = np.array(UTERUS_RADII)


def torso(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """About the distance to the skin, mm, negative inside: an egg-shaped cylinder with a belly in front."""
    belly = np.exp(-(((z - 2.0) / 85.0) ** 2))
    width = 146.0 + 6.0 * belly
    front = 100.0 + 33.0 * belly
    depth = np.where(y < 0.0, front, 114.0)
    level = np.sqrt((x / width) ** 2 + (y / depth) ** 2)
    slope = np.sqrt((x / width**2) ** 2 + (y / depth**2) ** 2)
    around = sdf.first_order_distance(level, slope, front)
    return sdf.smooth_max(around, np.abs(z) - 170.0, 12.0)


def _muscle_inside(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Inner face of the abdominal wall: two bellies of rectus beside a thin midline, obliques at the flanks."""
    beside_midline = np.clip((np.abs(x) - 1.5) / 11.0, 0.0, 1.0)
    belly = 6.0 * beside_midline**2 * (3.0 - 2.0 * beside_midline)
    at_edge = -3.2 * np.exp(-(((np.abs(x) - 66.0) / 8.0) ** 2))
    front = (y < 40.0) * (belly + at_edge) - 5.0
    return torso(x, y, z) + (SKIN_MM + FAT_MM + MUSCLE_MM + front * np.exp(-np.maximum(y + 60.0, 0.0) / 40.0))


def _uterus(seed: int) -> sdf.Field:
    """Outer face of the uterus, held 2 mm behind the abdominal wall."""
    wall = SKIN_MM + FAT_MM + MUSCLE_MM + 2.0
    return sdf.rippled(sdf.intersection([_fundus, sdf.shrunk(torso, wall)], 6.0), seed, 1.0, 90.0)


def _fundus(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """A superellipsoid, fuller at its ends than an ellipsoid."""
    parts = [(np.abs(p - c) / r) for p, c, r in zip((x, y, z), UTERUS_CENTER, UTERUS_RADII, strict=True)]
    power = UTERUS_POWER
    level = sum(part**power for part in parts) ** (1.0 / power)
    slope = np.sqrt(sum((part ** (power - 1.0) / r) ** 2 for part, r in zip(parts, UTERUS_RADII, strict=True)))
    return (level - 1.0) * level ** (power - 1.0) / (slope + 1e-3 / min(UTERUS_RADII))


def cavity(seed: int) -> sdf.Field:
    """Inner face of the uterine wall: the space of the fluid, the placenta and the fetus."""
    return sdf.rippled(sdf.shrunk(_uterus(seed), UTERUS_WALL_MM), seed + 1, 0.7, 50.0)


def mother(scale: float, seed: int) -> list[Part]:
    """Everything but placenta, cord and fetus, outermost first."""
    solid = solids_in(BODY_BOX, scale)
    shape = sdf.ellipsoid((3.0, -70.0, -104.0), (38.0, 20.0, 22.0))  # a half-filled bladder, moulded to the uterus
    beside = sdf.outside(sdf.shrunk(_uterus(seed), -5.5))
    bladder = sdf.rippled(sdf.intersection([shape, beside], 5.0), seed + 6, 0.6, 40.0)
    fat_inside = sdf.rippled(sdf.shrunk(torso, SKIN_MM + FAT_MM), seed + 3, 1.0, 70.0)
    return [
        solid(torso, "skin", 4.4, "skin"),
        solid(sdf.rippled(sdf.shrunk(torso, SKIN_MM), seed + 4, 0.12, 40.0), "fat", 4.4, "subcutaneous fat"),
        solid(fat_inside, "muscle", 4.2, "abdominal wall"),
        solid(sdf.rippled(_muscle_inside, seed + 5, 0.5, 60.0), "soft_tissue", 4.0, "abdominal cavity"),
        *_back(scale, seed),
        *_bowel(scale, seed),
        solid(_uterus(seed), "uterine_wall", 2.4, "uterus"),
        solid(sdf.shrunk(bladder, -3.0), "muscle", 1.8, "bladder wall", 8.0),
        solid(bladder, "urine", 1.8, "bladder", 8.0),
        solid(cavity(seed), "amniotic_fluid", 2.2, "amniotic cavity"),
    ]


def _bowel(scale: float, seed: int) -> list[Part]:
    """Loops of bowel beside the uterus, each with a pocket of gas."""
    pitch_mm, pockets = min(1.8 * scale, 8.0), []
    for i, (center, radius) in enumerate(GAS_POCKETS):
        pocket = sdf.ellipsoid(center, (radius, 1.1 * radius, 1.5 * radius))
        pockets.append(sdf.rippled(pocket, seed + 10 + i, 0.8, 3.0 * radius))
    loops = [sdf.shrunk(pocket, -3.0) for pocket in pockets]
    return [
        sdf.several("stomach_wall", "bowel", loops, BODY_BOX, pitch_mm),
        sdf.several("gas", "bowel gas", pockets, BODY_BOX, pitch_mm),
    ]


def _back(scale: float, seed: int) -> list[Part]:
    """Psoas, back muscles, great vessels and the lumbar spine."""
    pitch = min(2.6 * scale, 12.0)
    muscles = [sdf.capsule((s * 42.0, 66.0, -130.0), (s * 34.0, 68.0, 110.0), 19.0, 13.0) for s in (-1, 1)]
    muscles += [sdf.capsule((s * 34.0, 84.0, -140.0), (s * 36.0, 84.0, 140.0), 15.0, 15.0) for s in (-1, 1)]
    back_muscles = sdf.rippled(sdf.union(muscles, 6.0), seed + 7, 0.8, 50.0)
    bodies, processes = [], []
    for level, z in enumerate(np.arange(-92.0, 100.0, 37.0)):
        radii = ((23.0, 17.5, 60.0), (60.0, 60.0, 14.0))
        body = sdf.intersection([sdf.ellipsoid((0.0, 69.0, z), r) for r in radii], 4.0)
        waist = sdf.outside(sdf.ellipsoid((0.0, 40.0, z), (30.0, 13.0, 11.0)))
        bodies.append(sdf.rippled(sdf.intersection([body, waist], 4.0), seed + 30 + level, 0.3, 20.0))
        arch = [
            sdf.capsule((0.0, 94.0, z - 2.0), (0.0, 102.0, z - 8.0), 3.5, 3.0),
            *(sdf.capsule((s * 15.0, 80.0, z), (s * 3.0, 95.0, z - 2.0), 4.0, 3.5) for s in (-1, 1)),
            *(sdf.capsule((s * 14.0, 84.0, z), (s * 36.0, 87.0, z + 2.0), 3.5, 2.5) for s in (-1, 1)),
        ]
        processes.append(sdf.union(arch, 3.0))
    sides = max(6, round(40 / scale))
    z = np.linspace(-120.0, 150.0, max(8, round(80 / scale)))
    aorta = np.stack([7.0 + 3.0 * np.sin(z / 60.0), np.full_like(z, 43.0), z], 1)
    cava = np.stack([-13.0 + 2.0 * np.sin(z / 50.0), np.full_like(z, 43.5), z], 1)
    up = (1.0, 0.0, 0.0)
    walls = [tube(path, np.full(len(z), r), sides, up) for path, r in ((aorta, 8.4), (cava, 9.0))]
    lumens = [tube(path[1:-1], np.full(len(z) - 2, r), sides, up) for path, r in ((aorta, 7.2), (cava, 8.3))]
    return [
        Part(sdf.mesh_field(back_muscles, BODY_BOX, pitch * 1.3, "back muscles"), "muscle"),
        Part(joined(walls, "aorta and cava walls"), "vessel_wall"),
        Part(joined(lumens, "aorta and cava"), "blood"),
        sdf.several("bone", "vertebral bodies", bodies, BODY_BOX, pitch),
        sdf.several("bone", "vertebral arches", processes, BODY_BOX, min(pitch, 5.5)),
    ]


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
