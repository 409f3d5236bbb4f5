"""The fetus at 22 weeks from outside: its axes, outline, limbs and skin, and balls that about fill it.

Fetal axes in mm: x to its left, y to its back, z to its head. Organs and bones of the trunk are built in a straight
trunk (x, y, s) and bent forward afterwards; cross-sections at constant s keep their shape. The head has axes of its
own, which are parallel to the fetal ones before the neck is bent. `side` is +1 for the left and -1 for the right. The
balls, (n, 4), centre and radius, make distances between the fetus and its surroundings fast to compute.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.shapes import Part, unit

BEND_RADIUS_MM = 125.0  # of the curve of the back; its centre lies in front of the belly
BEND_REACH_MM = 52.0  # the trunk is bent for |s| below this and straight beyond
SIDES = (1.0, -1.0)  # signs of x: left, right
NAVEL_IN_TRUNK = (0.0, -36.0, -27.0)
NECK_TOP = (0.0, 5.0, 55.0)  # in the trunk
NECK_IN_HEAD = (0.0, 10.0, -25.0)
HEAD_FLEXION_DEG = 34.0
TRUNK_BOX: sdf.Bounds = ((-40.0, -40.0, -75.0), (40.0, 40.0, 75.0))
WALL_OUTSIDE_MM, WALL_INSIDE_MM = 2.6, 5.8  # depth of the muscles of the trunk under its skin
#: Angle from the back and half width, degrees, where muscles part: spine, lumbar fascia, edge of rectus, white line.
MUSCLE_GAPS_DEG = ((0.0, 7.0), (46.0, 5.0), (137.0, 4.5), (180.0, 5.5))
_GAP_INSIDE_MM = 1.8  # depth there, before the muscles begin
ABDOMEN_S_MM = -17.0  # level of the stomach, where the abdominal circumference is taken
#: Outline of the trunk, mm: levels s, and there the half width, the half depth and the middle in y.
_OUTLINE = np.array(
    [
        (-66.0, -64.0, -59.0, -50.0, -36.0, -24.0, -17.0, -8.0, 4.0, 20.0, 33.0, 42.0, 49.0, 60.0, 66.0),
        (1.0, 7.0, 15.0, 21.5, 25.8, 27.8, 28.0, 27.8, 26.6, 25.4, 24.6, 19.0, 12.5, 11.5, 11.0),
        (1.0, 6.0, 13.0, 19.0, 24.6, 27.2, 27.7, 27.4, 26.0, 23.6, 20.5, 16.0, 12.5, 11.5, 11.0),
        (3.0, 3.0, 2.5, 1.5, 0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.5, 4.0, 5.0, 5.0),
    ]
)
_LEVELS = np.linspace(_OUTLINE[0, 0], _OUTLINE[0, -1], 400)
_SMOOTH_OUTLINE = PchipInterpolator(_OUTLINE[0], _OUTLINE[1:].T)(_LEVELS)

HEAD_ROTATION = Rotation.from_euler("x", HEAD_FLEXION_DEG, degrees=True).as_matrix()
FETUS_BOX: sdf.Bounds = ((-75.0, -140.0, -100.0), (75.0, 60.0, 140.0))
LIMBS_BOX: sdf.Bounds = ((-100.0, -150.0, -160.0), (100.0, 100.0, 130.0))
HEAD_RADII = (29.2, 38.5, 31.2)  # of the scalp
Capsule = tuple[np.ndarray, np.ndarray, float, float]  # start, end, and the radii there


def outline(s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Half width, half depth and middle in y of the trunk at level s; all mm, the shape of s."""
    width, depth, middle = (np.interp(s, _LEVELS, _SMOOTH_OUTLINE[:, i]).astype(np.float32) for i in range(3))
    return width, depth, middle


def trunk(x: np.ndarray, y: np.ndarray, s: np.ndarray) -> np.ndarray:
    """About the distance to the skin of the straight trunk, mm, negative inside."""
    width, depth, middle = outline(s)
    u, v = x / width, (y - middle) / depth
    level = np.sqrt(u * u + v * v)
    slope = np.sqrt((u / width) ** 2 + (v / depth) ** 2)
    around = sdf.first_order_distance(level, slope, np.minimum(width, depth))
    return sdf.smooth_max(around, np.abs(s) - 65.0, 2.0)


