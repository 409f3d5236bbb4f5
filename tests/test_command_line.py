"""The program as its users start it: bad input is one line, an exit code, and nothing written."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from ablate.__main__ import main
from ablate.studies.sweep import Job

SCENE = {
    "unit": "mm",
    "background": "coupling_gel",
    "structures": [{"mesh": "body.obj", "tissue": "soft_tissue"}],
    "sites": {
        "axis": [0, 0, 1],
        "front": [0, -1, 0],
        "heights": {"range": [-10, 10], "count": 8},
        "angles": {"range": [-20, 20], "count": 8},
        "tilts": [0],
        "rolls": [0],
    },
}


def refused(tmp_path: Path, *arguments: str) -> str:
    command = [sys.executable, "-m", "ablate", f"runs_dir={tmp_path / 'runs'}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=60)
    assert done.returncode == 2
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert not list((tmp_path / "runs").glob("*/*")), "something was started"
    return lines[0]


def scene_folder(tmp_path: Path, **changes: object) -> Path:
    folder = tmp_path / "scene"
    folder.mkdir()
    body = trimesh.creation.icosphere(3, radius=60)
    body.export(folder / "body.obj")
    wave = np.sin(2 * np.arctan2(body.triangles_center[:, 1], body.triangles_center[:, 0]))
    torn = body.faces[body.triangles_center[:, 2] < 12.0 * wave]
    trimesh.Trimesh(body.vertices, torn, process=False).export(folder / "torn.obj")
    (folder / "garbage.ply").write_bytes(b"not a mesh")
    (folder / "nan.obj").write_text("v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n")
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
        ({"mesh": "torn.obj", "tissue": "liver"}, "torn.obj: cannot be closed: a hole of 1"),
        ({"mesh": "garbage.ply", "tissue": "liver"}, "garbage.ply: not readable as a mesh"),
        ({"mesh": "nan.obj", "tissue": "liver"}, "nan.obj: has vertices that are not finite"),
    ],
)
def test_bad_scenes_are_refused_in_one_line(tmp_path: Path, structure: dict[str, str], named: str) -> None:
    folder = scene_folder(tmp_path, structures=[structure])
    message = refused(tmp_path, "scene=folder", f"scene.folder={folder}", "dataset.frames=12")
    assert named in message


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"unit": "m"}, "scene.yaml: unit: m makes the scene's largest extent 1.2e+05 mm"),
        ({"sites": {"heights": {"range": [500, 600], "count": 4}, "tilts": [-5, 0, 5]}}, "12 the direction misses"),
        ({"sites": {"heights": {"range": [0, 1]}}}, "sites.heights.count"),
        ({"sites": None}, "no `sites`"),
    ],
)
def test_bad_units_and_sites_are_refused_in_one_line(tmp_path: Path, changes: dict[str, object], named: str) -> None:
    folder = scene_folder(tmp_path, **changes)
    assert named in refused(tmp_path, "scene=folder", f"scene.folder={folder}", "dataset.frames=12")


def test_a_runs_directory_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "file/runs" in refused(tmp_path, f"runs_dir={tmp_path / 'file' / 'runs'}")


def test_a_job_that_fails_is_shown_where_it_happened_and_the_next_one_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def study(_: object, launch: Callable[[], None], elsewhere: bool) -> int:
        assert not elsewhere
        launch()
        return 0

    def broken(job: Job) -> None:
        raise FloatingPointError(f"{job.name}: the loss is not finite")

    monkeypatch.setattr("ablate.studies.tasks.study", study)
    monkeypatch.setattr("ablate.studies.run.run_job", broken)
    monkeypatch.setattr("sys.argv", ["ablate", "-m", "variant=sa2h,nsa2h", f"runs_dir={tmp_path}"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0
    shown = capsys.readouterr().err
    assert shown.count("in broken") == 2
    assert "sa2h/seed0: the loss is not finite" in shown
    assert "nsa2h/seed0: the loss is not finite" in shown
