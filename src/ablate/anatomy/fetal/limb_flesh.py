"""Skin and muscles of the fetus's limbs: muscles in groups, between septa of fat and fascia; fetal axes, mm."""

import numpy as np

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.body import LIMBS_BOX, SIDES, Limb, Limbs
from ablate.anatomy.fetal.shapes import Part, unit


def limb_flesh(scale: float, seed: int, limbs: Limbs) -> list[Part]:
    """Skin and fat, then muscles, of every limb: groups that septa part, and that end before the joints."""
    leg, arm = (4.0, (seed + 1, 0.2, 15.0), 1.05, 2.0), (2.0, (seed + 2, 0.12, 12.0), 0.85, 1.5)
    kinds = {"left leg": leg, "right leg": leg, "left arm": arm, "right arm": arm}
    joints = [*map(limbs.leg, SIDES), *map(limbs.arm, SIDES)]
    skin, muscles = [], []
    for rods, limb, (name, (blend_mm, ripple, pitch_mm, fat_mm)) in zip(
        limbs.rods(), joints, kinds.items(), strict=True
    ):
        field = sdf.rippled(sdf.union([sdf.capsule(*rod) for rod in rods], blend_mm), *ripple)
        solid = sdf.solids_in(LIMBS_BOX, scale, 4.0 + 5.0 * pitch_mm)
        skin.append(solid(field, "soft_tissue", pitch_mm, name))
        groups = sdf.intersection([sdf.shrunk(field, fat_mm), sdf.outside(_between_muscles(limb, rods[0][3]))], 0.6)
        muscles.append(solid(groups, "muscle", pitch_mm, f"{name} muscles"))
    return [*skin, *muscles]


def _between_muscles(limb: Limb, radius_mm: float) -> sdf.Field:
    """Fat and fascia between a limb's muscles: three septa along its upper segment, two along the lower; its joints.

    `radius_mm` is that of the limb at its middle joint.
    """
    septa = [
        sdf.ellipsoid(joint, np.full(3, share * radius_mm)) for joint, share in ((limb.bend, 1.0), (limb.end, 0.7))
    ]
    for start, end, turns_deg in ((limb.root, limb.bend, (0.0, 110.0, 230.0)), (limb.bend, limb.end, (60.0, 240.0))):
        septa += [_septum(start, end, turn_deg) for turn_deg in turns_deg]
    return sdf.union(septa, 0.3)


def _septum(start: np.ndarray, end: np.ndarray, turn_deg: float) -> sdf.Field:
    """A sheet from the axis between two points outwards, which widens from 0.5 to 1.5 mm over 10 mm."""
    along = unit(end - start)
    first = unit(np.cross(along, (0.3, 0.5, 0.8)))
    out = np.cos(np.deg2rad(turn_deg)) * first + np.sin(np.deg2rad(turn_deg)) * np.cross(along, first)
    across = np.cross(along, out)

    def field(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        u, v, w = x - start[0], y - start[1], z - start[2]
        away = out[0] * u + out[1] * v + out[2] * w
        beside = np.abs(across[0] * u + across[1] * v + across[2] * w)
        level = along[0] * u + along[1] * v + along[2] * w
        sheet = np.maximum(beside - 0.25 - 0.05 * np.maximum(away, 0.0), -away)
        return np.maximum(sheet, np.maximum(-level, level - np.linalg.norm(end - start)))

    return field
