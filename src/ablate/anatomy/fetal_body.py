"""The fetus's outside without its limbs: trunk, head and face. Fetal axes, mm."""

from __future__ import annotations

import numpy as np

from ablate.anatomy.fetal_frame import curl, curled, head_to_fetus, in_head, outline, trunk
from ablate.anatomy.implicit import Bounds, Field, capsule, ellipsoid, mesh_field, rippled, union
from ablate.anatomy.scene import Structure, Tissue

FETUS_BOX: Bounds = ((-75.0, -140.0, -100.0), (75.0, 60.0, 140.0))
HEAD_RADII = (29.2, 38.5, 31.2)  # of the scalp


def fetal_body(tissues: dict[str, Tissue], scale: float, seed: int) -> Structure:
    """Skin and flesh of trunk and head as one closed solid; what is inside comes later and owns its place.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on the grid spacing.
    seed : int
        Of the surface displacement.
    """
    torso = union([trunk, ellipsoid((0.0, 1.5, 35.0), (28.0, 13.5, 11.0))], 6.0)
    head = union([ellipsoid((0.0, 0.0, 0.0), HEAD_RADII), *_face()], 7.0)
    whole = rippled(union([curled(torso), in_head(head)], 7.0), seed, 0.18, 22.0)
    mesh = mesh_field(whole, FETUS_BOX, min(1.15 * scale, 9.75), "body and head")
    return Structure(mesh, tissues["soft_tissue"])


def _face() -> list[Field]:
    """Cheeks and chin, nose, lips and ears, in the head's axes."""
    return [
        ellipsoid((0.0, -20.0, -21.0), (20.5, 19.0, 18.5)),
        capsule((0.0, -37.0, -20.0), (0.0, -42.5, -24.0), 2.4, 2.8),
        capsule((-4.0, -38.0, -29.5), (4.0, -38.0, -29.5), 2.4, 2.4),
        capsule((-3.0, -36.5, -36.5), (3.0, -36.5, -36.5), 3.2, 3.2),
        *(ellipsoid((s * 28.5, 7.0, -14.0), (2.4, 5.5, 8.0)) for s in (-1.0, 1.0)),
    ]


def body_balls() -> np.ndarray:
    """Balls that about fill trunk and head: centre and radius, (n, 4)."""
    s = np.arange(-57.0, 58.0, 6.0)
    width, depth, middle = outline(s)
    spine = np.column_stack([curl(np.column_stack([0.0 * s, middle, s])), (width + depth) / 2.0 + 0.6])
    shoulders = [(*curl(np.array([(side * 18.5, 1.5, 35.0)]))[0], 10.5) for side in (-1.0, 1.0)]
    skull = np.array([(0.0, y, 0.0, 31.0 - abs(y) / 9.0) for y in (-10.0, -5.0, 0.0, 5.0, 10.0)])
    face = np.array([(0.0, -20.0, -21.0, 19.3), (0.0, -40.0, -22.0, 3.5), (0.0, -36.5, -36.5, 3.5)])
    head = np.concatenate([skull, face])
    return np.concatenate([spine, shoulders, np.column_stack([head_to_fetus(head[:, :3]), head[:, 3]])])
