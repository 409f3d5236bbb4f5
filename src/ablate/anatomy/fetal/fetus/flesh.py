"""Skin, fat and muscles of the fetus: trunk, head and face as one solid, and the limbs. Fetal axes, mm."""

from ablate.anatomy.fetal.fetus.axes import SIDES, curled, in_head, trunk
from ablate.anatomy.fetal.fetus.limbs import Limbs, arm_capsules, leg_capsules
from ablate.anatomy.fetal.part import Part
from ablate.anatomy.shapes import sdf

FETUS_BOX: sdf.Bounds = ((-75.0, -140.0, -100.0), (75.0, 60.0, 140.0))
LIMBS_BOX: sdf.Bounds = ((-100.0, -150.0, -160.0), (100.0, 100.0, 130.0))
HEAD_RADII = (29.2, 38.5, 31.2)  # of the scalp


def fetal_body(scale: float, seed: int) -> Part:
    """Trunk and head as one closed solid; what is inside comes later and owns its place."""
    torso = sdf.union([trunk, sdf.ellipsoid((0.0, 1.5, 35.0), (28.0, 13.5, 11.0))], 6.0)
    face = [  # cheeks and chin, nose, lips and ears, in the head's axes
        sdf.ellipsoid((0.0, -20.0, -21.0), (20.5, 19.0, 18.5)),
        sdf.capsule((0.0, -37.0, -20.0), (0.0, -42.5, -24.0), 2.4, 2.8),
        sdf.capsule((-4.0, -38.0, -29.5), (4.0, -38.0, -29.5), 2.4, 2.4),
        sdf.capsule((-3.0, -36.5, -36.5), (3.0, -36.5, -36.5), 3.2, 3.2),
        *(sdf.ellipsoid((side * 28.5, 7.0, -14.0), (2.4, 5.5, 8.0)) for side in SIDES[::-1]),
    ]
    head = sdf.union([sdf.ellipsoid((0.0, 0.0, 0.0), HEAD_RADII), *face], 7.0)
    whole = sdf.rippled(sdf.union([curled(torso), in_head(head)], 7.0), seed, 0.18, 22.0)
    return Part(sdf.mesh_field(whole, FETUS_BOX, min(1.15 * scale, 9.75), "body and head"), "soft_tissue")


def limb_flesh(scale: float, seed: int, limbs: Limbs) -> list[Part]:
    """Skin and fat, then muscles, of every limb."""
    legs = [sdf.union([sdf.capsule(*rod) for rod in leg_capsules(limbs.leg(side))], 4.0) for side in SIDES]
    arms = [sdf.union([sdf.capsule(*rod) for rod in arm_capsules(limbs.arm(side))], 2.0) for side in SIDES]
    shapes = [(sdf.rippled(field, seed + 1, 0.2, 15.0), 1.05, 2.0) for field in legs]
    shapes += [(sdf.rippled(field, seed + 2, 0.12, 12.0), 0.85, 1.5) for field in arms]
    skin, muscles = [], []
    for name, (field, pitch_mm, fat_mm) in zip(("left leg", "right leg", "left arm", "right arm"), shapes, strict=True):
        pitch_mm = min(pitch_mm * scale, 4.0 + 5.0 * pitch_mm)
        skin.append(Part(sdf.mesh_field(field, LIMBS_BOX, pitch_mm, name), "soft_tissue"))
        inner = sdf.mesh_field(sdf.shrunk(field, fat_mm), LIMBS_BOX, pitch_mm, f"{name} muscles")
        muscles.append(Part(inner, "muscle"))
    return [*skin, *muscles]
