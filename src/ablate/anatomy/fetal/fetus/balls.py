"""Balls that about fill the fetus: with them, distances between it and its surroundings are fast to compute.

Balls are an array (n, 4): centre and radius, mm, in fetal axes.
"""

from collections.abc import Sequence

import numpy as np

from ablate.anatomy.fetal.fetus.axes import NAVEL_IN_TRUNK, SIDES, curl, head_to_fetus, outline
from ablate.anatomy.fetal.fetus.limbs import Capsule, Limbs, arm_capsules, leg_capsules


def fetal_balls(limbs: Limbs) -> np.ndarray:
    """Balls of trunk, head and limbs."""
    legs = [_in_capsules(leg_capsules(limbs.leg(side))) for side in SIDES]
    arms = [_in_capsules(arm_capsules(limbs.arm(side))) for side in SIDES]
    return np.concatenate([_body_balls(), *legs, *arms])


def untangled(limbs: Limbs) -> bool:
    """Whether no limb runs through another one, the trunk, the head, or the place of the cord at the navel."""
    navel = np.array([[*curl(np.array([NAVEL_IN_TRUNK]))[0], 6.0]])
    fixed = np.concatenate([_body_balls(), navel])
    lower, whole = [], []
    for side in SIDES:
        for capsules in (leg_capsules(limbs.leg(side)), arm_capsules(limbs.arm(side))):
            lower.append(_in_capsules(capsules[1:]))
            whole.append(_in_capsules(capsules))
    pairs = [(lower[i], fixed) for i in range(4)]
    pairs += [(whole[i][4:], navel) for i in (0, 2)]
    pairs += [(lower[i], whole[j]) for i in range(4) for j in range(4) if i != j]
    return all(_gap(first, second) > 0.0 for first, second in pairs)


def _gap(first: np.ndarray, second: np.ndarray) -> float:
    """The least distance between the surfaces of two sets of balls, (n, 4) and (m, 4)."""
    apart = np.linalg.norm(first[:, None, :3] - second[None, :, :3], axis=2)
    return float((apart - first[:, None, 3] - second[None, :, 3]).min())


def _body_balls() -> np.ndarray:
    """Balls of trunk and head."""
    s = np.arange(-57.0, 58.0, 6.0)
    width, depth, middle = outline(s)
    spine = np.column_stack([curl(np.column_stack([0.0 * s, middle, s])), (width + depth) / 2.0 + 0.6])
    shoulders = [(*curl(np.array([(side * 18.5, 1.5, 35.0)]))[0], 10.5) for side in SIDES[::-1]]
    skull = np.array([(0.0, y, 0.0, 31.0 - abs(y) / 9.0) for y in (-10.0, -5.0, 0.0, 5.0, 10.0)])
    face = np.array([(0.0, -20.0, -21.0, 19.3), (0.0, -40.0, -22.0, 3.5), (0.0, -36.5, -36.5, 3.5)])
    head = np.concatenate([skull, face])
    return np.concatenate([spine, shoulders, np.column_stack([head_to_fetus(head[:, :3]), head[:, 3]])])


def _in_capsules(capsules: Sequence[Capsule]) -> np.ndarray:
    """Balls that fill rounded rods, 4 mm apart."""
    balls = []
    for start, end, first, last in capsules:
        t = np.linspace(0.0, 1.0, 2 + int(np.linalg.norm(end - start) / 4.0))[:, None]
        balls.append(np.hstack([start + t * (end - start), first + t * (last - first)]))
    return np.concatenate(balls)
