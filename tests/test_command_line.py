"""The program as its users start it: bad input is one line, an exit code, and nothing written."""

import ast
import errno
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml

from ablate.__main__ import main
from ablate.config import TrackingSettings
from ablate.studies.jobs.job import Job
from ablate.studies.jobs.launch import Launch

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


Refused = Callable[..., str]


@pytest.fixture
def refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Refused:
    """Calls the program with arguments that it refuses; gives the line that it prints."""

    def call(*arguments: str) -> str:
        monkeypatch.setattr("sys.argv", ["ablate", f"runs_dir={tmp_path / 'runs'}", *arguments])
        with pytest.raises(SystemExit) as end:
            main()
        assert end.value.code == 2
        printed = capsys.readouterr()
        return only_line(printed.out, printed.err, tmp_path / "runs")

    monkeypatch.chdir(tmp_path)
    return call


def only_line(out: str, error: str, runs: Path) -> str:
    assert out == ""
    lines = error.strip().splitlines()
    assert len(lines) == 1, error
    assert not list(runs.glob("*/*")), "something was started"
    return lines[0]


def test_a_process_ends_with_one_line_and_exit_code_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "ablate", f"runs_dir={tmp_path / 'runs'}", "trainin.steps=3"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, timeout=60)
    assert done.returncode == 2
    assert "did you mean 'training'" in only_line(done.stdout, done.stderr, tmp_path / "runs")


def test_a_command_line_is_checked_without_what_runs_it() -> None:
    """Neither the settings nor the composition of a sweep load what a job needs."""
    code = (
        "import sys; import ablate.config; from ablate.studies.jobs.compose import read_command_line;"
        "assert len(read_command_line(['-m', 'variant=sa2h,nsa2h', 'seed=0,1']).jobs) == 4;"
        "print(sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    heavy = {"torch", "lightning", "numba", "embreex", "mlflow", "trimesh", "scipy", "skimage", "pandas", "matplotlib"}
    assert not set(ast.literal_eval(done.stdout)) & heavy


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
        (["seed=-1"], "seed=-1: allowed are 0 and more"),
        (["-m", "seed=0,-1"], "seed=-1: allowed are 0 and more"),
        (["encoding_seed=-1"], "encoding_seed=-1: allowed are 0 and more"),
        (["scene=folder"], "scene.folder"),
        (["scene=folder", "scene.folder=nowhere"], "nowhere"),
    ],
)
def test_bad_values_are_refused_in_one_line(refused: Refused, arguments: list[str], named: str) -> None:
    assert named in refused(*arguments)


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
def test_bad_scenes_are_refused_in_one_line(
    refused: Refused, tmp_path: Path, structure: dict[str, str], named: str
) -> None:
    folder = scene_folder(tmp_path, structures=[structure])
    message = refused("scene=folder", f"scene.folder={folder}", "dataset.frames=12")
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
def test_bad_units_and_sites_are_refused_in_one_line(
    refused: Refused, tmp_path: Path, changes: dict[str, object], named: str
) -> None:
    folder = scene_folder(tmp_path, **changes)
    assert named in refused("scene=folder", f"scene.folder={folder}", "dataset.frames=12")


def test_a_runs_directory_that_cannot_be_written_is_refused(refused: Refused, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "file/runs" in refused(f"runs_dir={tmp_path / 'file' / 'runs'}")


def test_a_job_that_fails_is_shown_where_it_happened_and_the_next_one_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def study(jobs: list[Job], launch: Launch, elsewhere: bool) -> int:
        assert not elsewhere
        launch(jobs, broken)
        return 0

    def broken(job: Job) -> None:
        raise FloatingPointError(f"{job.name}: the loss is not finite")

    monkeypatch.setattr("ablate.tasks.study", study)
    monkeypatch.setattr("sys.argv", ["ablate", "-m", "variant=sa2h,nsa2h", f"runs_dir={tmp_path}"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0
    shown = capsys.readouterr().err
    assert shown.count("in broken") == 2
    assert "sa2h/seed0: the loss is not finite" in shown
    assert "nsa2h/seed0: the loss is not finite" in shown


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "last.ckpt")


def test_a_full_disk_is_one_line_for_a_job_and_for_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise FULL

    def study(jobs: list[Job], launch: Launch, elsewhere: bool) -> int:  # noqa: ARG001
        launch(jobs, full)
        raise FULL

    monkeypatch.setattr("ablate.tasks.study", study)
    monkeypatch.setattr("sys.argv", ["ablate", f"runs_dir={tmp_path}"])
    with pytest.raises(SystemExit, match=r"^ablate: \[Errno 28\] .*'last\.ckpt'; the same command continues"):
        main()
    assert capsys.readouterr().err == "sa2h/seed0: [Errno 28] No space left on device: 'last.ckpt'\n"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_the_program_is_said_and_what_is_open_is_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], number: signal.Signals
) -> None:
    closed = []

    def signalled(_: object) -> None:
        try:
            os.kill(os.getpid(), number)
        finally:
            closed.append(number)

    monkeypatch.setattr("ablate.tasks.run_task", signalled)
    monkeypatch.setattr("sys.argv", ["ablate", f"runs_dir={tmp_path}"])
    before = signal.signal(number, signal.SIG_DFL)
    try:
        with pytest.raises(SystemExit) as end:
            main()
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert end.value.code == 128 + number
    told = f"ablate: stopped by {number.name}; the same command continues where it stopped\n"
    assert capsys.readouterr().err == told
    assert closed == [number]


@pytest.mark.parametrize(
    "uri",
    [
        "http://anna:canary@host:5000",
        "https://canary@host",
        "'postgresql+psycopg2://anna:can/canary#@host/db'",
        "'mysql://host/db?password=canary'",
        "http://anna:can,canary@host",
        "${oc.env:TRACKING}",
    ],
)
def test_a_password_in_the_tracking_uri_is_refused_and_not_shown(
    refused: Refused, monkeypatch: pytest.MonkeyPatch, uri: str
) -> None:
    monkeypatch.setenv("TRACKING", "http://anna:canary@host:5000")
    said = refused(f"tracking.uri={uri}")
    assert "canary" not in said
    assert "," in uri or "tracking.uri: holds a user or a password" in said


@pytest.mark.parametrize("uri", ["http://host:5000", "postgresql://anna@host/db", "sqlite:////a:b/c@d/mlflow.db"])
def test_a_tracking_uri_without_a_password_is_taken(uri: str) -> None:
    assert TrackingSettings(uri=uri).uri == uri


@pytest.mark.parametrize("task", ["study", "compare"])
def test_a_folder_that_is_read_only_is_refused(
    refused: Refused, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, task: str
) -> None:
    (tmp_path / "runs").mkdir()

    def read_only(dir: Path) -> None:  # root may write anywhere, so a mode would not do
        raise PermissionError(errno.EROFS, os.strerror(errno.EROFS), str(dir))

    monkeypatch.setattr("tempfile.TemporaryFile", read_only)
    assert refused(f"task={task}").endswith("runs cannot be written: Read-only file system")


def test_a_screen_without_the_signs_of_a_table_is_written_to() -> None:
    code = "import sys, ablate.__main__ as m; m.read_command_line = lambda _: None; m.main(); print('20.1 ± 0.3, χ²')"
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=ascii_only, timeout=60)
    assert (done.returncode, done.stdout) == (0, "20.1 \\xb1 0.3, \\u03c7\\xb2\n")
