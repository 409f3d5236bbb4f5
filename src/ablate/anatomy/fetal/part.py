"""Parts of the built-in anatomy, before their tissues are looked up."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh


class Part(NamedTuple):
    """A closed surface, mm, with its name in `mesh.metadata["name"]`, and the name of its tissue in the table."""

    mesh: trimesh.Trimesh
    tissue: str


def moved(parts: list[Part], to: Callable[[np.ndarray], np.ndarray]) -> list[Part]:
    """The same parts, with `to` applied to their vertices (n, 3), mm."""
    for part in parts:
        part.mesh.vertices = to(part.mesh.vertices)
    return parts
