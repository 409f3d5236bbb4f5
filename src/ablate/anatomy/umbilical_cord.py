"""The umbilical cord: jelly around two arteries that wind about a vein, from the navel to the placenta."""

from __future__ import annotations

import numpy as np

from ablate.anatomy.fetal_frame import curl, to_world
from ablate.anatomy.scene import Structure, Tissue
from ablate.anatomy.sweep import frames, joined, smooth_path, tube

NAVEL = ((0.0, -24.0, -27.0), (0.0, -34.0, -27.0))  # in the trunk: under the skin, and before it
#: The way through the free fluid to the placenta, world mm; at least 6 mm from the fetus and the wall.
WAY = (
    (42.0, -42.0, 34.0),
    (47.0, -48.0, 50.0),
    (38.0, -50.0, 64.0),
    (23.0, -51.0, 67.0),
    (15.0, -60.0, 56.0),
    (17.0, -66.0, 42.0),
    (12.0, -66.0, 29.0),
    (-2.0, -63.0, 22.0),
    (-16.0, -58.0, 24.0),
    (-31.0, -55.0, 33.0),
)
JELLY_MM = 5.0  # radius
WIND_MM = 26.0  # length of one turn of the arteries
VESSELS = ((0.0, 2.0, 1.9), (150.0, 2.6, 1.15), (235.0, 2.6, 1.15))  # angle (deg), from the middle, radius (mm)
WALL_MM = 0.35


def umbilical_cord(tissues: dict[str, Tissue], scale: float) -> list[Structure]:
    """Jelly, vessel walls and blood, in world mm.

    Parameters
    ----------
    tissues : dict of str to Tissue
    scale : float
        Factor on every spacing along and around the cord.
    """
    navel = to_world(curl(np.array(NAVEL)))
    path = smooth_path(np.concatenate([navel, np.array(WAY)]), max(24, round(260 / scale)))
    first, second = frames(path, (0.0, 0.0, 1.0))
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))]
    walls, lumens = [], []
    for start_deg, off_axis_mm, radius in VESSELS:
        angle = (np.deg2rad(start_deg) + 2.0 * np.pi * length / WIND_MM)[:, None]
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
