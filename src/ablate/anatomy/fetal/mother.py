"""The mother's abdomen in the second trimester: wall, uterus, bladder, bowel, vessels, spine, placenta.

World frame in mm: x to her left, y to her back, z up; the navel is near (0, -133, 2). The placenta is a lobed disc on
the uterine wall, with vessels on its fetal face and lakes of blood in its lobes. Its directions are taken from the
middle of the uterus, in units of its radii, so that the wall is about a sphere of radius 1.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.fascia import SEMILUNAR_MM, fascia
from ablate.anatomy.fetal.shapes import Part, joined, solids_in, unit
from ablate.anatomy.fetal.tubes import smooth_path, spindle, tube

BODY_BOX: sdf.Bounds = ((-175.0, -150.0, -185.0), (175.0, 150.0, 185.0))
SKIN_MM = 2.0
MUSCLE_MM = 10.0
UTERUS_WALL_MM = 8.0
UTERUS_POWER = 2.5
STRETCH_MM = 12.0  # over which the wall bends from its egg to a fetus that stretches it
FILM_MM = 0.3  # of fluid between the fetus and what it lies on
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
_WALL_MM = 64.0  # mean distance of the wall from the middle
_NAVEL = (0.0, -133.0, 2.0)


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
    """Inner face of the abdominal wall, without its fat: two bellies of rectus beside a thin midline, obliques."""
    beside_midline = np.clip((np.abs(x) - 1.5) / 11.0, 0.0, 1.0)
    belly = 8.5 * beside_midline**2 * (3.0 - 2.0 * beside_midline)
    at_edge = -5.5 * np.exp(-(((np.abs(x) - SEMILUNAR_MM) / 8.0) ** 2))
    front = (y < 40.0) * (belly + at_edge) - 7.5
    return torso(x, y, z) + (SKIN_MM + MUSCLE_MM + front * np.exp(-np.maximum(y + 60.0, 0.0) / 40.0))


@dataclass(frozen=True, eq=False)
class Uterus:
    """The uterus behind the abdominal wall: an egg, which the fetus stretches where it lies on the wall."""

    seed: int  # of the surface displacements
    radii: np.ndarray  # (3,): of the egg's inside, mm
    placenta: np.ndarray  # (3,): unit direction of the placenta's middle, see `placenta_field`
    fat_mm: float  # under the mother's skin
    fetus: sdf.Field | None = None  # about the distance to it, mm; None before it has a place
    hull: sdf.Field | None = None  # about the distance to the fetus with its folds filled

    @property
    def center(self) -> np.ndarray:
        """Middle of the egg, (3,), mm: as far in front as the abdominal wall lets it."""
        front = SKIN_MM + self.fat_mm + MUSCLE_MM + UTERUS_WALL_MM
        return np.array((0.0, _NAVEL[1] + front + self.radii[1], 4.0))

    def in_wall(self) -> sdf.Field:
        """Inside of the wall 2 mm behind the muscles, where nothing may stretch it."""
        return sdf.shrunk(torso, SKIN_MM + self.fat_mm + MUSCLE_MM + 2.0 + UTERUS_WALL_MM)

    def cavity(self) -> sdf.Field:
        """Inner face of the wall: the space of the fluid, the placenta and the fetus."""
        egg = sdf.rippled(sdf.intersection([self._egg, self.in_wall()], 6.0), self.seed, 1.2, 70.0)
        hull = self.hull
        if hull is None:
            return egg

        def stretched(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
            to_hull = hull(x, y, z) - self.thickness(x, y, z)
            return np.minimum(sdf.smooth_min(egg(x, y, z), to_hull, STRETCH_MM), to_hull - FILM_MM)

        return stretched

    def opening(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Angle from the placenta's middle, 1 at its rim."""
        u, v, w = ((p - c) / r for p, c, r in zip((x, y, z), self.center, self.radii, strict=True))
        length = np.maximum(np.sqrt(u * u + v * v + w * w), 1e-3)
        cosine = (self.placenta[0] * u + self.placenta[1] * v + self.placenta[2] * w) / length
        return np.arccos(np.clip(cosine, -1.0, 1.0)) / np.deg2rad(REACH_DEG)

    def thickness(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """Thickness of the placenta on the wall in this direction, mm, without its grooves."""
        return THICKNESS_MM * np.maximum(1.0 - self.opening(x, y, z) ** 3, 0.0)

    def _egg(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        """A superellipsoid, fuller at its ends than an ellipsoid."""
        parts = [(np.abs(p - c) / r) for p, c, r in zip((x, y, z), self.center, self.radii, strict=True)]
        power = UTERUS_POWER
        level = sum(part**power for part in parts) ** (1.0 / power)
        slope = np.sqrt(sum((part ** (power - 1.0) / r) ** 2 for part, r in zip(parts, self.radii, strict=True)))
        return (level - 1.0) * level ** (power - 1.0) / (slope + 1e-3 / min(self.radii))


def mother(scale: float, uterus: Uterus) -> list[Part]:
    """Everything but placenta, cord and fetus, outermost first."""
    solid, seed, cavity = solids_in(BODY_BOX, scale), uterus.seed, uterus.cavity()
    outer = sdf.rippled(sdf.shrunk(cavity, -UTERUS_WALL_MM), seed + 1, 0.8, 45.0)  # face of the wall
    shape = sdf.ellipsoid((3.0, -70.0, -104.0), (38.0, 20.0, 22.0))  # a half-filled bladder, moulded to the uterus
    beside = sdf.outside(sdf.shrunk(outer, -5.5))
    bladder = sdf.rippled(sdf.intersection([shape, beside], 5.0), seed + 6, 0.6, 40.0)
    fat_inside = sdf.rippled(sdf.shrunk(torso, SKIN_MM + uterus.fat_mm), seed + 3, 1.0, 70.0)
    muscle_inside = sdf.rippled(sdf.shrunk(_muscle_inside, uterus.fat_mm), seed + 5, 0.5, 60.0)
    return [
        solid(torso, "skin", 4.4, "skin"),
        solid(sdf.rippled(sdf.shrunk(torso, SKIN_MM), seed + 4, 0.12, 40.0), "fat", 4.4, "subcutaneous fat"),
        solid(fat_inside, "muscle", 4.2, "abdominal wall"),
        solid(muscle_inside, "soft_tissue", 4.0, "abdominal cavity"),
        *fascia(scale, fat_inside, muscle_inside),
        *_back(scale, seed),
        *_bowel(scale, uterus),
        solid(outer, "uterine_wall", 2.4, "uterus"),
        solid(sdf.shrunk(bladder, -3.0), "muscle", 1.8, "bladder wall", 8.0),
        solid(bladder, "urine", 1.8, "bladder", 8.0),
        solid(cavity, "amniotic_fluid", 2.2, "amniotic cavity"),
    ]


def _bowel(scale: float, uterus: Uterus) -> list[Part]:
    """Loops of bowel beside the uterus, each with a pocket of gas."""
    pitch_mm, pockets = min(1.8 * scale, 8.0), []
    for i, (center, radius) in enumerate(GAS_POCKETS):
        pocket = sdf.ellipsoid(center, (radius, 1.1 * radius, 1.5 * radius))
        pockets.append(sdf.rippled(pocket, uterus.seed + 10 + i, 0.8, 3.0 * radius))
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


def placenta_field(uterus: Uterus) -> sdf.Field:
    """The placenta, thickest in its middle; it reaches 3 mm into the wall and yields to a fetus that lies on it."""
    inner, fetus = uterus.cavity(), uterus.fetus
    middles = lobes(uterus.seed, uterus.placenta).astype(np.float32)

    def face(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = ((p - c) / r for p, c, r in zip((x, y, z), uterus.center, uterus.radii, strict=True))
        length = np.maximum(np.sqrt(u * u + v * v + w * w), 1e-3)
        opening = uterus.opening(x, y, z)
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

    disc = sdf.intersection([sdf.rippled(face, uterus.seed + 2, 0.5, 20.0), sdf.shrunk(inner, -3.0)], 3.0)
    return disc if fetus is None else lambda x, y, z: np.maximum(disc(x, y, z), FILM_MM - fetus(x, y, z))


def placenta(scale: float, uterus: Uterus, insertion: np.ndarray) -> list[Part]:
    """Tissue, lakes of blood in the inner lobes, and vessels, which start at the cord's `insertion` (3,), mm."""
    field, seed, towards = placenta_field(uterus), uterus.seed, uterus.placenta
    lower = np.array(BODY_BOX[0]) * 0.75
    box: sdf.Bounds = (tuple(lower), tuple(-lower))
    sides = max(3, round(12 / scale))
    inner = lobes(seed, towards)
    inner = inner[inner @ towards > np.cos(np.deg2rad(0.72 * REACH_DEG))]
    sizes = np.random.default_rng([seed, 3]).uniform(2.0, 4.0, len(inner))  # half lengths, mm
    lakes = []
    for direction, size in zip(inner, sizes, strict=True):
        on_face = face_points(uterus, field, direction[None])[0]
        outward = unit(direction * uterus.radii)
        middle = on_face + 0.45 * THICKNESS_MM * outward
        lakes.append(spindle(middle - size * outward, middle + size * outward, (0.7 * size, 0.6 * size), sides))
    return [
        Part(sdf.mesh_field(field, box, 1.6 * scale, "placenta"), "placenta"),
        Part(joined(lakes, "placental lakes"), "blood"),
        Part(joined(_vessels(uterus, field, insertion, sides, scale), "placental vessels"), "blood"),
    ]


def face_points(uterus: Uterus, field: sdf.Field, directions: np.ndarray) -> np.ndarray:
    """Where rays from the middle of the uterus, along directions (n, 3), meet the fetal face; (n, 3), mm."""
    along = np.linspace(0.1, 2.6, 251)
    points = uterus.center + along[:, None, None] * directions * uterus.radii
    value = field(*np.moveaxis(points, -1, 0))
    first = np.maximum(np.argmax(value < 0.0, axis=0), 1)
    ray = np.arange(len(directions))
    share = value[first - 1, ray] / (value[first - 1, ray] - value[first, ray])
    return points[first - 1, ray] + share[:, None] * (points[first, ray] - points[first - 1, ray])


def _vessels(
    uterus: Uterus, field: sdf.Field, insertion: np.ndarray, sides: int, scale: float
) -> list[trimesh.Trimesh]:
    """Branches from the cord's insertion, first under the fetal face and then into the lobes, but not to the rim."""
    center = unit((insertion - uterus.center) / uterus.radii)
    count = max(6, round(40 / scale))
    routes = []
    for k in range(6):
        polar = np.linspace(0.17, 0.17 + np.deg2rad(REACH_DEG) * (0.5, 0.36)[k % 2], 40)
        along = from_middle(center, polar, 2.0 * np.pi * k / 6 + 0.35 * (-1.0) ** k * (polar - 0.17))
        along = along[: np.argmax(np.append(along @ uterus.placenta < np.cos(np.deg2rad(0.7 * REACH_DEG)), True))]
        if len(along) >= 8:
            depth = 5.0 + 7.0 * np.linspace(0.0, 1.0, len(along)) ** 4
            path = face_points(uterus, field, along) + depth[:, None] * unit(along * uterus.radii)
            routes.append(smooth_path(path[:: len(along) // 5], 40))
    kept: list[np.ndarray] = []  # the straightest, and what turns wide and keeps away from the others
    for path in sorted(routes, key=_sharpest_bend):
        apart = [np.linalg.norm(path[:, None] - other, axis=2).min() for other in kept]
        if not kept or (_sharpest_bend(path) < 0.5 and min(apart) > 4.0):
            kept.append(path)
    return [tube(smooth_path(path, count), np.linspace(1.3, 0.7, count), sides) for path in kept]


def _sharpest_bend(path: np.ndarray) -> float:
    """Largest curvature of a path (n, 3), 1/mm."""
    steps = np.diff(path, axis=0)
    return float((np.linalg.norm(np.diff(unit(steps), axis=0), axis=1) / np.linalg.norm(steps[1:], axis=1)).max())
