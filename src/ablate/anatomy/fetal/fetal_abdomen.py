"""The built-in anatomy as a scene: a mother's abdomen with a fetus of 22 weeks, generated and not downloaded."""

from pathlib import Path

from ablate.anatomy.fetal.axes import curl, head_to_fetus
from ablate.anatomy.fetal.body import fetal_body, limb_flesh
from ablate.anatomy.fetal.bones import face_bones, limb_bones, trunk_bones
from ablate.anatomy.fetal.head import fetal_head
from ablate.anatomy.fetal.mother import mother
from ablate.anatomy.fetal.organs import fetal_belly, fetal_chest
from ablate.anatomy.fetal.parts import grid_scales, moved
from ablate.anatomy.fetal.placenta import placenta
from ablate.anatomy.fetal.pregnancy import draw_pregnancy
from ablate.anatomy.fetal.umbilical_cord import cord_route, umbilical_cord
from ablate.anatomy.scene import ANATOMY_VERSION, Scene, Structure
from ablate.anatomy.scene_cache import cached_scene
from ablate.anatomy.tissue import load_tissues


def fetal_abdomen(triangles: int = 675_000, seed: int = 0, cache_dir: str | Path | None = None) -> Scene:
    """Second-trimester abdomen: BPD 54 mm, HC 200 mm, AC 175 mm, FL 39 mm, times the size of the fetus.

    World frame in mm: x to the mother's left, y to her back, z up. `mesh.metadata["name"]` says what each structure is.

    Parameters
    ----------
    triangles : int
        About how many triangles to build, at least 4,000; the same shapes at every number. Thin bones and membranes
        keep what they need, so that the coarsest scene has about 25,000.
    seed : int
        Which pregnancy: size, presentation and lie of the fetus, its limbs, the site of the placenta, the way of the
        cord, and the low-frequency displacement of each surface. 0 is the textbook case, of size 1.
    cache_dir : path, optional
        Where a built scene is kept and read again; without it nothing is written.

    Raises
    ------
    ValueError
        When `triangles` is too small for the anatomy, or `seed` is negative.

    Examples
    --------
    >>> scene = fetal_abdomen(triangles=4_000)
    >>> scene.structures[0].mesh.metadata["name"], len(scene.structures), scene.background.name
    ('skin', 78, 'coupling_gel')
    """
    scales = grid_scales(triangles)
    if seed < 0:
        raise ValueError(f"fetal_abdomen: seed must be at least 0, not {seed}")
    parameters = {"triangles": triangles, "seed": seed, "version": ANATOMY_VERSION}
    return cached_scene(cache_dir, lambda: _build(*scales, seed), **parameters)


def _build(mother_scale: float, scale: float, seed: int) -> Scene:
    pregnancy = draw_pregnancy(seed)
    path, insertion = cord_route(pregnancy)
    fetus = [
        fetal_body(scale, seed + 100),
        *limb_flesh(scale, seed + 100, pregnancy.limbs),
        *moved([*fetal_belly(scale, seed + 200), *fetal_chest(scale, seed + 200)], curl),
        *moved(fetal_head(scale, seed + 300), head_to_fetus),
        *moved(trunk_bones(scale), curl),
        *moved([face_bones(scale)], head_to_fetus),
        *limb_bones(scale, pregnancy.limbs),
    ]
    parts = [
        *mother(mother_scale, seed),
        *placenta(mother_scale, seed, pregnancy.placenta, insertion),
        *umbilical_cord(scale, path),
        *moved(fetus, pregnancy.to_world),
    ]
    tissues = load_tissues()
    structures = tuple(Structure(part.mesh, tissues[part.tissue]) for part in parts)
    return Scene(structures, tissues["coupling_gel"], "fetal_abdomen")
