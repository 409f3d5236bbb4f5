"""Arms and legs of the fetus: how they are bent, their flesh, and their bones. Fetal axes, mm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import trimesh

from ablate.anatomy.fetal_frame import curl
from ablate.anatomy.implicit import Bounds, Field, capsule, mesh_field, rippled, shrunk, union
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, rod, spindle

FEMUR_MM = 39.0
LIMBS_BOX: Bounds = ((-100.0, -150.0, -160.0), (100.0, 100.0, 130.0))
SIDES = (1.0, -1.0)  # left, right


@dataclass(frozen=True)
class LimbPose:
    """Angles of one limb, degrees.

    Attributes
    ----------
    flexion_deg : float
        Of hip or shoulder, forwards; 0 hangs along the trunk.
    abduction_deg : float
        Away from the midline.
    bend_deg : float
        Of knee (backwards) or elbow (forwards); 0 is straight.
    inward_deg : float
        How far shin or forearm turn to the other side.
    """

    flexion_deg: float
    abduction_deg: float
    bend_deg: float
    inward_deg: float


class Limb(NamedTuple):
    """Joints (3,) from the body outwards: hip, knee, ankle, toes; or shoulder, elbow, wrist, finger tips."""

    root: np.ndarray
    bend: np.ndarray
    end: np.ndarray
    tip: np.ndarray


@dataclass(frozen=True)
class Limbs:
    """Poses of legs and arms, left and right."""

    left_leg: LimbPose = LimbPose(122.0, 15.0, 136.0, 16.0)
    right_leg: LimbPose = LimbPose(112.0, 14.0, 134.0, 16.0)
    left_arm: LimbPose = LimbPose(42.0, 6.0, 84.0, 26.0)
    right_arm: LimbPose = LimbPose(34.0, 6.0, 66.0, 22.0)

    def leg(self, side: float) -> Limb:
        return leg(side, self.left_leg if side > 0 else self.right_leg)

    def arm(self, side: float) -> Limb:
        return arm(side, self.left_arm if side > 0 else self.right_arm)


def leg(side: float, pose: LimbPose) -> Limb:
    """Joints of the left (+1) or right (-1) leg."""
    hip = curl(np.array([[side * 12.0, -1.0, -47.0]]))[0]
    thigh, front, inward = _axes(side, pose)
    shin, heel = _turned(thigh, -front, inward, pose.bend_deg, pose.inward_deg)
    knee = hip + 46.0 * thigh
    ankle = knee + 41.0 * shin
    foot = 0.35 * shin - heel
    return Limb(hip, knee, ankle, ankle + 24.0 * foot / np.linalg.norm(foot))


def arm(side: float, pose: LimbPose) -> Limb:
    """Joints of the left (+1) or right (-1) arm."""
    shoulder = curl(np.array([[side * 24.0, 1.0, 36.0]]))[0]
    upper, forward, inward = _axes(side, pose)
    forearm, _ = _turned(upper, forward, inward, pose.bend_deg, pose.inward_deg)
    hand, _ = _turned(upper, forward, inward, pose.bend_deg + 25.0, pose.inward_deg)
    elbow = shoulder + 40.0 * upper
    wrist = elbow + 34.0 * forearm
    return Limb(shoulder, elbow, wrist, wrist + 19.0 * hand)


def _axes(side: float, pose: LimbPose) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors along the upper segment, to its front, and to the midline."""
    f, a = np.deg2rad(pose.flexion_deg), np.deg2rad(pose.abduction_deg)
    along = np.array([side * np.sin(a), -np.sin(f) * np.cos(a), -np.cos(f) * np.cos(a)])
    front = np.array([0.0, -np.cos(f), np.sin(f)])
    inward = np.cross(along, front)
    return along, front, inward * -side * np.sign(inward[0])


def _turned(
    along: np.ndarray, towards: np.ndarray, inward: np.ndarray, bend_deg: float, inward_deg: float
) -> tuple[np.ndarray, np.ndarray]:
    """The lower segment, and `towards` after the same turn."""
    k, i = np.deg2rad(bend_deg), np.deg2rad(inward_deg)
    towards = np.cos(i) * towards + np.sin(i) * inward
    return np.cos(k) * along + np.sin(k) * towards, np.cos(k) * towards - np.sin(k) * along


def limb_flesh(tissues: dict[str, Tissue], scale: float, seed: int, limbs: Limbs) -> list[Structure]:
    """Skin and fat, then muscles, of every limb.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every grid spacing.
    seed : int
        Of the surface displacements.
    limbs : Limbs
    """
    names = tuple(zip(SIDES, ("left", "right"), strict=True))
    shapes = [
        *((_leg_flesh(limbs.leg(side), seed), 1.05, 2.0, f"{name} leg") for side, name in names),
        *((_arm_flesh(limbs.arm(side), seed), 0.85, 1.5, f"{name} arm") for side, name in names),
    ]

    def solid(field: Field, tissue: str, pitch_mm: float, name: str) -> Structure:
        pitch_mm = min(pitch_mm * scale, 4.0 + 5.0 * pitch_mm)
        return Structure(mesh_field(field, LIMBS_BOX, pitch_mm, name), tissues[tissue])

    return [
        *(solid(field, "soft_tissue", pitch, name) for field, pitch, _, name in shapes),
        *(solid(shrunk(field, fat_mm), "muscle", pitch, f"{name} muscles") for field, pitch, fat_mm, name in shapes),
    ]


