"""A training that diverges: stopped, said, its last good checkpoint kept."""

import math
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from ablate.command.compose import jobs_of
from ablate.dataset import CropLoader
from ablate.study.work import do
from ablate.training import DivergenceError, load_generator, read_checkpoint
from support.studies import TINY, TinyStudy

BROKEN_STEP = 9
TIMES = ["training.steps=12", "training.checkpoint_every=4", "training.validate_every=0"]


class BrokenLoader(CropLoader):
    """Gives an image that is not finite."""

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        for step, batch in zip(self.steps, super().__iter__(), strict=True):
            if step == BROKEN_STEP:
                batch["target"][0, 0, 0, 0] = math.nan
            yield batch


def test_a_job_that_diverges_is_stopped(tiny_study: TinyStudy, runs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(tiny_study.runs / "data", runs / "data")
    monkeypatch.setattr("ablate.study.work.CropLoader", BrokenLoader)
    (job,) = jobs_of([*TINY, *TIMES, f"runs_dir={runs}", "training.log_every=1"])
    with pytest.raises(DivergenceError, match=r"at step 10: train/loss_d is nan.*the last good checkpoint is kept"):
        do(job)
    assert not job.training.result
    assert read_checkpoint(job.training.checkpoint)["steps_done"] == 8
    assert all(weight.isfinite().all() for weight in load_generator(job.training.checkpoint).parameters())
