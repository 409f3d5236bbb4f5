"""Trainings as they lie on disk, made without a network, and all that MLflow shows of a run."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from mlflow import MlflowClient
from mlflow.entities import Run
from mlflow.tracking._tracking_service import utils

from ablate.command.compose import jobs_of
from ablate.publish import default_uri
from ablate.storage import write_json
from ablate.study.job import Job, claim
from ablate.study.log import LocalLog, Status
from ablate.study.scores import Score, write_score
from ablate.study.training import Training
from support.finished_runs import PARAMETERS, WHOLE

_OF_THE_MOMENT = ("mlflow.parentRunId", "mlflow.note.content", "mlflow.user", "mlflow.ablate.published")


@cache
def _composed(variant: str) -> Job:
    (job,) = jobs_of([f"variant={variant}", "preset=tiny", "metrics=[psnr,mae]", "study_name=study"])
    return job


def job_in(runs: Path, variant: str = "sa2h", uri: str | None = None, metrics: Sequence[str] = ("psnr", "mae")) -> Job:
    """A job of the study `study`, of which nothing is on disk."""
    settings = _composed(variant).settings
    tracking = replace(settings.tracking, uri=uri)
    return Job(replace(settings, runs_dir=str(runs), metrics=list(metrics), tracking=tracking), variant)


def train(job: Job, steps: range, ended: Status | None, anew: bool = False) -> Training:
    """Log some steps, each with a point and an image, and how they ended; None is a process that is still there.

    Among its files is a link, as in a folder of runs from a stranger; it is not to be followed.
    """
    training = claim(job)
    log = LocalLog(training.folder, anew)
    training.provenance.mkdir(exist_ok=True)
    write_json(training.provenance / "made_with.json", {"git_commit": "abc", "hardware": "a laptop"})
    with suppress(FileExistsError):
        (training.provenance / "linked.txt").symlink_to(training.folder / "training.json")
    log.status(Status.running)
    for step in steps:
        log.metrics({"train/l1": 1 / (step + 1)}, step)
        log.image("frames/5", np.full((8, 8), step, np.uint8), step)
    if ended is not None:
        log.status(ended)
    return training


def finish(job: Job, level: float = 20.0, steps: range = range(4)) -> Training:
    """Train a job to the end and score it; every frame of a metric has the value `level`."""
    training = train(job, steps, None)
    training.write_result({**WHOLE, "scalars": {**PARAMETERS, "train/seconds": 3.0}})
    score(job, level)
    LocalLog(training.folder).status(Status.finished)
    return Training(training.folder)


def score(job: Job, level: float = 20.0) -> None:
    """Write the scores that a job asks for."""
    for key in job.wanted:
        rows = [
            {"frame": k, "site": k, "metric": key.metric, "value": level + k, "source": source, "split": "test"}
            for k in range(3)
            for source in ("model", "resimulation")
        ]
        scalars = {
            f"test/{key.metric}": level + 1,
            f"test/{key.metric}_lower": level,
            f"test/floor_{key.metric}": level + 9,
            f"val/{key.metric}": float("nan"),
            f"val/floor_{key.metric}": 0.0,
        }
        write_score(job.training.scores, key, Score(pd.DataFrame(rows), scalars, (), "2026-01-01T00:00:02+00:00"))


def another_process() -> None:
    """Forget the places of artifacts, which MLflow remembers as long as a process lives."""
    utils._artifact_repos_cache.clear()


def client_of(runs: Path) -> MlflowClient:
    """Of the default store in a folder of runs."""
    return MlflowClient(default_uri(runs))


def active_runs(runs: Path, experiment: str = "ablate") -> dict[str, Run]:
    """The runs of a store by name, of which there is one each."""
    client = client_of(runs)
    found = client.get_experiment_by_name(experiment)
    shown = client.search_runs([found.experiment_id]) if found else []
    names = [run.info.run_name for run in shown]
    assert len(set(names)) == len(names), f"more than one run: {names}"
    return dict(zip(names, shown, strict=True))


def content_of(runs: Path) -> dict[str, Any]:
    """All that a default store shows of its runs, without what is of the moment: ids, and when something was copied."""
    client, shown = client_of(runs), active_runs(runs)
    ids = {run.info.run_id: name for name, run in shown.items()}
    content = {}
    for name, run in shown.items():
        points = [point for key in run.data.metrics for point in client.get_metric_history(run.info.run_id, key)]
        content[name] = {
            "status": run.info.status,
            "params": run.data.params,
            "points": sorted((point.key, point.step, point.value) for point in points),
            "tags": {key: value for key, value in run.data.tags.items() if key not in _OF_THE_MOMENT},
            "parent": ids.get(run.data.tags.get("mlflow.parentRunId", ""), "none"),
            "files": files_of(runs, run),
        }
    return content


def files_of(runs: Path, run: Run) -> dict[str, str]:
    """The artifacts of a run and digests of their contents; of an image the name is that of its series and its step."""
    folder = runs / "artifacts" / run.info.run_id / "artifacts"
    assert run.info.artifact_uri == folder.as_uri()
    files: dict[str, str] = {}
    for path in (path for path in folder.rglob("*") if path.is_file()):
        name = f"{path.relative_to(folder)}".partition("+timestamp+")[0] + path.suffix * ("+timestamp+" in path.name)
        assert name not in files, f"{name} is there twice"
        files[name] = hashlib.sha256(path.read_bytes()).hexdigest()[:8]
    return files


def written(runs: Path) -> dict[str, tuple[int, bytes]]:
    """Every file that a store has written below a folder of runs, when, and of the database its content."""
    paths = [runs / "mlflow.db", *(runs / "artifacts").rglob("*")]
    return {str(path): (path.stat().st_mtime_ns, path.read_bytes() if path.is_file() else b"") for path in paths}
