"""A scene's identity."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue, content_hash, load_tissues

TISSUES = load_tissues()


def box_scene(side: float = 10.0, tissue: str = "liver", name: str = "box") -> Scene:
    mesh = trimesh.creation.box((side, side, side))
    return Scene((Structure(mesh, TISSUES[tissue]),), TISSUES["coupling_gel"], name)


def test_tissues_are_background_first_then_by_first_use() -> None:
    box = trimesh.creation.box((1, 1, 1))
    names = ["liver", "blood", "liver", "coupling_gel"]
    scene = Scene(tuple(Structure(box, TISSUES[name]) for name in names), TISSUES["coupling_gel"], "s")
    assert [t.name for t in scene.tissues] == ["coupling_gel", "liver", "blood"]
    assert scene.structure_tissues == (1, 2, 1, 0)


def test_hash_changes_with_shape_tissue_background_and_order_but_not_with_the_name() -> None:
    scene = box_scene()
    assert content_hash(scene) == content_hash(box_scene(name="other"))
    louder = replace(scene.structures[0], tissue=replace(TISSUES["liver"], scatterer_sd=0.5))
    two = (scene.structures[0], Structure(trimesh.creation.icosphere(), TISSUES["blood"]))
    others = [
        box_scene(side=10.001),
        box_scene(tissue="kidney"),
        replace(scene, background=TISSUES["blood"]),
        replace(scene, structures=(louder,)),
        replace(scene, structures=()),
        replace(scene, structures=two),
        replace(scene, structures=two[::-1]),
    ]
    hashes = {content_hash(other) for other in [scene, *others]}
    assert len(hashes) == 1 + len(others)


def test_hash_is_the_same_in_another_process(built: Callable[[int, int], Scene]) -> None:
    code = "from ablate.anatomy import *; print(content_hash(fetal_abdomen(4000, seed=4)))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == content_hash(built(4_000, 4)) != content_hash(built(4_000, 0))


def test_lists_are_taken_as_tuples() -> None:
    box = box_scene()
    assert Scene(list(box.structures), box.background, "box") == box
    tissue = Tissue("striped", texture_mm=[1.0, 2.0, 3.0])
    assert tissue == Tissue("striped", texture_mm=(1.0, 2.0, 3.0))
    assert Scene((), tissue, "all stripes").tissues == (tissue,)


BOX, GEL = trimesh.creation.box((1, 1, 1)), TISSUES["coupling_gel"]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Structure(trimesh.Scene(BOX), GEL), "mesh must be a trimesh.Trimesh, not Scene"),
        (lambda: Structure("liver.obj", GEL), "mesh must be a trimesh.Trimesh, not str"),
        (lambda: Structure(BOX, "liver"), "tissue must be a Tissue, not 'liver'; load_tissues"),
        (lambda: Scene((), "gel", "s"), "background must be a Tissue, not 'gel'"),
        (lambda: Scene((BOX,), GEL, "s"), "structures must be a tuple of Structure"),
    ],
)
def test_what_is_of_another_kind_is_refused_at_once(make: Callable[[], object], message: str) -> None:
    with pytest.raises(TypeError, match=message):
        make()
