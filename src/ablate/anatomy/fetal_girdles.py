"""Shoulder blades, collar bones and pelvis of the fetus, and the bones of its face."""

from __future__ import annotations

import numpy as np
import trimesh

from ablate.anatomy.fetal_frame import from_head, from_trunk, outline
from ablate.anatomy.fetal_head import EYE_CENTER
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, rod, smooth_path, spindle, tube

SCAPULA_DEPTH_MM = 2.3  # of its middle under the skin
SIDES = (-1.0, 1.0)


def fetal_girdles(tissues: dict[str, Tissue], scale: float) -> list[Structure]:
    """The bones in fetal axes.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every spacing along and around a bone.
    """
    sides = max(4, round(12 / scale))
    bone = tissues["fetal_bone"]
    return [
        Structure(from_trunk(joined([_scapula(side, scale, sides) for side in SIDES], "scapulae")), bone),
        Structure(from_trunk(joined(_girdles(sides), "clavicles and pelvis")), bone),
        Structure(from_head(joined(_face(scale, sides), "face and skull base")), bone),
    ]


def _scapula(side: float, scale: float, sides: int) -> trimesh.Trimesh:
    """A thin triangle, its tip down, that follows the back of the chest."""
    t = np.linspace(0.0, 1.0, max(6, round(24 / scale)))
    s, angle = 37.0 - 19.0 * t, np.deg2rad(47.0 - 7.0 * t)
    width, depth, middle = (part - SCAPULA_DEPTH_MM for part in outline(s))
    path = np.stack([side * width * np.sin(angle), middle + SCAPULA_DEPTH_MM + depth * np.cos(angle), s], axis=1)
    half = np.interp(t, (0.0, 0.06, 0.2, 1.0), (2.0, 4.0, 5.2, 1.2))
    radii = np.stack([np.full(len(t), 0.55), half], axis=1)
    return tube(path, radii, 2 * sides, up=(side * np.sin(angle[0]), np.cos(angle[0]), 0.0))


def _girdles(sides: int) -> list[trimesh.Trimesh]:
    """Collar bones, iliac wings, ischia and pubic bones."""
    bones = []
    for side in SIDES:
        bones += [
            rod((side * 4.0, -13.0, 37.0), (side * 16.5, -4.5, 39.5), 1.1, sides, 1.2),
            spindle(
                (side * 6.5, 11.5, -39.0), (side * 15.5, 1.0, -41.0), (1.1, 5.2), sides, up=(side * 0.75, 0.65, 0.1)
            ),
            spindle((side * 7.0, 4.5, -51.0), (side * 8.5, -1.5, -56.5), (1.5, 1.8), sides),
            rod((side * 2.0, -11.5, -52.5), (side * 7.0, -8.0, -50.5), 1.1, sides),
        ]
    return bones


def _face(scale: float, sides: int) -> list[trimesh.Trimesh]:
    """Lower jaw, upper jaw, nasal bone and the X of the skull base, in the head's axes."""
    turn = np.linspace(-1.0, 1.0, max(8, round(36 / scale)))
    jaw = np.stack([13.5 * np.sin(turn * 1.57), -33.5 + 20.0 * np.abs(turn) ** 2.2, -34.5 + 7.5 * turn**2], axis=1)
    upper = np.stack([10.5 * np.sin(turn * 1.57), -36.0 + 13.0 * np.abs(turn) ** 2.2, -26.5 + 0.0 * turn], axis=1)
    bones = [
        tube(jaw, np.full(len(turn), 1.2), sides),
        tube(upper, np.full(len(turn), 1.2), sides),
        spindle((0.0, -37.8, -17.5), (0.0, -39.6, -22.5), (0.7, 1.3), sides, up=(0.0, 1.0, -0.3)),
    ]
    for side in SIDES:
        bones.append(rod((side * 5.0, 4.0, -20.5), (side * 17.5, 11.5, -17.5), 1.5, sides))
        bones.append(rod((side * 4.5, -6.5, -20.0), (side * 16.5, -18.5, -16.0), 1.2, sides))
        bones += [_orbit_wall(side, 5.6, 4.4, sides), _orbit_wall(side, -5.9, -5.3, sides)]
    return bones


def _orbit_wall(side: float, rim_mm: float, end_mm: float, sides: int) -> trimesh.Trimesh:
    """A plate beside an eye, as far from its middle as given at the rim and behind."""
    x, y, z = EYE_CENTER
    path = [(side * (x + rim_mm), y + 2.0, z), (side * (x + rim_mm), y + 4.0, z), (side * (x + end_mm), y + 6.5, z)]
    count = max(5, sides)
    radii = np.stack([np.full(count, 0.5), np.linspace(3.4, 2.6, count)], axis=1)
    return tube(smooth_path(path, count), radii, 2 * sides, up=(side, 0.0, 0.0))
