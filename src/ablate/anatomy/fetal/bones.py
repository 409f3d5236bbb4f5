"""Bones of the fetus: spine, ribs and girdles of the trunk, face and base of the skull, arms and legs; mm."""

from itertools import product

import numpy as np
import trimesh

from ablate.anatomy.fetal.body import SIDES, Limb, Limbs, finger_rays, outline, spine_y
from ablate.anatomy.fetal.organs import EYE_CENTER
from ablate.anatomy.fetal.shapes import Part, joined, unit
from ablate.anatomy.fetal.tubes import rod, smooth_path, spindle, tube

FEMUR_MM = 39.0
FEMUR_RADIUS_MM = 2.8  # near its ends; its middle is a tenth of its length wide (assumed)
SCAPULA_DEPTH_MM = 2.3  # of its middle under the skin
RIB_DEPTH_MM = 4.2  # of a rib's middle under the skin
#: Angle from the back (degrees) that each of the twelve ribs reaches.
RIB_REACH_DEG = (95.0, 112.0, 122.0, 128.0, 130.0, 128.0, 124.0, 116.0, 106.0, 94.0, 74.0, 56.0)
#: Levels of the vertebrae, mm, from the head down, and the distance to the next one: cervical (lower six), thoracic,
#: lumbar, sacral. One is level with the stomach, where the abdominal circumference is taken.
THORACIC_S_MM = 38.5 - 4.3 * np.arange(12)
VERTEBRAE_S_MM = np.concatenate(
    [41.9 + 3.2 * np.arange(5, -1, -1), THORACIC_S_MM, -12.9 - 4.3 * np.arange(5), -34.2 - 3.9 * np.arange(5)]
)
CENTRUM_SHARE = 0.62  # of the distance between two vertebrae that is ossified


