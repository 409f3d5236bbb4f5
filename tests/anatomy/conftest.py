"""Built-in scenes, each made once."""

from collections.abc import Callable
from functools import cache

import pytest
import trimesh

from ablate.anatomy import Scene, fetal_abdomen


@pytest.fixture(scope="session")
def built() -> Callable[[int, int], Scene]:
    """The built-in scene of some triangles and a seed."""
    return cache(fetal_abdomen)


@pytest.fixture(scope="session")
def scene(built: Callable[[int, int], Scene]) -> Scene:
    """The textbook case, fine enough for all its parts."""
    return built(100_000, 0)


@pytest.fixture(scope="session")
def mesh_of() -> Callable[..., trimesh.Trimesh]:
    """The mesh of a name, the first one unless said otherwise."""

    def find(scene: Scene, name: str, occurrence: int = 0) -> trimesh.Trimesh:
        return [s.mesh for s in scene.structures if s.mesh.metadata["name"] == name][occurrence]

    return find
