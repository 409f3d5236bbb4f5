"""The program as its users start it: bad input is one line, an exit code, and nothing written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import trimesh
import yaml

SCENE = {
    "unit": "mm",
    "background": "coupling_gel",
    "structures": [{"mesh": "body.obj", "tissue": "soft_tissue"}],
    "sites": {
        "axis": [0, 0, 1],
        "front": [0, -1, 0],
        "heights": {"range": [-10, 10], "count": 2},
        "angles": {"range": [-20, 20], "count": 2},
        "tilts": [0],
        "rolls": [0],
    },
}


def refused(tmp_path: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "ablate", f"runs_dir={tmp_path / 'runs'}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=60)
    assert done.returncode != 0
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert not list((tmp_path / "runs").glob("*/*")), "something was started"
    return lines[0]


def scene_folder(tmp_path: Path, **changes: object) -> Path:
    folder = tmp_path / "scene"
    folder.mkdir()
    trimesh.creation.icosphere(3, radius=60).export(folder / "body.obj")
    (folder / "empty.obj").write_text("")
    (folder / "scene.yaml").write_text(yaml.safe_dump({**SCENE, **changes}))
    return folder


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["variant=sa3h"], "allowed are"),
        (["-m", "variant=sa2h,sa3h"], "allowed are"),
        (["trainin.steps=3"], "training"),
        (["training.steps=soon"], "Integer"),
        (["dataset.frames=0"], "dataset.frames=0"),
        (["scene=folder"], "scene.folder"),
        (["scene=folder", "scene.folder=nowhere"], "nowhere"),
    ],
)
def test_bad_values_are_refused_in_one_line(tmp_path: Path, arguments: list[str], named: str) -> None:
    assert named in refused(tmp_path, *arguments)


@pytest.mark.parametrize(
    ("structure", "named"),
    [
        ({"mesh": "body.obj", "tissue": "unobtainium"}, "unobtainium"),
        ({"mesh": "absent.obj", "tissue": "liver"}, "absent.obj"),
        ({"mesh": "empty.obj", "tissue": "liver"}, "empty.obj"),
    ],
)
def test_bad_scenes_are_refused_in_one_line(tmp_path: Path, structure: dict[str, str], named: str) -> None:
    folder = scene_folder(tmp_path, structures=[structure])
    message = refused(tmp_path, "scene=folder", f"scene.folder={folder}")
    assert named in message


def test_a_runs_directory_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "file/runs" in refused(tmp_path, f"runs_dir={tmp_path / 'file' / 'runs'}")
