"""A launcher gets every job of a sweep once, and brings it to a process of its own with a GPU of its own.

The number of GPUs is faked.
"""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import torch
from hydra.core.utils import JobReturn, JobStatus

from ablate.command import launch
from ablate.command.compose import jobs_of
from ablate.command.launch import VISIBLE, Launch, devices_to_share, start_here
from ablate.settings.study import ConfigurationError, Task
from ablate.study.job import Job
from ablate.tasks import entry
from ablate.tasks.entry import execute
from ablate.training import DivergenceError

Work = Callable[[Job], object]


@pytest.fixture
def launched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[..., int]:
    """Runs a command line as the program does, with work of the test's in place of a task."""

    def call(work: Work, *arguments: str, skip: int = 0) -> int:
        def do(jobs: Sequence[Job], launch: Launch) -> int:
            launch.start(jobs[skip:], work)
            return 0

        monkeypatch.setattr(entry, "_do", do)
        return execute([*arguments, f"runs_dir={tmp_path / 'runs'}"])

    return call


def leave_a_note(folder: Path) -> Work:
    """Work that writes a file. A local function is pickled whole: the processes of a launcher cannot import tests."""

    def work(job: Job) -> None:
        (folder / f"{job.label}-{job.settings.seed}").write_text(str(job.settings.training.steps))

    return work


