"""Skin and muscles of the fetus's limbs: muscles in groups, between septa of fat and fascia; fetal axes, mm."""

import numpy as np
import trimesh

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.body import LIMBS_BOX, SIDES, Limbs
from ablate.anatomy.fetal.shapes import Part, Vector, joined, unit
from ablate.anatomy.fetal.tubes import tube

SEPTA_DEG = ((0.0, 110.0, 230.0), (60.0, 240.0))  # about the axis of the upper and of the lower segment
_SEPTUM_MM = 1.0  # thickness in its middle


def limb_flesh(scale: float, seed: int, limbs: Limbs) -> list[Part]:
    """Skin and fat, muscles, which end before the joints, and the septa that part them, of every limb."""
    leg, arm = (4.0, (seed + 1, 0.2, 15.0), 1.05, 2.0), (2.0, (seed + 2, 0.12, 12.0), 0.85, 1.5)
    names, kinds = ("left leg", "right leg", "left arm", "right arm"), (leg, leg, arm, arm)
    joints = [*map(limbs.leg, SIDES), *map(limbs.arm, SIDES)]
    skin, muscles = [], []
    for name, rods, limb, kind in zip(names, limbs.rods(), joints, kinds, strict=True):
        blend_mm, ripple, pitch_mm, fat_mm = kind
        field = sdf.rippled(sdf.union([sdf.capsule(*rod) for rod in rods], blend_mm), *ripple)
        solid = sdf.solids_in(LIMBS_BOX, scale, 4.0 + 5.0 * pitch_mm)
        skin.append(solid(field, "soft_tissue", pitch_mm, name))
        bend_mm = rods[0][3]
        gaps = [sdf.ellipsoid(at, np.full(3, mm)) for at, mm in ((limb.bend, bend_mm), (limb.end, 0.7 * bend_mm))]
        between_joints = sdf.intersection([sdf.shrunk(field, fat_mm), *map(sdf.outside, gaps)], 0.6)
        muscles.append(solid(between_joints, "muscle", pitch_mm, f"{name} muscles"))
    return [*skin, *muscles, *_septa(scale, limbs)]


def _septa(scale: float, limbs: Limbs) -> list[Part]:
    """Septa of the upper and of the lower segments of all limbs."""
    upper, lower = [], []
    for rods, (root, bend, end, _) in zip(limbs.rods(), [*map(limbs.leg, SIDES), *map(limbs.arm, SIDES)], strict=True):
        first_mm, bend_mm = (0.8 * radius for radius in rods[0][2:])  # without skin and fat
        upper += [_septum((root, bend), (first_mm, bend_mm), turn_deg, scale) for turn_deg in SEPTA_DEG[0]]
        lower += [_septum((bend, end), (bend_mm, 0.6 * bend_mm), turn_deg, scale) for turn_deg in SEPTA_DEG[1]]
    parts = {"septa of thighs and upper arms": upper, "septa of shins and forearms": lower}
    return [Part(joined(plates, name), "soft_tissue") for name, plates in parts.items()]


def _septum(
    ends: tuple[Vector, Vector], radii_mm: tuple[float, float], turn_deg: float, scale: float
) -> trimesh.Trimesh:
    """A plate with the section of a lens, from beside the axis of a segment to the outside of its muscles.

    Parameters
    ----------
    ends : tuple of (3,) float
        Of the axis.
    radii_mm : tuple of float
        Of the muscles at these ends.
    turn_deg : float
        About the axis.
    scale : float
        Of the grid.
    """
    start, along = np.asarray(ends[0]), np.subtract(ends[1], ends[0])
    first = unit(np.cross(along, (0.3, 0.5, 0.8)))
    second = np.cross(unit(along), first)
    turn = np.deg2rad(turn_deg)
    out, across = np.cos(turn) * first + np.sin(turn) * second, np.cos(turn) * second - np.sin(turn) * first
    t = np.linspace(0.12, 0.88, max(4, round(20 / scale)))[:, None]
    radius = radii_mm[0] + t * (radii_mm[1] - radii_mm[0])
    section = np.hstack([np.full_like(t, _SEPTUM_MM / 2.0), 0.45 * radius])
    return tube(start + t * along + 0.57 * radius * out, section, max(4, round(14 / scale)), up=across)
