"""Each job of a sweep on one machine gets a GPU of its own; the number of GPUs is faked."""

import os
from pathlib import Path

import pytest
import torch
from ablate.jobs.devices import VISIBLE, devices_to_share, least_busy

from ablate.jobs.compose import read_command_line
from ablate.runs.job import Job


def launched(folder: Path, *arguments: str) -> list[str]:
    """What each of four jobs sees of the GPUs, one after another or side by side."""
    told = str(folder)

    def work(job: Job) -> None:
        import os
        import time
        from pathlib import Path

        time.sleep(1)
        (Path(told) / str(job.settings.seed)).write_text(os.environ.get("CUDA_VISIBLE_DEVICES", "all"))

    command = read_command_line(
        ["-m", "seed=0,1,2,3", "hydra/launcher=joblib", f"runs_dir={folder / 'runs'}", *arguments]
    )
    assert command is not None
    command.launch(command.jobs, work)
    return [(folder / str(seed)).read_text() for seed in range(4)]


def test_jobs_are_dealt_to_all_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 4)
    monkeypatch.delenv(VISIBLE, raising=False)
    assert sorted(launched(tmp_path, "training.device=auto", "hydra.launcher.n_jobs=4")) == ["0", "1", "2", "3"]
    assert VISIBLE not in os.environ


@pytest.mark.parametrize(("devices", "said"), [(1, "all"), (0, "all")])
def test_one_device_is_left_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, devices: int, said: str) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: devices)
    monkeypatch.delenv(VISIBLE, raising=False)
    assert launched(tmp_path, "hydra.launcher.n_jobs=2") == [said] * 4


def shared(*arguments: str) -> tuple[str, ...]:
    command = read_command_line(["-m", "seed=0,1", *arguments])
    assert command is not None
    assert command.launch.master is not None
    return devices_to_share(command.launch.master)


def test_only_devices_that_are_visible_are_dealt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setenv(VISIBLE, "GPU-5a, GPU-7c")
    assert shared() == ("GPU-5a", "GPU-7c")
    assert shared("training.device=cpu") == ()


def test_the_least_busy_device_is_next() -> None:
    assert [least_busy("ab", busy) for busy in ([], ["a"], ["a", "b"], ["a", "b", "a"])] == ["a", "b", "a", "b"]
    assert least_busy((), []) is None
