"""The program as its users start it: bad input is one line, an exit code, and nothing written."""

import ast
import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import ablate
from ablate.__main__ import main
from ablate.command.launch import Launch
from ablate.settings.study import TrackingSettings
from ablate.study.job import Job
from ablate.tasks.entry import execute


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
        "import sys; import ablate.tasks.entry; from ablate.command.compose import jobs_of;"
        "assert len(jobs_of(['-m', 'variant=sa2h,nsa2h', 'seed=0,1'])) == 4;"
        "print(sorted({name.partition('.')[0] for name in sys.modules}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    heavy = {"torch", "lightning", "numba", "embreex", "mlflow", "trimesh", "scipy", "skimage", "pandas", "matplotlib"}
    assert not set(ast.literal_eval(done.stdout)) & heavy


def test_a_job_that_fails_is_shown_where_it_happened_and_the_next_one_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def study(jobs: list[Job], launch: Launch) -> int:
        assert not launch.elsewhere
        launch.start(jobs, broken)
        return 0

    def broken(job: Job) -> None:
        raise FloatingPointError(f"{job.name}: the loss is not finite")

    monkeypatch.setattr("ablate.tasks.run_task.study", study)
    monkeypatch.setattr("sys.argv", ["ablate", "-m", "variant=sa2h,nsa2h", f"runs_dir={tmp_path}"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 0
    shown = capfd.readouterr().err
    assert shown.count("in broken") == 2
    assert "sa2h/seed0: the loss is not finite" in shown
    assert "nsa2h/seed0: the loss is not finite" in shown


FULL = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "last.ckpt")


def test_a_full_disk_is_one_line_for_a_job_and_for_the_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise FULL

    def study(jobs: list[Job], launch: Launch) -> int:
        launch.start(jobs, full)
        raise FULL

    monkeypatch.setattr("ablate.tasks.run_task.study", study)
    monkeypatch.setattr("sys.argv", ["ablate", f"runs_dir={tmp_path}"])
    with pytest.raises(SystemExit, match=r"^ablate: \[Errno 28\] .*'last\.ckpt'; the same command continues"):
        main()
    assert capsys.readouterr().err == "sa2h/seed0: [Errno 28] No space left on device: 'last.ckpt'\n"


@pytest.mark.parametrize("task", ["study", "describe"])
def test_want_of_memory_is_one_line_and_what_goes_on_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, task: str
) -> None:
    monkeypatch.setattr("ablate.tasks.run_task.study", lambda *_: np.empty(2**50))
    monkeypatch.setattr("ablate.tasks.run_task.describe", lambda *_: np.empty(2**50))
    monkeypatch.setattr("sys.argv", ["ablate", f"runs_dir={tmp_path}", f"task={task}"])
    with pytest.raises(SystemExit, match=r"^ablate: out of memory: Unable to allocate") as end:
        main()
    assert "\n" not in str(end.value)
    assert str(end.value).endswith("; the same command continues where it stopped") == (task == "study")


def test_a_reader_that_has_had_enough_is_no_error(tmp_path: Path) -> None:
    command = f"{sys.executable} -m ablate task=describe runs_dir={tmp_path}; echo $? >&2"
    done = subprocess.run(["sh", "-c", f"{{ {command}; }} | true"], capture_output=True, text=True, check=True)
    assert done.stderr == "141\n"