def leg_capsules(limb: Limb) -> list[tuple[np.ndarray, np.ndarray, float, float]]:
    """Start, end and the radii there of the rounded rods that a leg is made of."""
    hip, knee, ankle, toes = limb
    heel, calf, ball = ankle - 0.28 * (toes - ankle), knee + 0.45 * (ankle - knee), ankle + 0.7 * (toes - ankle)
    return [
        (hip, knee, 11.5, 8.2),
        (knee, calf, 7.8, 7.6),
        (calf, ankle, 7.6, 5.0),
        (heel, ball, 4.6, 4.4),
        (ball, toes, 4.4, 3.4),
    ]


def arm_capsules(limb: Limb) -> list[tuple[np.ndarray, np.ndarray, float, float]]:
    """As `leg_capsules`."""
    shoulder, elbow, wrist, tips = limb
    return [
        (shoulder, elbow, 8.0, 5.6),
        (elbow, wrist, 5.6, 3.8),
        (wrist, wrist + 0.45 * (tips - wrist), 3.8, 4.2),
        *((start, end, 1.7, 1.4) for start, end in finger_rays(limb)),
    ]


def _leg_flesh(limb: Limb, seed: int) -> Field:
    return rippled(union([capsule(*part) for part in leg_capsules(limb)], 4.0), seed + 1, 0.2, 15.0)


def _arm_flesh(limb: Limb, seed: int) -> Field:
    return rippled(union([capsule(*part) for part in arm_capsules(limb)], 2.0), seed + 2, 0.12, 12.0)


def limb_bones(tissues: dict[str, Tissue], scale: float, limbs: Limbs) -> list[Structure]:
    """Epiphyses, femora, and the other bones of the limbs; `scale` is a factor on every spacing."""
    sides = max(4, round(14 / scale))
    femora = [_femur(limbs.leg(side), sides) for side in SIDES]
    others = [bone for side in SIDES for bone in _other_bones(side, limbs, sides)]
    return [
        Structure(joined(_epiphyses(limbs, sides), "epiphyses"), tissues["cartilage"]),
        Structure(joined(femora, "femora"), tissues["fetal_bone"]),
        Structure(joined(others, "other limb bones"), tissues["fetal_bone"]),
    ]


def _femur(limb: Limb, sides: int) -> trimesh.Trimesh:
    along = (limb.bend - limb.root) / np.linalg.norm(limb.bend - limb.root)
    start = limb.root + 4.0 * along
    return rod(start, start + FEMUR_MM * along, 2.1, sides, 0.8)


def _epiphyses(limbs: Limbs, sides: int) -> list[trimesh.Trimesh]:
    """Cartilage at hips, knees, shoulders and elbows."""
    joints = []
    for side in SIDES:
        leg_, arm_ = limbs.leg(side), limbs.arm(side)
        for point, radius in ((leg_.root, 4.0), (leg_.bend, 4.2), (arm_.root, 3.6), (arm_.bend, 3.0)):
            lift = np.array([0.0, 0.0, radius])
            joints.append(spindle(point - lift, point + lift, (radius, radius), sides, up=(1.0, 0.0, 0.0)))
    return joints


def _other_bones(side: float, limbs: Limbs, sides: int) -> list[trimesh.Trimesh]:
    """Tibia, fibula and metatarsals; humerus, radius, ulna and the digits of the hand."""
    leg_, arm_ = limbs.leg(side), limbs.arm(side)
    reach = arm_.bend - arm_.root
    bones = [rod(arm_.root + 0.06 * reach, arm_.root + 0.94 * reach, 1.7, sides, 0.5)]
    for limb, radii in ((leg_, (1.6, 0.9)), (arm_, (1.1, 1.1))):
        along = limb.end - limb.bend
        apart = np.cross(along, (side, 0.4, 0.2))
        apart *= 1.9 / np.linalg.norm(apart)
        start = limb.bend + apart
        bones.append(rod(start + 0.10 * along, start + 0.92 * along, radii[0], sides, 0.4))
        start = limb.bend - apart
        bones.append(rod(start + 0.13 * along, start + 0.92 * along, radii[1], sides, -0.4))
    for start, end in finger_rays(arm_):
        bones.append(rod(start + 0.05 * (end - start), start + 0.8 * (end - start), 0.65, sides))
    along = leg_.tip - leg_.end
    across = _across(along, leg_.bend - leg_.end)
    for spread in (-3.2, -1.1, 1.1, 3.2):
        start, end = leg_.end + 0.45 * along + 0.6 * spread * across, leg_.end + 0.85 * along + spread * across
        bones.append(rod(start, end, 0.6, sides))
    return bones


def finger_rays(limb: Limb) -> list[tuple[np.ndarray, np.ndarray]]:
    """Start and end of the five digits of a hand."""
    along = limb.tip - limb.end
    across = _across(along, limb.end - limb.bend)
    rays = []
    for digit, (spread, length) in enumerate(((-6.5, 0.62), (-3.2, 0.95), (0.0, 1.0), (3.1, 0.95), (6.0, 0.8))):
        start = limb.end + (0.2 if digit == 0 else 0.42) * along + 0.7 * spread * across
        rays.append((start, limb.end + length * along + 1.25 * spread * across))
    return rays


def _across(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    normal = np.cross(first, second)
    return normal / np.linalg.norm(normal)


def flesh_spheres(capsules: Sequence[tuple[np.ndarray, np.ndarray, float, float]]) -> np.ndarray:
    """Balls that fill rounded rods, 4 mm apart: centre and radius, (n, 4)."""
    balls = []
    for start, end, first, last in capsules:
        t = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(end - start) / 4.0))[:, None]
        balls.append(np.hstack([start + t * (end - start), first + t * (last - first)]))
    return np.concatenate(balls)