def trunk_bones(scale: float, seed: int) -> list[Part]:
    """Spinal canal and cord, vertebrae, ribs, shoulder blades, collar bones and pelvis, in the straight trunk.

    Vertebrae and ribs vary in place, size, calibre and tilt, as `seed` says.
    """
    sides = max(4, round(14 / scale))
    s = np.linspace(-50.0, 58.0, max(8, round(90 / scale)))
    canal = np.stack([0.0 * s, spine_y(s) + 4.9, s], axis=1)
    up = (1.0, 0.0, 0.0)
    around = np.interp(s, (-50.0, -36.0), (1.4, 2.4))
    cord = canal[10 * len(s) // 90 : -1]
    girdle_sides = max(4, round(12 / scale))
    generator = np.random.default_rng([seed, 5])
    centra, arches = _vertebrae(sides, generator)
    parts = [
        ("spinal canal", "csf", [tube(canal, around, sides, up)]),
        ("spinal cord", "brain", [tube(cord, np.linspace(0.8, 1.4, len(cord)), sides, up)]),
        ("fetal vertebral bodies", "fetal_bone", centra),
        ("fetal vertebral arches", "fetal_bone", arches),
        ("ribs", "fetal_bone", _ribs(scale, sides, generator)),
        ("scapulae", "fetal_bone", [_scapula(side, scale, girdle_sides) for side in SIDES[::-1]]),
        ("clavicles and pelvis", "fetal_bone", _girdles(girdle_sides)),
    ]
    return [Part(joined(meshes, name), tissue) for name, tissue, meshes in parts]


def _vertebrae(sides: int, generator: np.random.Generator) -> tuple[list[trimesh.Trimesh], list[trimesh.Trimesh]]:
    """Ossification centres of the vertebrae: blunt ones in their bodies, and two laminae each around the canal."""
    x = np.array([-1.0, -0.9, -0.6, 0.0, 0.6, 0.9, 1.0])
    blunt = np.array([0.45, 0.75, 1.0, 0.92, 1.0, 0.75, 0.45])
    lamina = np.array([0.6, 1.0, 0.8, 0.75, 0.7, 0.5])[:, None]
    bodies, arches = [], []
    for s, distance in zip(VERTEBRAE_S_MM, np.abs(np.gradient(VERTEBRAE_S_MM)), strict=True):
        y, size = float(spine_y(s)), float(np.interp(s, (-52.0, -36.0, -16.0, 20.0, 58.0), (0.55, 0.9, 1.1, 0.95, 0.8)))
        wide, high, deep = generator.normal(1.0, 0.07, 3).clip(0.85, 1.12) * size
        middle, tilt = s + generator.uniform(-0.15, 0.15), generator.uniform(-0.2, 0.2)
        path = np.stack([2.9 * wide * x, y + 0.5 * np.abs(x) ** 2, middle + tilt * x], axis=1)
        bodies.append(tube(path, blunt[:, None] * (CENTRUM_SHARE * distance / 2.0 * high / size, 2.1 * deep), sides))
        size = float(np.interp(s, (-52.0, -36.0), (0.6, 1.0)))
        for side in SIDES[::-1]:
            at, long, drop = generator.uniform((0.92 * size, 0.85, 0.2), (1.08 * size, 1.05, 0.9))
            bow = [(4.2 * at, y + 2.2, s), (4.6 * at, y + 4.4, s), (0.8, y + 3.2 + 5.4 * size * long, s - drop)]
            path = smooth_path(np.array(bow) * (side, 1.0, 1.0), len(lamina))
            arches.append(tube(path, lamina * (1.2 * at, 1.0), sides))
    return bodies, arches


def _ribs(scale: float, sides: int, generator: np.random.Generator) -> list[trimesh.Trimesh]:
    """Twelve ribs a side: from beside the spine around the chest, sinking to the front, the lower ones more."""
    ribs, sink = [], generator.uniform(0.9, 1.1, 2)  # of right and left
    for number, (side, steep) in product(range(12), zip(SIDES[::-1], sink, strict=True)):
        reach, calibre = RIB_REACH_DEG[number] + generator.uniform(-6.0, 6.0), generator.uniform(0.85, 1.1)
        angle = np.deg2rad(np.linspace(20.0, reach, max(5, round(44 / scale))))
        s = THORACIC_S_MM[number] - steep * (3.0 + 1.8 * number) * (angle / 2.2) ** 1.3
        s += 2.2 * np.clip(angle - 1.6, 0.0, None) + generator.uniform(-0.25, 0.25)
        width, depth, middle = (part - RIB_DEPTH_MM for part in outline(s))
        y = middle + RIB_DEPTH_MM + depth * np.cos(angle)
        swell = calibre * (1.0 + 0.12 * np.sin(3.0 * angle + generator.uniform(0.0, 6.0)))
        path = np.stack([side * width * np.sin(angle), y, s], axis=1)
        ribs.append(tube(path, swell[:, None] * (1.05, 0.75), sides))
    return ribs


def _scapula(side: float, scale: float, sides: int) -> trimesh.Trimesh:
    """A thin triangle, its tip down, that follows the back of the chest."""
    t = np.linspace(0.0, 1.0, max(6, round(24 / scale)))
    s, angle = 37.0 - 19.0 * t, np.deg2rad(47.0 - 7.0 * t)
    width, depth, middle = (part - SCAPULA_DEPTH_MM for part in outline(s))
    path = np.stack([side * width * np.sin(angle), middle + SCAPULA_DEPTH_MM + depth * np.cos(angle), s], axis=1)
    half = np.interp(t, (0.0, 0.06, 0.2, 1.0), (2.0, 4.0, 5.2, 1.2))
    radii = np.stack([np.full(len(t), 0.55), half], axis=1)
    return tube(path, radii, 2 * sides, up=(side * np.sin(angle[0]), np.cos(angle[0]), 0.0))


def _girdles(sides: int) -> list[trimesh.Trimesh]:
    """Collar bones, iliac wings, ischia and pubic bones."""
    bones = []
    for side in SIDES[::-1]:
        ilium = (side * 6.5, 11.5, -39.0), (side * 15.5, 1.0, -41.0)
        bones += [
            rod((side * 4.0, -13.0, 37.0), (side * 16.5, -4.5, 39.5), 1.1, sides, 1.2),
            spindle(*ilium, (1.1, 5.2), sides, up=(side * 0.75, 0.65, 0.1)),
            spindle((side * 7.0, 4.5, -51.0), (side * 8.5, -1.5, -56.5), (1.5, 1.8), sides),
            rod((side * 2.0, -11.5, -52.5), (side * 7.0, -8.0, -50.5), 1.1, sides),
        ]
    return bones


def face_bones(scale: float) -> Part:
    """Jaws, nasal bone, walls of the orbits, and the X of the skull base, in the head's axes."""
    sides = max(4, round(12 / scale))
    turn = np.linspace(-1.0, 1.0, max(8, round(36 / scale)))
    jaw = np.stack([13.5 * np.sin(turn * 1.57), -33.5 + 20.0 * np.abs(turn) ** 2.2, -34.5 + 7.5 * turn**2], axis=1)
    upper = np.stack([10.5 * np.sin(turn * 1.57), -36.0 + 13.0 * np.abs(turn) ** 2.2, -26.5 + 0.0 * turn], axis=1)
    bones = [tube(path, np.full(len(turn), 1.2), sides) for path in (jaw, upper)]
    bones.append(spindle((0.0, -37.8, -17.5), (0.0, -39.6, -22.5), (0.7, 1.3), sides, up=(0.0, 1.0, -0.3)))
    for side in SIDES[::-1]:
        bones.append(rod((side * 5.0, 4.0, -20.5), (side * 17.5, 11.5, -17.5), 1.5, sides))
        bones.append(rod((side * 4.5, -6.5, -20.0), (side * 16.5, -18.5, -16.0), 1.2, sides))
        bones += [_orbit_wall(side, 5.6, 4.4, sides), _orbit_wall(side, -5.9, -5.3, sides)]
    return Part(joined(bones, "face and skull base"), "fetal_bone")


def _orbit_wall(side: float, rim_mm: float, end_mm: float, sides: int) -> trimesh.Trimesh:
    """A plate beside an eye, as far from its middle as given at the rim and behind."""
    x, y, z = EYE_CENTER
    path = [(side * (x + rim_mm), y + 2.0, z), (side * (x + rim_mm), y + 4.0, z), (side * (x + end_mm), y + 6.5, z)]
    count = max(5, sides)
    radii = np.stack([np.full(count, 0.5), np.linspace(3.4, 2.6, count)], axis=1)
    return tube(smooth_path(path, count), radii, 2 * sides, up=(side, 0.0, 0.0))


def limb_bones(scale: float, limbs: Limbs) -> list[Part]:
    """Epiphyses, femora, and the other bones of the limbs, in fetal axes."""
    sides = max(4, round(14 / scale))
    joints, femora, others = [], [], []
    for side in SIDES:
        leg, arm = limbs.leg(side), limbs.arm(side)
        for point, radius in ((leg.root, 4.0), (leg.bend, 4.2), (arm.root, 3.6), (arm.bend, 3.0)):
            lift = np.array([0.0, 0.0, radius])
            joints.append(spindle(point - lift, point + lift, (radius, radius), sides, up=(1.0, 0.0, 0.0)))
        along = unit(leg.bend - leg.root)
        start = leg.root + 4.0 * along
        femora.append(rod(start, start + FEMUR_MM * along, FEMUR_RADIUS_MM, sides, 0.3))
        others += _other_bones(side, leg, arm, sides)
    return [
        Part(joined(joints, "epiphyses"), "cartilage"),
        Part(joined(femora, "femora"), "fetal_bone"),
        Part(joined(others, "other limb bones"), "fetal_bone"),
    ]


def _other_bones(side: float, leg: Limb, arm: Limb, sides: int) -> list[trimesh.Trimesh]:
    """Tibia, fibula and metatarsals; humerus, radius, ulna and the digits of the hand."""
    reach = arm.bend - arm.root
    bones = [rod(arm.root + 0.06 * reach, arm.root + 0.94 * reach, 1.7, sides, 0.5)]
    for limb, radii in ((leg, (1.6, 0.9)), (arm, (1.1, 1.1))):
        along = limb.end - limb.bend
        apart = np.cross(along, (side, 0.4, 0.2))
        apart *= 1.9 / np.linalg.norm(apart)
        for way, first, radius in ((1.0, 0.10, radii[0]), (-1.0, 0.13, radii[1])):
            start = limb.bend + way * apart
            bones.append(rod(start + first * along, start + 0.92 * along, radius, sides, way * 0.4))
    for start, end in finger_rays(arm):
        bones.append(rod(start + 0.05 * (end - start), start + 0.8 * (end - start), 0.65, sides))
    along = leg.tip - leg.end
    across = unit(np.cross(along, leg.bend - leg.end))
    for spread in (-3.2, -1.1, 1.1, 3.2):
        start, end = leg.end + 0.45 * along + 0.6 * spread * across, leg.end + 0.85 * along + spread * across
        bones.append(rod(start, end, 0.6, sides))
    return bones
