"""What is said where a scene has more structures than labels."""

from types import SimpleNamespace
from typing import Any

import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.dataset.classes import by_structure

_MADE_ELSEWHERE: Any = SimpleNamespace(probe=None, simulator=None, folder="pairs-1")


@pytest.mark.parametrize(
    ("structures", "said"),
    [(253, "pairs-1 was not simulated, allowed is tissues"), (254, "254 structures, allowed are at most 253")],
)
def test_a_scene_has_as_many_structures_as_its_message_counts(structures: int, said: str) -> None:
    tissue = Tissue("liver", 1578, 1.65, 0.7)
    meshes = [trimesh.Trimesh(metadata={"name": f"part {number}"}) for number in range(structures)]
    scene = Scene(tuple(Structure(mesh, tissue) for mesh in meshes), Tissue("gel"), "parts")
    with pytest.raises(ValueError, match=rf"^dataset\.classes=structures: {said}$"):
        by_structure(_MADE_ELSEWHERE, scene)
