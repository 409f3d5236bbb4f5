"""The built-in anatomy: a mother's abdomen with a fetus of 22 weeks, generated and not downloaded."""

from __future__ import annotations

import math

from ablate.anatomy.fetal_body import fetal_body
from ablate.anatomy.fetal_head import fetal_head
from ablate.anatomy.fetal_organs import fetal_organs
from ablate.anatomy.fetal_skeleton import fetal_skeleton
from ablate.anatomy.mother import mother
from ablate.anatomy.scene import Scene
from ablate.anatomy.sites import SiteGrid
from ablate.anatomy.tissues import load_tissues
from ablate.anatomy.umbilical_cord import umbilical_cord

#: Triangles that the mother and the fetus have at grid scale 1, and the mother's share (the paper's 275k of 675k).
MOTHER_AT_SCALE_1 = 407_000
FETUS_AT_SCALE_1 = 626_000
MOTHER_SHARE = 275 / 675
FEWEST_TRIANGLES = 4_000


def fetal_abdomen(triangles: int = 675_000, seed: int = 0) -> Scene:
    """Second-trimester abdomen: BPD 54 mm, HC 200 mm, AC 175 mm, FL 39 mm.

    Parameters
    ----------
    triangles : int
        About how many triangles to build, at least 4,000; the same shapes at every number. Thin bones and membranes
        keep what they need, so that the coarsest scene has about 20,000.
    seed : int
        Of the low-frequency displacement that makes each surface organic.

    Returns
    -------
    Scene
        World frame in mm: x to the mother's left, y to her back, z up. `mesh.metadata["name"]` says what each
        structure is.

    Raises
    ------
    ValueError
        When `triangles` is too small for the anatomy.
    """
    if triangles < FEWEST_TRIANGLES:
        raise ValueError(f"fetal_abdomen: triangles must be at least {FEWEST_TRIANGLES}, not {triangles}")
    mother_scale = math.sqrt(MOTHER_AT_SCALE_1 / (MOTHER_SHARE * triangles))
    scale = math.sqrt(FETUS_AT_SCALE_1 / ((1.0 - MOTHER_SHARE) * triangles))
    tissues = load_tissues()
    structures = [
        *mother(tissues, mother_scale, seed),
        *umbilical_cord(tissues, scale),
        *fetal_body(tissues, scale, seed + 100),
        *fetal_organs(tissues, scale, seed + 200),
        *fetal_head(tissues, scale, seed + 300),
        *fetal_skeleton(tissues, scale),
    ]
    return Scene(tuple(structures), tissues["coupling_gel"], "fetal_abdomen")


def fetal_sites() -> SiteGrid:
    """Probe sites that look at the uterus of `fetal_abdomen` through the mother's front: mm and degrees."""
    return SiteGrid(
        axis=(0.0, 0.0, 1.0),
        front=(0.0, -1.0, 0.0),
        heights_mm=tuple(float(height) for height in range(-60, 75, 15)),
        angles_deg=tuple(float(angle) for angle in range(-48, 49, 12)),
        tilts_deg=(-15.0, 0.0, 15.0),
        rolls_deg=(0.0, 90.0),
        region=("uterus",),
    )
