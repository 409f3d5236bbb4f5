"""A scene: its identity and imports; kept on disk the same again, made anew when the file is not what was written."""

import logging
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, Tissue, fetal_abdomen, load_tissues
from ablate.anatomy.scene import cached_scene
from support.scene_hash import content_hash

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


def test_hash_is_the_same_in_another_process(built: Callable[[int, int], Scene]) -> None:
    code = "from ablate.anatomy import fetal_abdomen; from support.scene_hash import content_hash"
    code += "; print(content_hash(fetal_abdomen(4000, seed=4)))"
    tests = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[1])}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=tests)
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


def small() -> Scene:
    ball, cube = trimesh.creation.icosphere(1, radius=10 / 3), trimesh.creation.box((20.0, 20.0, 20.0))
    ball.metadata["name"], cube.metadata["name"] = "ball", "cube"
    return Scene((Structure(cube, TISSUES["liver"]), Structure(ball, TISSUES["bile"])), GEL, "two")


@pytest.fixture
def build() -> Mock:
    """Builds the scene, and counts how often."""
    return Mock(side_effect=small)


def test_second_call_reads_the_same_scene_and_other_parameters_are_another_file(tmp_path: Path, build: Mock) -> None:
    first, second = (cached_scene(tmp_path / "new", build, kind="two") for _ in range(2))
    assert build.call_count == 1
    assert (second.name, content_hash(second)) == (first.name, content_hash(first))
    for a, b in zip(first.structures, second.structures, strict=True):
        assert np.array_equal(a.mesh.vertices, b.mesh.vertices)  # the hash rounds them
        assert a.mesh.metadata["name"] == b.mesh.metadata["name"]
    cached_scene(tmp_path / "new", build, kind="three")
    assert build.call_count == 2
    assert [path.suffix for path in (tmp_path / "new").iterdir()] == [".npz", ".npz"]


@pytest.mark.parametrize("harm", ["empty", "cut"])
def test_broken_file_is_built_again(tmp_path: Path, caplog: pytest.LogCaptureFixture, build: Mock, harm: str) -> None:
    cached_scene(tmp_path, build)
    path = next(tmp_path.iterdir())
    path.write_bytes(path.read_bytes()[:500] if harm == "cut" else b"")
    with caplog.at_level(logging.WARNING):
        again = cached_scene(tmp_path, build)
    assert build.call_count == 2
    assert str(path) in caplog.text
    assert content_hash(again) == content_hash(small())
    assert cached_scene(tmp_path, build).name == "two"
    assert build.call_count == 2


def test_a_scene_that_cannot_be_kept_is_still_built(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    taken = tmp_path / "file"
    taken.write_text("not a folder")
    with caplog.at_level(logging.WARNING):
        assert content_hash(cached_scene(taken, small)) == content_hash(small())
    assert "not kept" in caplog.text
    assert taken.read_text() == "not a folder"


def test_fetal_abdomen_is_cached_only_where_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    built = fetal_abdomen(4_000, seed=1)
    assert list(tmp_path.iterdir()) == []
    for _ in range(2):
        assert content_hash(fetal_abdomen(4_000, seed=1, cache_dir=tmp_path / "kept")) == content_hash(built)
    assert len(list((tmp_path / "kept").iterdir())) == 1


def test_a_file_with_any_bit_flipped_gives_the_scene_that_was_written(tmp_path: Path, build: Mock) -> None:
    cached_scene(tmp_path, build)
    path = next(tmp_path.iterdir())
    held = path.read_bytes()
    header = 8 * held.index(b"PK\x01\x02")  # the directory of the archive, where zip's own fields are
    rng = np.random.default_rng(0)
    for bit in (*rng.integers(header, 8 * len(held), 150).tolist(), *rng.integers(0, 8 * len(held), 150).tolist()):
        flipped = bytearray(held)
        flipped[bit // 8] ^= 1 << bit % 8
        path.write_bytes(flipped)
        assert content_hash(cached_scene(tmp_path, build)) == content_hash(small())
    assert build.call_count > 50


LIGHT = """
import sys
from ablate.anatomy.scene import FEWEST_TRIANGLES
from ablate.anatomy import Scene, SiteGrid, Structure, Tissue
from ablate.anatomy import fetal_sites, load_tissues, validate_scene_folder
Scene((), load_tissues()["fat"], "fat"), fetal_sites()
print([name for name in ("trimesh", "scipy", "skimage", "torch", "mapbox_earcut") if name in sys.modules])
"""


def test_tissues_sites_and_scene_folders_need_no_mesh_library() -> None:
    result = subprocess.run([sys.executable, "-c", LIGHT], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