def notes(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


def test_a_process_each_carries_the_jobs_that_are_left(launched: Callable[..., int], tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    work = leave_a_note(tmp_path / "notes")
    assert launched(work, "-m", "variant=sa2h,nsa2h", "seed=0,1", "training.steps=7", skip=1) == 0
    assert notes(tmp_path / "notes") == {"sa2h-1": "7", "nsa2h-0": "7", "nsa2h-1": "7"}


def test_a_process_that_is_killed_takes_no_other_with_it(
    launched: Callable[..., int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As the system does when memory runs out; with joblib's own pool the other processes are ended too."""
    folder = str(tmp_path)

    def work(job: Job) -> None:
        import os
        import signal
        import time
        from pathlib import Path

        if job.settings.seed == 0:
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(1)
        (Path(folder) / str(job.settings.seed)).touch()

    launched(work, "-m", "seed=0,1,2")
    assert notes(tmp_path).keys() == {"1", "2"}
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith("sa2h/seed0: its process was ended by SIGKILL")


def test_a_training_that_diverges_is_one_line_and_a_fault_of_the_code_is_shown_where_it_happened(
    capsys: pytest.CaptureFixture[str],
) -> None:
    (job,) = jobs_of(["preset=tiny"])

    def raises(error: Exception) -> str:
        def work(_: Job) -> None:
            raise error

        start_here([job], work)
        return capsys.readouterr().err

    assert raises(DivergenceError("step 2: weights are not finite")) == "sa2h/seed0: step 2: weights are not finite\n"
    assert raises(RuntimeError("no such kernel")).startswith("Traceback")


@pytest.fixture
def heard() -> Iterator[None]:
    """Python raises KeyboardInterrupt, which it does not where the tests were started in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
def test_after_ctrl_c_every_process_saves_what_it_is_at(launched: Callable[..., int], tmp_path: Path) -> None:
    """The launcher is interrupted alone: its processes are told by SIGTERM, and it waits for them."""
    folder = str(tmp_path)

    def work(job: Job) -> None:
        import signal
        import time
        from pathlib import Path

        def save(*_: object) -> None:
            time.sleep(1)
            (Path(folder) / f"saved{job.settings.seed}").touch()
            raise SystemExit

        signal.signal(signal.SIGTERM, save)
        (Path(folder) / f"begun{job.settings.seed}").touch()
        time.sleep(60)

    begun = [tmp_path / "begun0", tmp_path / "begun1"]

    def interrupt() -> None:
        while not all(path.exists() for path in begun):
            time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        launched(work, "-m", "seed=0,1", "hydra.launcher.n_jobs=2")
    assert (tmp_path / "saved0").exists()
    assert (tmp_path / "saved1").exists()


def test_a_single_job_runs_in_this_process_and_sweeps_run_in_batches(
    launched: Callable[..., int], tmp_path: Path
) -> None:
    here = []
    launched(here.append, "variant=nsa2h")
    assert [job.label for job in here] == ["nsa2h"]
    launched(leave_a_note(tmp_path), "-m", "seed=1,2,3", "hydra.sweeper.max_batch_size=2")
    assert set(notes(tmp_path)) == {"sa2h-1", "sa2h-2", "sa2h-3"}


@pytest.mark.parametrize("size", ["0", "-1", "two"])
def test_batches_without_a_job_are_refused(launched: Callable[..., int], size: str) -> None:
    with pytest.raises(ConfigurationError, match=rf"max_batch_size={size}: allowed are 1 and more, or null for all"):
        launched(print, "-m", "seed=0,1", f"hydra.sweeper.max_batch_size={size}")


def test_no_process_at_all_is_refused(launched: Callable[..., int]) -> None:
    with pytest.raises(ConfigurationError, match=r"hydra\.launcher\.n_jobs=0: allowed are 1 and more"):
        launched(print, "-m", "seed=0,1", "hydra.launcher.n_jobs=0")


@pytest.mark.parametrize(
    ("asked", "jobs", "cores", "gpus", "side_by_side"),
    [
        pytest.param(-1, 3, 2, 0, 3, id="a last job would run alone"),
        pytest.param(-1, 4, 2, 0, 2, id="no job runs alone"),
        pytest.param(-1, 5, 4, 0, 5, id="one more than four cores"),
        pytest.param(-1, 6, 4, 0, 4, id="two in the last round"),
        pytest.param(-1, 3, 1, 0, 1, id="one core"),
        pytest.param(-1, 3, 2, 2, 2, id="one a GPU"),
        pytest.param(-2, 3, 2, 0, 1, id="all cores but one"),
        pytest.param(2, 3, 2, 0, 2, id="as many as were asked for"),
        pytest.param(6, 3, 2, 2, 6, id="more than there are GPUs"),
    ],
)
def test_no_job_runs_alone_at_the_end(
    monkeypatch: pytest.MonkeyPatch, asked: int, jobs: int, cores: int, gpus: int, side_by_side: int
) -> None:
    monkeypatch.setattr(launch, "allotted_cores", lambda: cores)
    assert launch.processes_at_a_time(asked, jobs, gpus) == side_by_side


RECORDER = '''
from functools import partial


class Recorder:
    """A callback of Hydra's that writes down what it is told."""

    def __init__(self, path):
        self.path = path

    def __getattr__(self, name):
        if not name.startswith("on_"):
            raise AttributeError(name)
        return partial(self.note, name)

    def note(self, name, config=None, **_):
        with open(self.path, "a") as stream:
            print(name, config.seed if config is not None else "", file=stream)
'''


def test_callbacks_and_the_folder_of_a_sweep_are_those_that_are_asked_for(
    launched: Callable[..., int], tmp_path: Path
) -> None:
    told = tmp_path / "told"
    where = [f"hydra.sweep.dir={tmp_path / 'sweep'}", "hydra.sweep.subdir=${variant}"]
    callback = f"+hydra.callbacks.note={{_target_:recorder.Recorder,path:{told}}}"
    (tmp_path / "recorder.py").write_text(RECORDER)
    with pytest.MonkeyPatch.context() as patch:
        path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
        patch.setenv("PYTHONPATH", path)
        patch.syspath_prepend(str(tmp_path))
        launched(leave_a_note(tmp_path), "-m", "seed=4,5", "hydra.launcher.n_jobs=1", *where, callback)
    lines = [line for line in told.read_text().splitlines() if not line.startswith("on_compose_config")]
    of_jobs = [f"on_job_{when} {seed}" for seed in (4, 5) for when in ("start", "end")]
    assert lines == ["on_multirun_start 0", *of_jobs, "on_multirun_end 0"]
    assert (tmp_path / "sweep" / "sa2h").is_dir()


def seen_devices(launched: Callable[..., int], folder: Path, *arguments: str) -> list[str]:
    """What each of two jobs sees of the GPUs, one after another or side by side."""
    told = str(folder)

    def work(job: Job) -> None:
        import os
        import time
        from pathlib import Path

        time.sleep(1)
        (Path(told) / str(job.settings.seed)).write_text(os.environ.get("CUDA_VISIBLE_DEVICES", "all"))

    launched(work, "-m", "seed=0,1", *arguments)
    return [(folder / str(seed)).read_text() for seed in range(2)]


@pytest.mark.parametrize(("count", "seen"), [(1, ["all", "all"]), (2, ["0", "1"])])
def test_jobs_are_dealt_to_all_devices_and_one_device_is_left_as_it_is(
    launched: Callable[..., int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, count: int, seen: list[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: count)
    monkeypatch.delenv(VISIBLE, raising=False)
    assert sorted(seen_devices(launched, tmp_path, "training.device=auto", "hydra.launcher.n_jobs=2")) == seen
    assert VISIBLE not in os.environ


def test_only_devices_that_are_visible_are_dealt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setenv(VISIBLE, "GPU-5a, GPU-7c")
    assert devices_to_share("auto") == ("GPU-5a", "GPU-7c")
    assert devices_to_share("cpu") == ()


@pytest.mark.parametrize("how", [["hydra/launcher=basic"], ["hydra.sweeper.max_batch_size=1"]])
def test_each_study_of_a_sweep_is_compared_at_its_end_where_no_launcher_saw_all_jobs(
    how: Sequence[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another launcher runs each job by itself, and a sweeper launches batches; the whole command line is known."""
    done: list[list[tuple[str, Task]]] = []
    for study in ("one", "two"):
        (tmp_path / "runs" / study).mkdir(parents=True)
    monkeypatch.setattr(
        "ablate.tasks.entry._do",
        lambda jobs, _: done.append([(job.settings.study, job.settings.task) for job in jobs]),
    )
    line = ["-m", "preset=tiny", "study_name=one,two", *how, f"runs_dir={tmp_path / 'runs'}"]
    assert execute(line) == 0
    *jobs, compared = done
    assert jobs == [[("one", Task.study)], [("two", Task.study)]]
    assert compared == [("one", Task.compare), ("two", Task.compare)]


def test_a_job_that_another_process_composes_knows_by_which_code_its_command_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The files change after the first job has begun; what a job reads of them is not what its command began with."""
    sources: list[str] = []

    def do(jobs: Sequence[Job], _: object) -> int:
        sources.append(jobs[0].source)
        monkeypatch.setattr("ablate.study.source_code._LOADED", "later")
        return 0

    monkeypatch.setattr("ablate.tasks.entry._do", do)
    monkeypatch.setattr("ablate.study.source_code._LOADED", "0123456789012e45")  # no number, though it looks like one
    assert execute(["-m", "preset=tiny", "seed=0,1", "hydra/launcher=basic", f"runs_dir={tmp_path}"]) == 0
    assert sources[:2] == ["0123456789012e45"] * 2


@pytest.mark.slow
@pytest.mark.parametrize("launcher", ["basic", "joblib", "submitit_local"])
def test_launchers_of_others_run_each_job_and_then_the_study_is_compared(launcher: str, tmp_path: Path) -> None:
    """joblib's and submitit's own, as they are installed: each job composes and runs by itself."""
    line = ["-m", "preset=tiny", "variant=sa2h,sa2h-att", f"hydra/launcher={launcher}", f"runs_dir={tmp_path / 'runs'}"]
    assert execute(line) == 0
    study = tmp_path / "runs" / "tiny-fetal"
    assert {path.parent.name.partition("-seed")[0] for path in study.glob("*/trained.json")} == {"sa2h", "sa2h-att"}
    assert (study / "comparison" / "table.csv").exists()


def test_a_sweeper_that_searches_is_told_which_trials_failed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Whether the search goes on is the sweeper's to say, as Optuna's `max_failure_rate` does."""
    returns: list[JobReturn] = []
    whole = entry.run_sweep

    def told(*arguments: Any) -> list[JobReturn]:
        returns.extend(whole(*arguments))
        return returns

    monkeypatch.setattr(entry, "run_sweep", told)
    monkeypatch.setattr(entry, "_do", lambda *_: 1)
    words = ["-m", "preset=tiny", "seed=0,1", f"runs_dir={tmp_path}"]
    assert execute([*words, "objective=val/psnr_fan"]) == 1
    assert [returned.status for returned in returns] == [JobStatus.FAILED] * 2
    with pytest.raises(entry.NotFinishedError, match=r"^sa2h/seed0: not finished$"):
        _ = returns[0].return_value
    returns.clear()
    assert execute(words) == 1
    assert not returns
