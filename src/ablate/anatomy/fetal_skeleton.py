"""Spine and ribs of the fetus. Designed in its straight trunk (x, y, s), mm."""

from __future__ import annotations

import numpy as np
import trimesh

from ablate.anatomy.fetal_frame import from_trunk, outline, spine_y
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import joined, spindle, tube

RIB_DEPTH_MM = 4.2  # of a rib's middle under the skin
#: Angle from the back (degrees) that each of the twelve ribs reaches.
RIB_REACH_DEG = (95.0, 112.0, 122.0, 128.0, 130.0, 128.0, 124.0, 116.0, 106.0, 94.0, 74.0, 56.0)
#: Levels of the vertebrae, mm, from the head down, and the distance to the next one: cervical (lower six), thoracic,
#: lumbar, sacral. One is level with the stomach, where the abdominal circumference is taken.
CERVICAL_S_MM = 41.9 + 3.2 * np.arange(5, -1, -1)
THORACIC_S_MM = 38.5 - 4.3 * np.arange(12)
LUMBAR_S_MM = -12.9 - 4.3 * np.arange(5)
SACRAL_S_MM = -34.2 - 3.9 * np.arange(5)
VERTEBRAE_S_MM = np.concatenate([CERVICAL_S_MM, THORACIC_S_MM, LUMBAR_S_MM, SACRAL_S_MM])
CENTRUM_SHARE = 0.62  # of the distance between two vertebrae that is ossified


def fetal_skeleton(tissues: dict[str, Tissue], scale: float) -> list[Structure]:
    """Spinal canal and cord, the ossified centres of the vertebrae, and the ribs; in fetal axes.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every spacing along and around a bone.
    """
    sides = max(4, round(14 / scale))
    s = np.linspace(-50.0, 58.0, max(8, round(90 / scale)))
    canal = np.stack([0.0 * s, spine_y(s) + 4.9, s], axis=1)
    up = (1.0, 0.0, 0.0)
    around = np.interp(s, (-50.0, -36.0), (1.4, 2.4))
    cord = tube(canal[10 * len(s) // 90 : -1], np.linspace(0.8, 1.4, len(canal[10 * len(s) // 90 : -1])), sides, up)
    ribs = [_rib(number, side, scale, sides) for number in range(12) for side in (-1.0, 1.0)]
    parts = [
        ("spinal canal", "csf", [tube(canal, around, sides, up)]),
        ("spinal cord", "brain", [cord]),
        ("fetal vertebral bodies", "fetal_bone", _centra(sides)),
        ("fetal vertebral arches", "fetal_bone", _arches(sides)),
        ("ribs", "fetal_bone", ribs),
    ]
    return [Structure(from_trunk(joined(meshes, name)), tissues[tissue]) for name, tissue, meshes in parts]


def _centra(sides: int) -> list[trimesh.Trimesh]:
    """One ossification centre a vertebra, in its body: blunt at both ends."""
    x = np.array([-1.0, -0.9, -0.6, 0.0, 0.6, 0.9, 1.0])
    blunt = np.array([0.5, 0.8, 1.0, 1.0, 1.0, 0.8, 0.5])
    bodies = []
    for s, distance in zip(VERTEBRAE_S_MM, np.abs(np.gradient(VERTEBRAE_S_MM)), strict=True):
        size = float(np.interp(s, (-52.0, -36.0, -16.0, 20.0, 58.0), (0.55, 0.9, 1.1, 0.95, 0.8)))
        path = np.stack([2.9 * size * x, np.full(7, float(spine_y(s))), np.full(7, s)], axis=1)
        radii = blunt[:, None] * (CENTRUM_SHARE * distance / 2.0, 2.1 * size)
        bodies.append(tube(path, radii, sides, up=(0.0, 0.0, 1.0)))
    return bodies


def _arches(sides: int) -> list[trimesh.Trimesh]:
    """Two ossification centres a vertebra, either side of the canal, which nearly meet behind it."""
    arches = []
    for s in VERTEBRAE_S_MM:
        y, size = float(spine_y(s)), float(np.interp(s, (-52.0, -36.0), (0.6, 1.0)))
        for side in (-1.0, 1.0):
            start, end = (side * 4.7 * size, y + 2.6, s), (side * 0.75, y + 3.2 + 5.4 * size, s - 0.6)
            arches.append(spindle(start, end, (1.1, 1.0), sides))
    return arches


def _rib(number: int, side: float, scale: float, sides: int) -> trimesh.Trimesh:
    """A rib: from beside the spine around the chest, sinking towards the front, the lower ones more."""
    angle = np.deg2rad(np.linspace(20.0, RIB_REACH_DEG[number], max(5, round(44 / scale))))
    s = THORACIC_S_MM[number] - (3.0 + 1.8 * number) * (angle / 2.2) ** 1.3 + 2.2 * np.clip(angle - 1.6, 0.0, None)
    width, depth, middle = outline(s)
    under = RIB_DEPTH_MM
    path = np.stack([side * (width - under) * np.sin(angle), middle + (depth - under) * np.cos(angle), s], axis=1)
    return tube(path, np.linspace(1.0, 0.85, len(path)), sides)
