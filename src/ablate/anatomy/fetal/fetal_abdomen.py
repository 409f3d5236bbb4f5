"""The built-in anatomy as a scene: generated and not downloaded, and where the probe is held to see standard planes."""

import math
from functools import partial
from operator import itemgetter
from pathlib import Path

import numpy as np

from ablate.anatomy.fetal import body
from ablate.anatomy.fetal.bones import face_bones, limb_bones, trunk_bones
from ablate.anatomy.fetal.heart import HEART_AXES, HEART_CENTER
from ablate.anatomy.fetal.limb_flesh import limb_flesh
from ablate.anatomy.fetal.mother import mother, placenta, torso
from ablate.anatomy.fetal.organs import fetal_belly, fetal_chest, fetal_head
from ablate.anatomy.fetal.pregnancy import Pregnancy, draw_pregnancy
from ablate.anatomy.fetal.shapes import moved, unit
from ablate.anatomy.fetal.umbilical_cord import cord_route, umbilical_cord
from ablate.anatomy.scene import ANATOMY_VERSION, FEWEST_TRIANGLES, Scene, Structure, cached_scene
from ablate.anatomy.tissue import load_tissues

#: Triangles that the mother and the fetus have at grid scale 1, and the mother's share (the paper's 275k of 675k).
_MOTHER_AT_SCALE_1, _FETUS_AT_SCALE_1 = 410_000, 709_000
_MOTHER_SHARE = 275 / 675
DEEPEST_MM = 115.0  # of what is looked at, under the skin
MOST_OBLIQUE_DEG = 35.0  # between the beam and the skin's normal
_ANGLES_DEG = np.arange(-72.0, 73.0, 3.0)  # about the mother's long axis, 0 in front
_HEIGHTS_MM = np.arange(-105.0, 106.0, 5.0)
Direction = np.ndarray | None  # a unit vector (3,)


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
        cord, the mother's fat, and the irregularity of bones and surfaces. 0 is the textbook case, of size 1.
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
    ('skin', 84, 'coupling_gel')
    """
    if triangles < FEWEST_TRIANGLES:
        raise ValueError(f"fetal_abdomen: triangles must be at least {FEWEST_TRIANGLES}, not {triangles}")
    parameters = {"triangles": triangles, "seed": seed, "version": ANATOMY_VERSION}
    scene = cached_scene(cache_dir, lambda: _build(triangles, seed), **parameters)
    object.__setattr__(scene, "looked_at", True)  # tests do, for four seeds, and it takes a second
    return scene


def _build(triangles: int, seed: int) -> Scene:
    mother_scale = math.sqrt(_MOTHER_AT_SCALE_1 / (_MOTHER_SHARE * triangles))
    scale = math.sqrt(_FETUS_AT_SCALE_1 / ((1.0 - _MOTHER_SHARE) * triangles))
    pregnancy = draw_pregnancy(seed)
    path, insertion = cord_route(pregnancy)
    fetus = [
        body.fetal_body(scale, seed + 100),
        *limb_flesh(scale, seed + 100, pregnancy.limbs),
        *moved([*fetal_belly(scale, seed + 200), *fetal_chest(scale, seed + 200)], body.curl),
        *moved(fetal_head(scale, seed + 300), body.head_to_fetus),
        *moved(trunk_bones(scale, seed + 400), body.curl),
        *moved([face_bones(scale)], body.head_to_fetus),
        *limb_bones(scale, pregnancy.limbs),
    ]
    parts = [
        *mother(mother_scale, pregnancy.uterus),
        *placenta(mother_scale, pregnancy.uterus, insertion),
        *umbilical_cord(scale, path),
        *moved(fetus, pregnancy.to_world),
    ]
    tissues = load_tissues()
    parts_with_faces = [part for part in parts if len(part.mesh.faces)]  # a placenta may have no vessels
    structures = tuple(Structure(part.mesh, tissues[part.tissue]) for part in parts_with_faces)
    return Scene(structures, tissues["coupling_gel"], "fetal_abdomen")


def fetal_planes(seed: int = 0, press_mm: float = 8.0) -> dict[str, np.ndarray]:
    """Probe poses that show the standard planes of `fetal_abdomen(seed=seed)`, as well as the skin allows.

    The probe is on the mother's skin, its beam points at the middle of the structure, and its image plane is turned
    into the wanted plane. Of all places on her front and flanks, the one is taken where both fit best.

    Its face lies `press_mm` under the undeformed skin in its middle. The poses, (4, 4) float64, are probe to world, mm:
    `head` (BPD and HC), `abdomen` (AC), `four_chambers`, `femur`, `spine` (sagittal), and `placenta`.

    Raises
    ------
    ValueError
        When `seed` is negative.

    Examples
    --------
    >>> sorted(fetal_planes())
    ['abdomen', 'femur', 'four_chambers', 'head', 'placenta', 'spine']
    """
    pregnancy = draw_pregnancy(seed)
    heart, base = pregnancy.to_world(body.curl(np.stack([HEART_CENTER, HEART_CENTER + 0.1 * HEART_AXES[:, 2]])))
    legs = [pregnancy.to_world(np.stack(pregnancy.limbs.leg(side))[:2]) for side in body.SIDES]
    spine = pregnancy.to_world(body.curl(np.array([[0.0, 12.0, 5.0]])))[0]
    uterus = pregnancy.uterus
    placenta = uterus.center + 0.85 * uterus.radii * uterus.placenta
    left, back, _ = pregnancy.rotation.T
    pose = partial(_pose, press_mm)
    planes = {
        "head": [pose(*head_plane(pregnancy), beam=left)],
        "abdomen": [pose(*abdomen_plane(pregnancy), beam=left)],
        "four_chambers": [pose(heart, unit(base - heart))],
        "femur": [pose((hip + knee) / 2, line=unit(knee - hip)) for hip, knee in legs],
        "spine": [pose(spine, left, beam=back)],
        "placenta": [pose(placenta, np.array([1.0, 0.0, 0.0]), beam=uterus.placenta)],
    }
    # of several planes the one is taken that the probe reaches best
    return {name: min(several, key=itemgetter(0))[1] for name, several in planes.items()}


def head_plane(pregnancy: Pregnancy) -> tuple[np.ndarray, np.ndarray]:
    """Point (3,), mm, and unit normal (3,) of the plane where BPD and HC are measured."""
    return pregnancy.to_world(body.HEAD_ORIGIN), pregnancy.rotation @ body.HEAD_ROTATION[:, 2]


def abdomen_plane(pregnancy: Pregnancy) -> tuple[np.ndarray, np.ndarray]:
    """Point (3,), mm, and unit normal (3,) of the plane where AC is measured."""
    s = body.ABDOMEN_S_MM
    point, ahead = pregnancy.to_world(body.curl(np.array([[0.0, 0.0, s], [0.0, 0.0, s + 1e-3]])))
    return point, unit(ahead - point)


def _pose(
    press_mm: float, point: np.ndarray, normal: Direction = None, line: Direction = None, beam: Direction = None
) -> tuple[float, np.ndarray]:
    """How badly the best pose on the skin fits, and that pose, to see a point in a plane.

    The plane has a normal, or a line in it. `beam` is the best direction of the beam; without it any direction in the
    plane is as good. Signs do not matter.
    """
    skin, inward = _skin()
    towards = point - skin
    depth = np.linalg.norm(towards, axis=1)
    towards /= depth[:, None]
    oblique = np.arccos(np.clip((towards * inward).sum(1), -1.0, 1.0))
    cost = (oblique / np.deg2rad(20.0)) ** 2 + (depth / 120.0) ** 2
    cost += (np.maximum(depth - DEEPEST_MM, 0.0) / 5.0) ** 2
    cost += 1e3 * (oblique > np.deg2rad(MOST_OBLIQUE_DEG))
    if normal is not None:
        cost += (np.arcsin(np.clip(towards @ normal, -1.0, 1.0)) / np.deg2rad(3.0)) ** 2
    if line is not None:
        cost += 4.0 * (towards @ line) ** 2
    if beam is not None:
        cost += 6.0 * (1.0 - (towards @ unit(beam)) ** 2)
    best = int(np.argmin(cost))
    z = towards[best]
    across = normal if line is None else np.cross(z, line)
    y = unit(across - z * (across @ z))
    x = np.cross(y, z)
    if x @ (1.0, 0.0, -1.0) < 0.0:  # her left or her feet belong on the right of the image
        x, y = -x, -y
    pose = np.column_stack([x, y, z, skin[best] + press_mm * z])
    return float(cost[best]), np.vstack([pose, [0.0, 0.0, 0.0, 1.0]])


def _skin() -> tuple[np.ndarray, np.ndarray]:
    """Places on the mother's front and flanks (n, 3), mm, and their inward normals (n, 3)."""
    height, angle = (a.ravel() for a in np.meshgrid(_HEIGHTS_MM, np.deg2rad(_ANGLES_DEG), indexing="ij"))
    outward = np.stack([np.sin(angle), -np.cos(angle), np.zeros_like(angle)], axis=1)
    inner, outer = np.zeros(len(angle)), np.full(len(angle), 200.0)
    for _ in range(30):
        middle = (inner + outer) / 2
        inside = torso(middle * outward[:, 0], middle * outward[:, 1], height) < 0
        inner, outer = np.where(inside, middle, inner), np.where(inside, outer, middle)
    points = inner[:, None] * outward + height[:, None] * (0.0, 0.0, 1.0)
    steps = 0.5 * np.eye(3)
    slope = np.stack([torso(*(points + step).T) - torso(*(points - step).T) for step in steps], axis=1)
    return points, -slope / np.linalg.norm(slope, axis=1, keepdims=True)
