"""A training that diverges within a sweep: stopped, said, marked failed, its last good checkpoint kept."""

import math
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from mlflow import MlflowClient

from ablate.dataset import CropLoader
from ablate.jobs.compose import jobs_of
from ablate.jobs.launch import Launch, start_here
from ablate.tasks.run_task import run_task
from ablate.tracking import default_uri
from ablate.training import LAST, load_generator, read_checkpoint
from support.studies import TinyStudy

SWEEP = [
    "-m",
    "seed=0,1",
    "preset=tiny",
    "training.steps=12",
    "training.checkpoint_every=4",
    "training.validate_every=0",
]
BROKEN_STEP = 9


class BrokenLoader(CropLoader):
    """Gives the job of seed 1 an image that is not finite."""

    def __iter__(self) -> Iterator[dict[str, torch.Tensor]]:
        for step, batch in zip(self.steps, super().__iter__(), strict=True):
            if self.crops.settings.seed == 1 and step == BROKEN_STEP:
                batch["target"][0, 0, 0, 0] = math.nan
            yield batch


def test_one_job_diverges_and_the_other_finishes(
    tiny_study: TinyStudy, runs: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(tiny_study.runs / "data", runs / "data")
    monkeypatch.setattr("ablate.runs.train.CropLoader", BrokenLoader)
    assert run_task(jobs_of([*SWEEP, f"runs_dir={runs}"]), Launch(start_here)) == 1
    said = capsys.readouterr().err
    # The training frames are an epoch of two or three steps, so that losses are looked at after each.
    assert "training has failed at step 10: train/loss_d is nan" in said
    assert "the last good checkpoint is kept" in said
    assert "not finished: sa2h/seed1" in said

    place = runs / "tiny-fetal" / "sa2h"
    assert (place / "seed0" / "result.json").exists()
    assert not (place / "seed1" / "result.json").exists()
    checkpoint = place / "seed1" / LAST
    assert read_checkpoint(checkpoint)["steps_done"] == 8
    assert all(weight.isfinite().all() for weight in load_generator(checkpoint).parameters())

    client = MlflowClient(default_uri(runs))
    (experiment,) = [e for e in client.search_experiments() if e.name == "ablate"]
    states = {r.info.run_name: r.info.status for r in client.search_runs([experiment.experiment_id])}
    assert states == {"tiny-fetal": "FAILED", "sa2h/seed0": "FINISHED", "sa2h/seed1": "FAILED"}
