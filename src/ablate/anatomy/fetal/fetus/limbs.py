"""The arms and legs of the fetus: how they are bent, where their joints are, and the rods that they are made of.

Fetal axes, mm; `side` is +1 for the left and -1 for the right.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ablate.anatomy.fetal.fetus.axes import curl
from ablate.anatomy.shapes.vectors import unit

Capsule = tuple[np.ndarray, np.ndarray, float, float]  # start, end, and the radii there


@dataclass(frozen=True)
class LimbPose:
    """Angles of one limb."""

    flexion_deg: float  # of hip or shoulder, forwards; 0 is along the trunk
    abduction_deg: float  # away from the midline
    bend_deg: float  # of the knee backwards, or of the elbow forwards; 0 is straight
    inward_deg: float  # of shin or forearm, to the other side


class Limb(NamedTuple):
    """Joints (3,) from the body outwards: hip, knee, ankle, toes; or shoulder, elbow, wrist, finger tips."""

    root: np.ndarray
    bend: np.ndarray
    end: np.ndarray
    tip: np.ndarray


@dataclass(frozen=True)
class Limbs:
    """Poses of legs and arms."""

    left_leg: LimbPose = LimbPose(122.0, 15.0, 136.0, 16.0)
    right_leg: LimbPose = LimbPose(112.0, 14.0, 134.0, 16.0)
    left_arm: LimbPose = LimbPose(42.0, 6.0, 84.0, 26.0)
    right_arm: LimbPose = LimbPose(34.0, 6.0, 66.0, 22.0)

    def leg(self, side: float) -> Limb:
        """Joints of a leg."""
        pose = self.left_leg if side > 0 else self.right_leg
        hip = curl(np.array([[side * 12.0, -1.0, -47.0]]))[0]
        thigh, front, inward = _axes(side, pose)
        shin, heel = _turned(thigh, -front, inward, pose.bend_deg, pose.inward_deg)
        knee = hip + 46.0 * thigh
        ankle = knee + 41.0 * shin
        foot = 0.35 * shin - heel
        return Limb(hip, knee, ankle, ankle + 24.0 * foot / np.linalg.norm(foot))

    def arm(self, side: float) -> Limb:
        """Joints of an arm."""
        pose = self.left_arm if side > 0 else self.right_arm
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


def leg_capsules(limb: Limb) -> list[Capsule]:
    """The rounded rods that a leg is made of."""
    hip, knee, ankle, toes = limb
    heel, calf, ball = ankle - 0.28 * (toes - ankle), knee + 0.45 * (ankle - knee), ankle + 0.7 * (toes - ankle)
    return [
        (hip, knee, 11.5, 8.2),
        (knee, calf, 7.8, 7.6),
        (calf, ankle, 7.6, 5.0),
        (heel, ball, 4.6, 4.4),
        (ball, toes, 4.4, 3.4),
    ]


def arm_capsules(limb: Limb) -> list[Capsule]:
    """The rounded rods that an arm is made of."""
    shoulder, elbow, wrist, tips = limb
    return [
        (shoulder, elbow, 8.0, 5.6),
        (elbow, wrist, 5.6, 3.8),
        (wrist, wrist + 0.45 * (tips - wrist), 3.8, 4.2),
        *((start, end, 1.7, 1.4) for start, end in finger_rays(limb)),
    ]


def finger_rays(limb: Limb) -> list[tuple[np.ndarray, np.ndarray]]:
    """Start and end of the five digits of a hand."""
    along = limb.tip - limb.end
    across = unit(np.cross(along, limb.end - limb.bend))
    rays = []
    for digit, (spread, length) in enumerate(((-6.5, 0.62), (-3.2, 0.95), (0.0, 1.0), (3.1, 0.95), (6.0, 0.8))):
        start = limb.end + (0.2 if digit == 0 else 0.42) * along + 0.7 * spread * across
        rays.append((start, limb.end + length * along + 1.25 * spread * across))
    return rays
