"""The built-in anatomy: a mother's abdomen with a fetus of 22 weeks, generated and not downloaded."""

from __future__ import annotations

import math
from pathlib import Path

from ablate.anatomy.cord_route import cord_route
from ablate.anatomy.fetal_belly import fetal_belly
from ablate.anatomy.fetal_body import fetal_body
from ablate.anatomy.fetal_chest import fetal_chest
from ablate.anatomy.fetal_girdles import fetal_girdles
from ablate.anatomy.fetal_head import fetal_head
from ablate.anatomy.fetal_limbs import limb_bones, limb_flesh
from ablate.anatomy.fetal_skeleton import fetal_skeleton
from ablate.anatomy.mother import mother
from ablate.anatomy.patient import draw_patient
from ablate.anatomy.placenta import placenta
from ablate.anatomy.scene import ANATOMY_VERSION, Scene
from ablate.anatomy.scene_cache import cached_scene
from ablate.anatomy.sites import SiteGrid
from ablate.anatomy.tissues import load_tissues
from ablate.anatomy.umbilical_cord import umbilical_cord

#: Triangles that the mother and the fetus have at grid scale 1, and the mother's share (the paper's 275k of 675k).
MOTHER_AT_SCALE_1 = 420_000
FETUS_AT_SCALE_1 = 680_000
MOTHER_SHARE = 275 / 675
FEWEST_TRIANGLES = 4_000


def fetal_abdomen(triangles: int = 675_000, seed: int = 0, cache_dir: str | Path | None = None) -> Scene:
    """Second-trimester abdomen: BPD 54 mm, HC 200 mm, AC 175 mm, FL 39 mm, times the patient's size.

    Parameters
    ----------
    triangles : int
        About how many triangles to build, at least 4,000; the same shapes at every number. Thin bones and membranes
        keep what they need, so that the coarsest scene has about 25,000.
    seed : int
        Which patient: size, presentation and lie of the fetus, its limbs, the site of the placenta, the way of the
        cord, and the low-frequency displacement that makes each surface organic. 0 is the picture-book case, of size
        1; see `draw_patient`.
    cache_dir : path, optional
        Where a built scene is kept and read again; without it nothing is written.

    Returns
    -------
    Scene
        World frame in mm: x to the mother's left, y to her back, z up. `mesh.metadata["name"]` says what each
        structure is.

    Raises
    ------
    ValueError
        When `triangles` is too small for the anatomy, or `seed` is negative.
    """
    if triangles < FEWEST_TRIANGLES:
        raise ValueError(f"fetal_abdomen: triangles must be at least {FEWEST_TRIANGLES}, not {triangles}")
    if seed < 0:
        raise ValueError(f"fetal_abdomen: seed must be at least 0, not {seed}")
    if cache_dir is None:
        return _build(triangles, seed)
    return cached_scene(
        Path(cache_dir), lambda: _build(triangles, seed), triangles=triangles, seed=seed, version=ANATOMY_VERSION
    )


def _build(triangles: int, seed: int) -> Scene:
    mother_scale = math.sqrt(MOTHER_AT_SCALE_1 / (MOTHER_SHARE * triangles))
    scale = math.sqrt(FETUS_AT_SCALE_1 / ((1.0 - MOTHER_SHARE) * triangles))
    tissues, patient = load_tissues(), draw_patient(seed)
    path, insertion = cord_route(patient)
    fetus = [
        fetal_body(tissues, scale, seed + 100),
        *limb_flesh(tissues, scale, seed + 100, patient.limbs),
        *fetal_belly(tissues, scale, seed + 200),
        *fetal_chest(tissues, scale, seed + 200),
        *fetal_head(tissues, scale, seed + 300),
        *fetal_skeleton(tissues, scale),
        *fetal_girdles(tissues, scale),
        *limb_bones(tissues, scale, patient.limbs),
    ]
    for structure in fetus:
        structure.mesh.vertices = patient.to_world(structure.mesh.vertices)
    structures = [
        *mother(tissues, mother_scale, seed),
        *placenta(tissues, mother_scale, seed, patient.placenta, insertion),
        *umbilical_cord(tissues, scale, path),
        *fetus,
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
