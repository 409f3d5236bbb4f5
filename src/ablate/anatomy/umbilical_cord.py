"""The umbilical cord: jelly around two arteries that wind about a vein, from the navel to the placenta."""

from __future__ import annotations

import numpy as np

from ablate.anatomy.cord_route import JELLY_MM
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import frames, joined, tube

WIND_MM = 26.0  # length of one turn of the arteries
VESSELS = ((0.0, 1.7, 1.6), (132.0, 2.6, 0.95), (228.0, 2.6, 0.95))  # angle (deg), from the middle, radius (mm)
WALL_MM = 0.3


def umbilical_cord(tissues: dict[str, Tissue], scale: float, path: np.ndarray) -> list[Structure]:
    """Jelly, vessel walls and blood, in world mm.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every spacing along and around the cord.
    path : (n, 3) float, mm
        The cord's middle line, from the fetus to the placenta.
    """
    step = np.linalg.norm(np.diff(path, axis=0), axis=1)
    length = np.r_[0.0, np.cumsum(step)]
    at = np.linspace(0.0, length[-1], max(24, round(length[-1] / min(1.1 * scale, 2.2))))
    path = np.stack([np.interp(at, length, path[:, i]) for i in range(3)], axis=1)
    first, second = frames(path, (0.0, 0.0, 1.0))
    walls, lumens = [], []
    for start_deg, off_axis_mm, radius in VESSELS:
        angle = (np.deg2rad(start_deg) + 2.0 * np.pi * at / WIND_MM)[:, None]
        winding = path + off_axis_mm * (np.cos(angle) * first + np.sin(angle) * second)
        sides = max(3, round(12 / scale))
        walls.append(tube(winding[1:-1], np.full(len(path) - 2, radius + WALL_MM), sides))
        lumens.append(tube(winding[2:-2], np.full(len(path) - 4, radius), sides))
    jelly = joined([tube(path, np.full(len(path), JELLY_MM), max(5, round(20 / scale)))], "umbilical cord")
    return [
        Structure(jelly, tissues["wharton_jelly"]),
        Structure(joined(walls, "cord vessel walls"), tissues["vessel_wall"]),
        Structure(joined(lumens, "cord vessels"), tissues["blood"]),
    ]
