"""The heart of the fetus: muscle around four chambers of blood, parted by valves and septa; straight trunk, mm."""

import numpy as np
import trimesh

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.body import TRUNK_BOX, WALL_INSIDE_MM, trunk
from ablate.anatomy.fetal.shapes import Part, joined, solids_in
from ablate.anatomy.fetal.tubes import spindle, tube

HEART_CENTER = np.array([2.6, -3.6, 17.0])
#: The heart's axes as columns: to the apex (left, forward, down), to its left, and up; made orthonormal.
HEART_TOWARDS = np.array([[0.64, 0.62, 0.2], [-0.70, 0.76, 0.0], [-0.26, 0.05, 1.0]])
HEART_AXES = np.linalg.qr(HEART_TOWARDS)[0]
HEART_AXES *= np.sign((HEART_AXES * HEART_TOWARDS).sum(axis=0))
MITRAL_MM, TRICUSPID_MM = -3.7, -2.5  # of the valves' planes to the apex
LEAFLET_MM = 0.6  # thickness of valves and of the septum of the atria


def heart_muscle(seed: int) -> sdf.Field:
    """The heart from outside."""
    walls_mm = (2.6, 2.2, 1.3, 1.3)  # thickest around the left ventricle
    walls = [sdf.shrunk(chamber, -wall_mm) for chamber, wall_mm in zip(_chambers(), walls_mm, strict=True)]
    myocardium = sdf.rippled(sdf.union(walls, 4.0), seed, 0.12, 14.0)
    return sdf.intersection([myocardium, sdf.shrunk(trunk, WALL_INSIDE_MM + 0.4)], 1.0)


def heart(scale: float, seed: int) -> list[Part]:
    """Muscle, blood, the band of the right ventricle, valves and the septum of the atria, outermost first."""
    blood = [sdf.rippled(chamber, seed + 60, 0.06, 9.0) for chamber in _chambers()]
    sides = max(4, round(10 / scale))
    band = spindle(_in_heart((3.9, -0.8, -0.5)), _in_heart((3.4, -7.4, 0.5)), (0.6, 0.8), sides)
    return [
        solids_in(TRUNK_BOX, scale, 7.0)(heart_muscle(seed), "myocardium", 0.65, "heart"),
        sdf.several("blood", "heart chambers", blood, TRUNK_BOX, min(0.5 * scale, 1.6)),
        Part(joined([band], "moderator band"), "myocardium"),
        Part(joined(_leaflets(sides), "valves and atrial septum"), "vessel_wall"),
    ]


def _in_heart(point: tuple[float, float, float]) -> np.ndarray:
    """A point given to the apex, to the heart's left and up, in the straight trunk."""
    return HEART_CENTER + HEART_AXES @ np.array(point)


def _chambers() -> list[sdf.Field]:
    """Two ventricles and two atria, flat where valves and the septum of the atria lie between them.

    The left ventricle reaches farther to the apex, the right one's valve lies nearer to it.
    """

    def ventricle(base: tuple[float, float], apex: tuple[float, float], radii: tuple[float, float]) -> sdf.Field:
        halves = [sdf.capsule(_in_heart((*base, up)), _in_heart((*apex, up)), *radii) for up in (-1.2, 1.2)]
        return sdf.union(halves, 2.0)

    down, left = HEART_AXES[:, 0], HEART_AXES[:, 1]
    sides = [
        (MITRAL_MM, 1.0, ventricle((-3.5, 4.6), (8.0, 1.7), (3.5, 1.8)), ((-7.2, 3.5, 0.0), (4.5, 3.6, 4.1))),
        (TRICUSPID_MM, -1.0, ventricle((-2.5, -4.8), (6.0, -3.6), (3.4, 1.9)), ((-6.6, -3.6, 0.0), (4.7, 3.8, 4.3))),
    ]
    ventricles, atria = [], []
    for valve, side, room, (middle, radii) in sides:
        origin, gap = float(HEART_CENTER @ down) + valve, LEAFLET_MM / 2.0 + 0.1
        beside = sdf.half_space(side * left, side * float(HEART_CENTER @ left) + gap)
        ventricles.append(sdf.intersection([room, sdf.half_space(down, origin + gap)], 0.6))
        atrium = [sdf.ellipsoid(_in_heart(middle), radii, HEART_AXES), sdf.half_space(-down, gap - origin), beside]
        atria.append(sdf.intersection(atrium, 0.6))
    return ventricles + atria


def _leaflets(sides: int) -> list[trimesh.Trimesh]:
    """The closed valves between atria and ventricles and the septum between the atria: thin discs."""
    plates = [((MITRAL_MM, 3.9, 0.0), 0, (3.2, 3.6)), ((TRICUSPID_MM, -4.1, 0.0), 0, (3.3, 3.8))]
    plates.append(((-7.6, 0.0, 0.0), 1, (3.6, 3.2)))
    discs = []
    for middle, axis, radii in plates:
        half = LEAFLET_MM / 2.0 * HEART_AXES[:, axis]
        path = _in_heart(middle) + np.stack([-half, half])
        discs.append(tube(path, np.tile(radii, (2, 1)), 2 * sides, up=HEART_AXES[:, 1 - axis]))
    return discs
