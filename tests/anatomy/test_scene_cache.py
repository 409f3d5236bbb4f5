"""Built scenes on disk: the same scene again, made anew when the file is not what was written."""

import logging
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import trimesh

from ablate.anatomy import Scene, Structure, content_hash, fetal_abdomen, load_tissues
from ablate.anatomy.scene import cached_scene


def small() -> Scene:
    tissues = load_tissues()
    ball, cube = trimesh.creation.icosphere(1, radius=10 / 3), trimesh.creation.box((20.0, 20.0, 20.0))
    ball.metadata["name"], cube.metadata["name"] = "ball", "cube"
    return Scene((Structure(cube, tissues["liver"]), Structure(ball, tissues["bile"])), tissues["coupling_gel"], "two")


@pytest.fixture
def build() -> Mock:
    """Builds the scene, and counts how often."""
    return Mock(side_effect=small)


def test_second_call_reads_the_same_scene_and_other_parameters_are_another_file(tmp_path: Path, build: Mock) -> None:
    first, second = (cached_scene(tmp_path / "new", build, kind="two") for _ in range(2))
    assert build.call_count == 1
    assert second.name == first.name
    assert second.background == first.background
    for a, b in zip(first.structures, second.structures, strict=True):
        assert np.array_equal(a.mesh.vertices, b.mesh.vertices)
        assert np.array_equal(a.mesh.faces, b.mesh.faces)
        assert a.tissue == b.tissue
        assert a.mesh.metadata["name"] == b.mesh.metadata["name"]
    cached_scene(tmp_path / "new", build, kind="three")
    assert build.call_count == 2
    assert [path.suffix for path in (tmp_path / "new").iterdir()] == [".npz", ".npz"]


@pytest.mark.parametrize("harm", ["empty", "cut", "other scene"])
def test_broken_file_is_built_again(tmp_path: Path, caplog: pytest.LogCaptureFixture, build: Mock, harm: str) -> None:
    cached_scene(tmp_path, build)
    path = next(tmp_path.iterdir())
    if harm == "other scene":
        with np.load(path) as arrays:
            np.savez(path, **{**arrays, "vertices": arrays["vertices"] + 1.0})
    else:
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
