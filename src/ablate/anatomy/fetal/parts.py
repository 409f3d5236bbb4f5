"""What the built-in anatomy is made of: parts, before their tissues are looked up, and how finely they are meshed."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    import trimesh

FEWEST_TRIANGLES = 4_000
#: Triangles that the mother and the fetus have at grid scale 1, and the mother's share (the paper's 275k of 675k).
_MOTHER_AT_SCALE_1, _FETUS_AT_SCALE_1 = 420_000, 680_000
_MOTHER_SHARE = 275 / 675


def grid_scales(triangles: int) -> tuple[float, float]:
    """Factors on the spacings of the mother's and of the fetus's grids that give about this many triangles.

    Raises ValueError when `triangles` is below `FEWEST_TRIANGLES`.
    """
    if triangles < FEWEST_TRIANGLES:
        raise ValueError(f"fetal_abdomen: triangles must be at least {FEWEST_TRIANGLES}, not {triangles}")
    mother = math.sqrt(_MOTHER_AT_SCALE_1 / (_MOTHER_SHARE * triangles))
    return mother, math.sqrt(_FETUS_AT_SCALE_1 / ((1.0 - _MOTHER_SHARE) * triangles))


class Part(NamedTuple):
    """A closed surface, mm, with its name in `mesh.metadata["name"]`, and the name of its tissue in the table."""

    mesh: trimesh.Trimesh
    tissue: str


def moved(parts: list[Part], to: Callable[[np.ndarray], np.ndarray]) -> list[Part]:
    """The same parts, with `to` applied to their vertices (n, 3), mm."""
    for part in parts:
        part.mesh.vertices = to(part.mesh.vertices)
    return parts
