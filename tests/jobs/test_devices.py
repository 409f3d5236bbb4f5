"""Each job of a sweep on one machine gets a GPU of its own; the number of GPUs is faked."""

import os
from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

from ablate.jobs.launch import VISIBLE, Launch, devices_to_share, least_busy
from ablate.runs.job import Job
from ablate.tasks import command
from ablate.tasks.command import execute


def launched(folder: Path, patch: pytest.MonkeyPatch, *arguments: str) -> list[str]:
    """What each of two jobs sees of the GPUs, one after another or side by side."""
    told = str(folder)

    def work(job: Job) -> None:
        import os
        import time
        from pathlib import Path

        time.sleep(1)
        (Path(told) / str(job.settings.seed)).write_text(os.environ.get("CUDA_VISIBLE_DEVICES", "all"))

    def do(jobs: Sequence[Job], launch: Launch) -> int:
        launch.start(jobs, work)
        return 0

    patch.setattr(command, "_do", do)
    execute(["-m", "seed=0,1", f"runs_dir={folder / 'runs'}", *arguments])
    return [(folder / str(seed)).read_text() for seed in range(2)]


def test_jobs_are_dealt_to_all_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.delenv(VISIBLE, raising=False)
    seen = launched(tmp_path, monkeypatch, "training.device=auto", "hydra.launcher.n_jobs=2")
    assert sorted(seen) == ["0", "1"]
    assert VISIBLE not in os.environ


def test_one_device_is_left_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 1)
    monkeypatch.delenv(VISIBLE, raising=False)
    assert launched(tmp_path, monkeypatch, "hydra.launcher.n_jobs=2") == ["all"] * 2


def test_only_devices_that_are_visible_are_dealt(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setenv(VISIBLE, "GPU-5a, GPU-7c")
    assert devices_to_share("auto") == ("GPU-5a", "GPU-7c")
    assert devices_to_share("cpu") == ()


def test_the_least_busy_device_is_next() -> None:
    assert [least_busy("ab", busy) for busy in ([], ["a"], ["a", "b"], ["a", "b", "a"])] == ["a", "b", "a", "b"]
    assert least_busy((), []) is None