def inside_muscles(x: np.ndarray, y: np.ndarray, s: np.ndarray) -> np.ndarray:
    """About the distance to the inner face of the trunk's muscles, mm: they are groups with gaps, and not a ring."""
    width, depth, middle = outline(s)
    angle_deg = np.rad2deg(np.arctan2(np.abs(x) / width, (y - middle) / depth))
    muscle = np.ones(np.broadcast_shapes(x.shape, y.shape, s.shape), np.float32)
    for at_deg, half_deg in MUSCLE_GAPS_DEG:
        muscle = np.minimum(muscle, np.clip((np.abs(angle_deg - at_deg) - half_deg) / 4.0 + 0.5, 0.0, 1.0))
    return trunk(x, y, s) + (_GAP_INSIDE_MM + (WALL_INSIDE_MM - _GAP_INSIDE_MM) * muscle)


def spine_y(s: np.ndarray | float) -> np.ndarray:
    """Depth of the middle of the vertebral bodies at level s, mm."""
    _, depth, middle = outline(np.asarray(s, float))
    return middle + depth - 10.0


def above_diaphragm(gap_mm: float) -> sdf.Field:
    """The space of the straight trunk at least `gap_mm` above the two-domed diaphragm."""
    return lambda x, y, s: 0.8 * (8.0 - (x * x + (y - 2.0) ** 2) / 62.0 + gap_mm - s)


def curl(points: np.ndarray) -> np.ndarray:
    """From the straight trunk (n, 3) to fetal axes (n, 3), mm."""
    x, y, s = np.asarray(points, float).T
    bent = np.clip(s, -BEND_REACH_MM, BEND_REACH_MM)
    angle = bent / BEND_RADIUS_MM
    beyond = s - bent
    arm = BEND_RADIUS_MM + y
    forward = arm * np.cos(angle) - BEND_RADIUS_MM - beyond * np.sin(angle)
    return np.stack([x, forward, arm * np.sin(angle) + beyond * np.cos(angle)], axis=1)


