"""Bones of the fetal trunk, face and limbs: spine, ribs, girdles, long bones."""

from __future__ import annotations

import numpy as np
import trimesh

from ablate.anatomy.fetal_frame import curl, fetus_to_world, head_to_world, outline, trunk_to_world
from ablate.anatomy.fetal_organs import spine_y
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, rod, spindle, tube

FEMUR_MM = 39.0
RIB_DEPTH_MM = 4.2  # of a rib's middle under the skin
#: Angle from the back (degrees) that each of the twelve ribs reaches.
RIB_REACH_DEG = (95.0, 112.0, 122.0, 128.0, 130.0, 128.0, 124.0, 116.0, 106.0, 94.0, 74.0, 56.0)
#: Levels of the vertebrae in the trunk, mm: cervical (lower), thoracic, lumbar, sacral.
VERTEBRAE_S_MM = np.concatenate(
    [
        np.arange(54.0, 41.0, -3.3),
        np.arange(38.0, -6.0, -3.9),
        np.arange(-9.5, -30.0, -4.6),
        np.arange(-32.8, -52.0, -4.2),
    ]
)
RIBS_S_MM = np.arange(38.0, -6.0, -3.9)

#: One limb: joints in fetal axes (mm) from the body outwards; index 0 is its root.
Limb = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def _unit(vector: tuple[float, float, float]) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def leg(side: float) -> Limb:
    """Hip, knee, ankle and toes of the left (+1) or right (-1) leg; hips and knees are bent."""
    hip = curl(np.array([[side * 12.0, -1.0, -47.0]]))[0]
    knee = hip + 46.0 * _unit((side * 0.14, -0.80, 0.56 if side > 0 else 0.42))
    ankle = knee + 41.0 * _unit((-side * 0.45, 0.42 if side > 0 else 0.25, -0.80))
    toes = ankle + 24.0 * _unit((side * 0.1, -0.9, -0.35))
    return hip, knee, ankle, toes


def arm(side: float) -> Limb:
    """Shoulder, elbow, wrist and finger tips of the left (+1) or right (-1) arm, folded before the chest."""
    shoulder = curl(np.array([[side * 24.0, 1.0, 36.0]]))[0]
    elbow = shoulder + 40.0 * _unit((side * 0.02, -0.55, -0.83))
    wrist = elbow + 34.0 * _unit((-side * 0.35, -0.78, 0.52 if side > 0 else 0.1))
    tips = wrist + 19.0 * _unit((-side * 0.5, -0.35, 0.8))
    return shoulder, elbow, wrist, tips


def fetal_skeleton(tissues: dict[str, Tissue], scale: float) -> list[Structure]:
    """Every bone but the skull's vault, in world mm.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every spacing along and around a bone.
    """
    sides = max(3, round(12 / scale))
    bone, fluid, cord, gristle = (tissues[name] for name in ("fetal_bone", "csf", "brain", "cartilage"))
    s = np.linspace(-46.0, 57.0, max(8, round(90 / scale)))
    canal = np.stack([0.0 * s, spine_y(s) + 4.9, s], axis=1)
    up = (1.0, 0.0, 0.0)
    return [
        Structure(trunk_to_world(_named(tube(canal, np.full(len(s), 2.4), sides, up), "spinal canal")), fluid),
        Structure(
            trunk_to_world(_named(tube(canal[2:-1], np.linspace(0.9, 1.4, len(s) - 3), sides, up), "spinal cord")),
            cord,
        ),
        Structure(trunk_to_world(joined(_centra(sides), "vertebral bodies")), bone),
        Structure(trunk_to_world(joined(_arches(sides), "vertebral arches")), bone),
        Structure(
            trunk_to_world(joined([_rib(i, side, scale, sides) for i in range(12) for side in (-1, 1)], "ribs")),
            bone,
        ),
        Structure(trunk_to_world(joined(_girdles(sides), "scapulae, clavicles and pelvis")), bone),
        Structure(head_to_world(joined(_face(scale, sides), "face and skull base")), bone),
        Structure(fetus_to_world(joined(_epiphyses(sides), "epiphyses")), gristle),
        Structure(fetus_to_world(joined([_femur(side, sides) for side in (-1, 1)], "femora")), bone),
        Structure(fetus_to_world(joined(_other_long_bones(sides) + _hands_and_feet(sides), "other limb bones")), bone),
    ]