def test_what_another_user_owns_is_refused_with_the_owner_before_anything_starts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lock = tmp_path / "quick-fetal" / ".claim.lock"
    lock.parent.mkdir()
    lock.touch()
    access = os.access
    monkeypatch.setattr("os.access", lambda path, *a, **k: Path(path) != lock and access(path, *a, **k))  # also root's
    monkeypatch.setattr("sys.argv", ["ablate", f"runs_dir={tmp_path}"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    told = f"ablate: runs_dir: {lock} belongs to {lock.owner()}, and you may not write it; docs/cluster.md says"
    assert capsys.readouterr().err.startswith(told)


class _Dying:
    def __init__(self, number: int) -> None:
        self.number = number

    def __del__(self) -> None:  # Python drops what a signal raises here
        os.kill(os.getpid(), self.number)


@pytest.mark.parametrize("dropped", [False, True])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_ends_the_program_is_said_and_what_is_open_is_closed(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    number: signal.Signals,
    dropped: bool,
) -> None:
    closed = []

    def signalled(*_: object) -> None:
        try:
            if dropped:
                _Dying(number)
                for _ in range(100):
                    time.sleep(0.1)
            os.kill(os.getpid(), number)
        finally:
            closed.append(number)

    monkeypatch.setattr("ablate.tasks.run_task.study", signalled)
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


def test_the_version_is_ours_and_a_pipe_that_closes_is_no_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["--version"]) == 0
    assert capsys.readouterr().out == f"ablate {ablate.__version__}\n"
    help_of = subprocess.Popen([sys.executable, "-m", "ablate", "--help"], stdout=-1, stderr=-1, text=True, bufsize=1)
    assert help_of.stdout is not None
    help_of.stdout.close()
    assert help_of.communicate(timeout=60)[1] == ""


def test_a_module_of_the_folder_is_found_whichever_way_the_program_starts(tmp_path: Path) -> None:
    """The console script has its own folder first among those that Python searches, and not the current one."""
    (tmp_path / "own_metrics.py").write_text("def bias(pair):\n    return 0.0\n")
    script = "import sys; sys.path[0] = '/nowhere'; from ablate.__main__ import main; main()"
    words = ["preset=tiny", "task=plan", "metrics=[own_metrics.bias,own_metrics.variance]", f"runs_dir={tmp_path}"]
    for start in (["-c", script], ["-m", "ablate"]):
        command = [sys.executable, *start, *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (2, "")
        assert "metrics=own_metrics.variance: AttributeError: module 'own_metrics' has no attribute" in done.stderr


def test_the_extra_of_a_launcher_that_is_not_installed_is_named() -> None:
    only_ours = "hydra_plugins.__path__ = [p for p in hydra_plugins.__path__ if 'site-packages' not in p]"
    script = f"import hydra_plugins; {only_ours}; from ablate.__main__ import main; main()"
    for launcher, package, extra in (("joblib", "joblib", "parallel"), ("slurm", "submitit_slurm", "slurm")):
        command = [sys.executable, "-c", script, "-m", f"hydra/launcher={launcher}", "task=plan", "seed=0,1"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        told = f"ablate: hydra/launcher: {package} is not installed: pip install -e '.[{extra}]'\n"
        assert (done.returncode, done.stderr) == (2, told)


@pytest.mark.parametrize("uri", ["http://host:5000", "postgresql://anna@host/db", "sqlite:////a:b/c@d/mlflow.db"])
def test_a_tracking_uri_without_a_password_is_taken(uri: str) -> None:
    assert TrackingSettings(uri=uri).uri == uri


def test_a_screen_without_the_signs_of_a_table_is_written_to() -> None:
    code = (
        "import ablate.__main__ as m; m.execute = lambda _: 0; m.sys.exit = lambda _: None;"
        "m.main(); print('20.1 ± 0.3, χ²')"
    )
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=ascii_only, timeout=60)
    assert (done.returncode, done.stdout) == (0, "20.1 \\xb1 0.3, \\u03c7\\xb2\n")


@pytest.mark.parametrize("words", [["--version"], ["task=plan"], ["-m", "seed=0,1"]])
def test_a_current_folder_that_was_removed_is_said_in_one_line(words: list[str], tmp_path: Path) -> None:
    script = 'mkdir gone && cd gone && rmdir ../gone && "$0" -m ablate "$@"'
    command = ["sh", "-c", script, sys.executable, *words]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stderr.splitlines() == [
        "ablate: the current folder was removed; type cd and a folder that exists, then the command again"
    ]