def curled(field: sdf.Field) -> sdf.Field:
    """A field of the straight trunk as a field in fetal axes: the inverse of `curl`."""
    reach = BEND_REACH_MM / BEND_RADIUS_MM

    def bent(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        arm = y + BEND_RADIUS_MM
        angle = np.clip(np.arctan2(z, arm), -reach, reach)
        sine, cosine = np.sin(angle), np.cos(angle)
        depth = arm * cosine + z * sine - BEND_RADIUS_MM
        level = angle * BEND_RADIUS_MM + (z * cosine - arm * sine)
        return field(x, depth, level)

    return bent


HEAD_ORIGIN = curl(np.array([NECK_TOP]))[0] - HEAD_ROTATION @ np.array(NECK_IN_HEAD)  # of the skull, in fetal axes


def head_to_fetus(points: np.ndarray) -> np.ndarray:
    """From the head's axes (n, 3) to the fetus's (n, 3), mm."""
    return np.asarray(points) @ HEAD_ROTATION.T + HEAD_ORIGIN


def in_head(field: sdf.Field) -> sdf.Field:
    """A field of the head's axes as a field in fetal axes."""

    def placed(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = (p - start for p, start in zip((x, y, z), HEAD_ORIGIN, strict=True))
        return field(*(i * u + j * v + k * w for i, j, k in HEAD_ROTATION.T))

    return placed


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
    right_leg: LimbPose = LimbPose(122.0, 14.0, 136.0, 16.0)
    left_arm: LimbPose = LimbPose(42.0, 6.0, 84.0, 26.0)
    right_arm: LimbPose = LimbPose(28.0, 6.0, 60.0, 22.0)

    def rods(self) -> list[list[Capsule]]:
        """The rounded rods of left leg, right leg, left arm and right arm."""
        return [*(leg_capsules(self.leg(s)) for s in SIDES), *(arm_capsules(self.arm(s)) for s in SIDES)]

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


def _body_field() -> sdf.Field:
    """Trunk and head as one solid."""
    torso = sdf.union([trunk, sdf.ellipsoid((0.0, 1.5, 35.0), (28.0, 13.5, 11.0))], 6.0)
    head = [  # scalp, cheeks and chin, nose, lips and ears, in the head's axes
        sdf.ellipsoid((0.0, 0.0, 0.0), HEAD_RADII),
        sdf.ellipsoid((0.0, -20.0, -21.0), (20.5, 19.0, 18.5)),
        sdf.capsule((0.0, -37.0, -20.0), (0.0, -42.5, -24.0), 2.4, 2.8),
        sdf.capsule((-4.0, -38.0, -29.5), (4.0, -38.0, -29.5), 2.4, 2.4),
        sdf.capsule((-3.0, -36.5, -36.5), (3.0, -36.5, -36.5), 3.2, 3.2),
        *(sdf.ellipsoid((side * 28.5, 7.0, -14.0), (2.4, 5.5, 8.0)) for side in SIDES[::-1]),
    ]
    return sdf.union([curled(torso), in_head(sdf.union(head, 7.0))], 7.0)


def flesh_field(limbs: Limbs) -> sdf.Field:
    """About the distance to trunk, head and limbs, in fetal axes."""
    return sdf.union([_body_field(), *(sdf.capsule(*rod) for limb in limbs.rods() for rod in limb)], 2.0)


def fetal_body(scale: float, seed: int) -> Part:
    """Trunk and head as one closed solid; what is inside comes later and owns its place."""
    whole = sdf.rippled(_body_field(), seed, 0.25, 24.0)
    return Part(sdf.mesh_field(whole, FETUS_BOX, min(1.12 * scale, 9.75), "body and head"), "soft_tissue")


def fetal_balls(limbs: Limbs) -> np.ndarray:
    """Balls of trunk, head and limbs."""
    return np.concatenate([_body_balls(), *map(_in_capsules, limbs.rods())])


def untangled(limbs: Limbs) -> bool:
    """Whether no limb runs through another one, the trunk, the head, or the place of the cord at the navel."""
    navel = np.hstack([curl(np.array([NAVEL_IN_TRUNK])), [[6.0]]])
    fixed = np.concatenate([_body_balls(), navel])
    rods = limbs.rods()
    lower, whole = [_in_capsules(each[1:]) for each in rods], [_in_capsules(each) for each in rods]
    pairs = [(own, fixed) for own in lower] + [(leg[4:], navel) for leg in whole[:2]]
    pairs += [(lower[i], whole[j]) for i in range(4) for j in range(4) if i != j]
    apart = (np.linalg.norm(a[:, None, :3] - b[:, :3], axis=2) - a[:, None, 3] - b[:, 3] for a, b in pairs)
    return all(gap.min() > 0.0 for gap in apart)


def _body_balls() -> np.ndarray:
    """Balls of trunk and head."""
    s = np.arange(-57.0, 58.0, 6.0)
    width, depth, middle = outline(s)
    spine = np.column_stack([curl(np.column_stack([0.0 * s, middle, s])), (width + depth) / 2.0 + 0.6])
    shoulders = [(*curl(np.array([(side * 18.5, 1.5, 35.0)]))[0], 10.5) for side in SIDES[::-1]]
    skull = np.array([(0.0, y, 0.0, 31.0 - abs(y) / 9.0) for y in (-10.0, -5.0, 0.0, 5.0, 10.0)])
    head = np.concatenate([skull, [(0.0, -20.0, -21.0, 19.3), (0.0, -40.0, -22.0, 3.5), (0.0, -36.5, -36.5, 3.5)]])
    return np.concatenate([spine, shoulders, np.column_stack([head_to_fetus(head[:, :3]), head[:, 3]])])


def _in_capsules(capsules: Sequence[Capsule]) -> np.ndarray:
    """Balls that fill rounded rods, 4 mm apart."""
    balls = []
    for start, end, first, last in capsules:
        t = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(end - start) / 4.0))[:, None]
        balls.append(np.hstack([start + t * (end - start), first + t * (last - first)]))
    return np.concatenate(balls)