def _named(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    mesh.metadata["name"] = name
    return mesh


def _centra(sides: int) -> list[trimesh.Trimesh]:
    """One ossification centre a vertebra, in its body."""
    bodies = []
    for s in VERTEBRAE_S_MM:
        y, radius = float(spine_y(s)), 1.9 + 0.5 * np.exp(-(((s + 14.0) / 18.0) ** 2))
        bodies.append(spindle((-1.25 * radius, y, s), (1.25 * radius, y, s), (1.35, radius), sides))
    return bodies


def _arches(sides: int) -> list[trimesh.Trimesh]:
    """Two ossification centres a vertebra, either side of the canal."""
    arches = []
    for s in VERTEBRAE_S_MM:
        y = float(spine_y(s))
        for side in (-1.0, 1.0):
            arches.append(spindle((side * 4.6, y + 2.9, s), (side * 1.9, y + 8.0, s), (1.1, 0.9), sides))
    return arches


def _rib(number: int, side: float, scale: float, sides: int) -> trimesh.Trimesh:
    """A rib: from beside the spine around the chest, sinking towards the front."""
    angle = np.deg2rad(np.linspace(21.0, RIB_REACH_DEG[number], max(5, round(44 / scale))))
    s = RIBS_S_MM[number] - 9.5 * (angle / 2.2) ** 1.3 + 2.2 * np.clip(angle - 1.6, 0.0, None)
    width, depth, middle = outline(s)
    under = RIB_DEPTH_MM
    path = np.stack([side * (width - under) * np.sin(angle), middle + (depth - under) * np.cos(angle), s], axis=1)
    return tube(path, np.linspace(1.0, 0.85, len(path)), sides)


def _girdles(sides: int) -> list[trimesh.Trimesh]:
    """Shoulder blades, collar bones, iliac wings and ischia."""
    bones = []
    for side in (-1.0, 1.0):
        bones += [
            spindle(
                (side * 17.0, 17.5, 38.0),
                (side * 15.0, 20.2, 20.0),
                (0.8, 4.6),
                sides,
                up=(side * 0.55, 0.8, 0.0),
            ),
            rod((side * 4.5, -13.5, 38.0), (side * 19.5, -6.0, 41.5), 1.1, sides, 1.5),
            spindle(
                (side * 6.5, 11.5, -37.0),
                (side * 15.5, 1.0, -39.0),
                (1.1, 5.2),
                sides,
                up=(side * 0.75, 0.65, 0.1),
            ),
            spindle((side * 7.0, 4.5, -51.0), (side * 8.5, -1.5, -56.5), (1.5, 1.8), sides),
        ]
    return bones


def _face(scale: float, sides: int) -> list[trimesh.Trimesh]:
    """Lower jaw, upper jaw, nasal bone and the X of the skull base, in the head's axes."""
    turn = np.linspace(-1.0, 1.0, max(8, round(36 / scale)))
    jaw = np.stack([15.0 * np.sin(turn * 1.57), -33.5 + 21.0 * np.abs(turn) ** 2.2, -36.5 + 8.0 * turn**2], axis=1)
    upper = np.stack([10.5 * np.sin(turn * 1.57), -36.0 + 13.0 * np.abs(turn) ** 2.2, -26.5 + 0.0 * turn], axis=1)
    bones = [
        tube(jaw, np.full(len(turn), 1.2), sides),
        tube(upper, np.full(len(turn), 1.2), sides),
        spindle((0.0, -37.8, -17.5), (0.0, -39.6, -22.5), (0.7, 1.3), sides, up=(0.0, 1.0, -0.3)),
    ]
    for side in (-1.0, 1.0):
        bones.append(rod((side * 5.0, 4.0, -20.5), (side * 17.5, 11.5, -17.5), 1.5, sides))
        bones.append(rod((side * 4.5, -6.5, -20.0), (side * 16.5, -18.5, -16.0), 1.2, sides))
    return bones


def _femur(side: float, sides: int) -> trimesh.Trimesh:
    hip, knee, _, _ = leg(side)
    along = (knee - hip) / np.linalg.norm(knee - hip)
    start = hip + 4.0 * along
    return rod(start, start + FEMUR_MM * along, 2.1, sides, 0.8)


def _epiphyses(sides: int) -> list[trimesh.Trimesh]:
    """Cartilage at hips, knees, shoulders and elbows."""
    joints = []
    for side in (-1.0, 1.0):
        hip, knee, _, _ = leg(side)
        shoulder, elbow, _, _ = arm(side)
        for point, radius in ((hip, 4.0), (knee, 4.2), (shoulder, 3.6), (elbow, 3.0)):
            lift = np.array([0.0, 0.0, radius])
            joints.append(spindle(point - lift, point + lift, (radius, radius), sides, up=(1.0, 0.0, 0.0)))
    return joints


def _other_long_bones(sides: int) -> list[trimesh.Trimesh]:
    """Tibia and fibula, humerus, radius and ulna of both sides."""
    bones = []
    for side in (-1.0, 1.0):
        _, knee, ankle, _ = leg(side)
        shoulder, elbow, wrist, _ = arm(side)
        bones.append(rod(shoulder + 0.06 * (elbow - shoulder), shoulder + 0.94 * (elbow - shoulder), 1.7, sides, 0.5))
        for start, end, radii in ((knee, ankle, (1.6, 0.9)), (elbow, wrist, (1.1, 1.1))):
            along = end - start
            apart = np.cross(along, (side, 0.4, 0.2))
            apart *= 1.9 / np.linalg.norm(apart)
            bones.append(rod(start + 0.10 * along + apart, start + 0.92 * along + apart, radii[0], sides, 0.4))
            bones.append(rod(start + 0.13 * along - apart, start + 0.92 * along - apart, radii[1], sides, -0.4))
    return bones


def finger_rays(side: float) -> list[tuple[np.ndarray, np.ndarray]]:
    """Start and end of the five digits of a hand, in fetal axes, mm."""
    _, elbow, wrist, tips = arm(side)
    along = tips - wrist
    across = np.cross(along, wrist - elbow)
    across /= np.linalg.norm(across)
    rays = []
    for digit, (spread, length) in enumerate(((-6.5, 0.62), (-3.2, 0.95), (0.0, 1.0), (3.1, 0.95), (6.0, 0.8))):
        start = wrist + (0.2 if digit == 0 else 0.42) * along + 0.7 * spread * across
        rays.append((start, wrist + length * along + 1.25 * spread * across))
    return rays


def _hands_and_feet(sides: int) -> list[trimesh.Trimesh]:
    """Digits of the hands, and metatarsals and heel of the feet."""
    bones = []
    for side in (-1.0, 1.0):
        for start, end in finger_rays(side):
            bones.append(rod(start + 0.05 * (end - start), start + 0.8 * (end - start), 0.65, sides))
        _, _, ankle, toes = leg(side)
        along = toes - ankle
        across = np.cross(along, (0.0, 0.3, 1.0))
        across /= np.linalg.norm(across)
        for spread in (-3.2, -1.1, 1.1, 3.2):
            bones.append(
                rod(
                    ankle + 0.45 * along + 0.6 * spread * across,
                    ankle + 0.85 * along + spread * across,
                    0.6,
                    sides,
                )
            )
    return bones
