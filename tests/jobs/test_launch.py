"""A launcher, whichever it is, gets every job once, composed, and brings it to a process where it runs."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from omegaconf import DictConfig

from ablate.jobs.compose import CommandLine, read_command_line
from ablate.runs.job import Job


def composed(*arguments: str) -> CommandLine:
    command = read_command_line(arguments)
    assert command is not None
    return command


def leave_a_note(folder: Path) -> Callable[[Job], None]:
    """Work that writes a file. A local function is pickled whole: the processes of a launcher cannot import tests."""

    def work(job: Job) -> None:
        (folder / f"{job.label}-{job.settings.seed}").write_text(str(job.settings.training.steps))

    return work


def notes(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.is_file()}


@pytest.mark.parametrize("launcher", ["basic", "joblib", "submitit_local"])
def test_every_launcher_carries_the_jobs(launcher: str, tmp_path: Path) -> None:
    """joblib and submitit pickle what they start, and have no part in how it was composed."""
    line = ["-m", "variant=sa2h,nsa2h", "seed=0,1", "training.steps=7", f"hydra/launcher={launcher}"]
    command = composed(*line, f"runs_dir={tmp_path / 'runs'}")
    (tmp_path / "notes").mkdir()
    command.launch(command.jobs[1:], leave_a_note(tmp_path / "notes"))
    assert notes(tmp_path / "notes") == {"sa2h-1": "7", "nsa2h-0": "7", "nsa2h-1": "7"}


def test_a_process_that_is_killed_takes_no_other_with_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As the system does when memory runs out; with joblib's own pool the other processes were ended too."""
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

    command = composed("-m", "seed=0,1,2", "hydra/launcher=joblib", f"runs_dir={tmp_path / 'runs'}")
    command.launch(command.jobs, work)
    assert notes(tmp_path).keys() == {"1", "2"}
    (told,) = capsys.readouterr().err.splitlines()
    assert told.startswith(f"seed=0 runs_dir={tmp_path / 'runs'}: its process was ended by SIGKILL")


@pytest.fixture
def heard() -> Iterator[None]:
    """Python raises KeyboardInterrupt, which it does not where the tests were started in the background."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("heard")
def test_after_ctrl_c_every_process_saves_what_it_is_at(tmp_path: Path) -> None:
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

    command = composed(
        "-m", "seed=0,1", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2", f"runs_dir={tmp_path}/runs"
    )
    begun = [tmp_path / "begun0", tmp_path / "begun1"]

    def interrupt() -> None:
        while not all(path.exists() for path in begun):
            time.sleep(0.1)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        command.launch(command.jobs, work)
    assert (tmp_path / "saved0").exists()
    assert (tmp_path / "saved1").exists()


def test_a_single_job_and_batches_need_no_numbers(tmp_path: Path) -> None:
    single = composed("variant=nsa2h", f"runs_dir={tmp_path}")
    single.launch(single.jobs, leave_a_note(tmp_path))
    sweep = composed("-m", "seed=1,2,3", "hydra.sweeper.max_batch_size=2", f"runs_dir={tmp_path / 'runs'}")
    sweep.launch(sweep.jobs, leave_a_note(tmp_path))
    assert set(notes(tmp_path)) == {"nsa2h-0", "sa2h-1", "sa2h-2", "sa2h-3"}


def test_a_launcher_that_fails_is_shown_and_ends_the_launch(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = composed("-m", "seed=0,1", "hydra.sweep.dir=/dev/null/nowhere", f"runs_dir={tmp_path}")
    command.launch(command.jobs, leave_a_note(tmp_path))
    assert "/dev/null/nowhere" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


class Recorder:
    """A callback of Hydra's that writes down what it is told."""

    def __init__(self, path: str) -> None:
        self.path = Path(path)

    def __getattr__(self, name: str) -> object:
        if not name.startswith("on_"):
            raise AttributeError(name)
        return partial(self._note, name)

    def _note(self, name: str, config: DictConfig, **_: object) -> None:
        with self.path.open("a") as stream:
            stream.write(f"{name} {config.seed}\n")


def test_callbacks_and_the_folder_of_a_sweep_are_those_that_are_asked_for(tmp_path: Path) -> None:
    told = tmp_path / "told"
    where = [f"runs_dir={tmp_path}", f"hydra.sweep.dir={tmp_path / 'sweep'}", "hydra.sweep.subdir=${variant}"]
    callback = f"+hydra.callbacks.note={{_target_:{__name__}.Recorder,path:{told}}}"
    sweep = composed("-m", "seed=4,5", *where, callback)
    sweep.launch(sweep.jobs, leave_a_note(tmp_path))
    assert told.read_text().splitlines() == [
        "on_multirun_start 0",
        "on_job_start 4",
        "on_job_end 4",
        "on_job_start 5",
        "on_job_end 5",
        "on_multirun_end 0",
    ]
    assert (tmp_path / "sweep" / "sa2h").is_dir()
