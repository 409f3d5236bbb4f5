"""The fetus's outside: trunk, head and face, limbs with hands and feet, and the umbilical cord."""

from __future__ import annotations

from ablate.anatomy.fetal_frame import curled, fetus_to_world, in_head, trunk
from ablate.anatomy.fetal_skeleton import Limb, arm, finger_rays, leg
from ablate.anatomy.implicit import Bounds, Field, capsule, ellipsoid, mesh_field, rippled, shrunk, union
from ablate.anatomy.scene import Structure, Tissue

FETUS_BOX: Bounds = ((-75.0, -140.0, -100.0), (75.0, 60.0, 140.0))
SIDES = ((1.0, "left"), (-1.0, "right"))


def fetal_body(tissues: dict[str, Tissue], scale: float, seed: int) -> list[Structure]:
    """Skin and flesh as closed solids, in world mm; what is inside comes later and owns its place.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every grid spacing.
    seed : int
        Of the surface displacements.
    """
    torso = union([trunk, ellipsoid((0.0, 1.5, 35.0), (28.0, 13.5, 11.0))], 6.0)
    head = union([ellipsoid((0.0, 0.0, 0.0), (29.6, 39.2, 31.6)), *_face()], 7.0)
    whole = rippled(union([curled(torso), in_head(head)], 7.0), seed, 0.18, 22.0)
    limbs = [
        *((_leg_flesh(leg(side), seed), 1.05, 2.0, f"{name} leg") for side, name in SIDES),
        *((_arm_flesh(side, seed), 0.85, 1.5, f"{name} arm") for side, name in SIDES),
    ]

    def solid(field: Field, tissue: str, pitch_mm: float, name: str) -> Structure:
        pitch_mm = min(pitch_mm * scale, 4.0 + 5.0 * pitch_mm)
        return Structure(fetus_to_world(mesh_field(field, FETUS_BOX, pitch_mm, name)), tissues[tissue])

    return [
        solid(whole, "soft_tissue", 1.15, "body and head"),
        *(solid(field, "soft_tissue", pitch, name) for field, pitch, _, name in limbs),
        *(solid(shrunk(field, fat_mm), "muscle", pitch, f"{name} muscles") for field, pitch, fat_mm, name in limbs),
    ]


def _face() -> list[Field]:
    """Cheeks and chin, nose, lips and ears, in the head's axes."""
    return [
        ellipsoid((0.0, -20.0, -21.0), (20.5, 19.0, 18.5)),
        capsule((0.0, -37.0, -20.0), (0.0, -42.5, -24.0), 2.4, 2.8),
        capsule((-4.0, -38.0, -29.5), (4.0, -38.0, -29.5), 2.4, 2.4),
        capsule((-3.0, -36.5, -36.5), (3.0, -36.5, -36.5), 3.2, 3.2),
        *(ellipsoid((s * 28.5, 7.0, -14.0), (2.4, 5.5, 8.0)) for s in (-1.0, 1.0)),
    ]


def _leg_flesh(limb: Limb, seed: int) -> Field:
    hip, knee, ankle, toes = limb
    heel = ankle - 0.28 * (toes - ankle)
    parts = [
        capsule(hip, knee, 11.5, 8.2),
        capsule(knee, knee + 0.45 * (ankle - knee), 7.8, 7.6),
        capsule(knee + 0.45 * (ankle - knee), ankle, 7.6, 5.0),
        capsule(heel, ankle + 0.7 * (toes - ankle), 4.6, 4.4),
        capsule(ankle + 0.7 * (toes - ankle), toes, 4.4, 3.4),
    ]
    return rippled(union(parts, 4.0), seed + 1, 0.2, 15.0)


def _arm_flesh(side: float, seed: int) -> Field:
    shoulder, elbow, wrist, tips = arm(side)
    parts = [
        capsule(shoulder, elbow, 8.0, 5.6),
        capsule(elbow, wrist, 5.6, 3.8),
        capsule(wrist, wrist + 0.45 * (tips - wrist), 3.8, 4.2),
        *(capsule(start, end, 1.7, 1.4) for start, end in finger_rays(side)),
    ]
    return rippled(union(parts, 2.0), seed + 2, 0.12, 12.0)
