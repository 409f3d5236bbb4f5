"""A training has one run in MLflow, equal to its folder, however often it was stopped or published."""

import re
import shlex
import shutil
import sqlite3
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import mlflow.data
import numpy as np
import pandas as pd
import pytest
import torch
from mlflow import MlflowClient
from mlflow.entities import Run
from PIL import Image

import ablate
from ablate.command.compose import jobs_of
from ablate.publish import default_uri
from ablate.publish.store import open_store
from ablate.publish.study_view import study_run
from ablate.publish.training_view import publish_training
from ablate.study.job import Job
from ablate.study.log import Status
from ablate.study.training import Training
from ablate.training import load_generator
from support.finished_runs import PARAMETERS
from support.published import (
    active_runs,
    another_process,
    client_of,
    content_of,
    files_of,
    finish,
    job_in,
    score,
    train,
    written,
)

NAME = "sa2h/seed0"
CURVE = [("train/l1", step, 1 / (step + 1)) for step in range(4)]


def publish(job: Job, goes_on: bool = False) -> Run:
    """Publish the training of a job below the run of its study; returns its only run."""
    another_process()
    store = open_store(job.settings)
    scores = [key.file_name for key in job.wanted if (job.training.scores / key.file_name).exists()]
    run_id = publish_training(store, study_run(store, job.settings), job.training, scores, goes_on)
    run = active_runs(job.settings.results)[job.name]
    assert run.info.run_id == run_id
    return run


def curve_of(runs: Path) -> list[tuple[str, int, float]]:
    """The points of the training's curve in MLflow."""
    return [point for point in content_of(runs)[NAME]["points"] if point[0] == "train/l1"]


def images(steps: range) -> set[str]:
    return {f"images/frames~5+step+{step}{suffix}" for step in steps for suffix in (".png", ".webp")}


def test_a_run_has_what_is_in_the_folder_of_its_training(runs: Path) -> None:
    job = job_in(runs)
    finish(job)
    run = publish(job)
    scores = {
        f"test/{prefix}{name}": value for name in ("psnr", "mae") for prefix, value in (("", 21.0), ("floor_", 29.0))
    }
    costs = {**PARAMETERS, "train/seconds": 3.0}
    assert run.data.metrics == {"train/l1": 0.25, **scores, **costs}, "no bounds, no NaN, no floor of validation frames"
    assert curve_of(runs) == CURVE
    tags = {"variant": "sa2h", "seed": "0", "study": "study", "config_hash": job.hash, "git_commit": "abc"}
    assert run.data.tags.items() >= tags.items()
    assert (run.info.run_name, run.info.status) == (NAME, "FINISHED")
    assert files_of(runs, run).keys() == images(range(4)) | {"per_image.parquet", "provenance/made_with.json"}
    table = pd.read_parquet(client_of(runs).download_artifacts(run.info.run_id, "per_image.parquet"))
    assert len(table) == 12, "two metrics of three frames, and of these simulated again"


def test_parameters_are_what_people_sort_by_and_the_study_has_only_its_scene(stopped_once: Job) -> None:
    """Settings of a study are those of its first command, and a later one may have others."""
    shown = active_runs(stopped_once.settings.results)
    components = {"family": "local", "att": "integral", "concat": "yes", "conv": "yes", "noise": "body"}
    sizes = {"preset": "tiny", "dataset.frames": "10", "training.steps": "4", "training.batch_size": "1"}
    others = {"variant": "sa2h", "seed": "0", "training.precision": "fp32", "scene.anatomy_seed": "0"}
    more = {"simulator.rays": "2", "dataset.split": "site", "model.width": "0.05"}
    params = shown[NAME].data.params
    assert params.items() >= (components | sizes | others | more).items()
    assert [key for key in params if key.startswith("model.")] == ["model.width"]  # others: as task=describe
    assert shown["study"].data.params == {"scene": "fetal"}


def test_a_real_training_goes_on_in_its_run_where_it_was_stopped(stopped_once: Job) -> None:
    runs = stopped_once.settings.results
    run = active_runs(runs)[NAME]
    curve = client_of(runs).get_metric_history(run.info.run_id, "val/psnr_fan_curve")
    assert [point.step for point in curve] == [0, 1, 2, 3, 4]
    names = [name for name in files_of(runs, run) if name.endswith(".png")]
    assert len([name for name in names if "frames~" in name]) == 2 * 5  # two frames, each step once
    assert {"config.json", "starts.json"} <= {Path(name).name for name in files_of(runs, run)}


def test_the_source_of_a_run_is_a_command_that_asks_for_it_alone(stopped_once: Job) -> None:
    source = active_runs(stopped_once.settings.results)[NAME].data.tags["mlflow.source.name"]
    *python, words = source.split(maxsplit=3)
    assert python == ["python", "-m", "ablate"]
    (job,) = jobs_of(shlex.split(words))
    assert (job.hash, job.name) == (stopped_once.hash, stopped_once.name)


def test_a_run_has_its_network_to_load_and_test_frames_beside_their_targets(stopped_once: Job) -> None:
    runs, training = stopped_once.settings.results, stopped_once.training
    run = active_runs(runs)[NAME]
    note = run.data.tags["mlflow.note.content"]
    (download, load) = re.findall(r"`(path = .+?|renderer = .+?)`", note)
    scope: dict[str, Any] = {"mlflow": mlflow, "ablate": ablate}
    exec(f"{download}\n{load}", scope)
    expected = load_generator(training.checkpoint).state_dict()
    loaded = scope["renderer"].generator.state_dict()
    assert loaded.keys() == expected.keys()
    assert all(torch.equal(loaded[name], expected[name]) for name in expected)
    psnr = run.data.metrics["test/psnr"]
    assert f"PSNR ↑ **{psnr:.2f}**" in note
    pictures = training.pictures
    first = min(pictures)
    rows, columns = pictures[first].shape
    (path,) = (runs / "artifacts" / run.info.run_id).rglob("examples~test+*.png")
    top = np.asarray(Image.open(path))[16 : 16 + rows]  # below a line of text
    np.testing.assert_array_equal(top[:, :columns], pictures[first])
    np.testing.assert_array_equal(top[:, columns:], stopped_once.data.pairs.read("target", [first])[0])


def test_test_frames_come_first_in_what_is_published_whole(runs: Path) -> None:
    """MLflow's pages list metrics in the order in which they were logged first."""
    job = job_in(runs)
    finish(job)
    run = publish(job)
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection:
        question = "SELECT key FROM latest_metrics WHERE run_uuid = ? ORDER BY rowid"
        keys = [key for (key,) in connection.execute(question, (run.info.run_id,))]
    assert keys[:4] == ["test/psnr", "test/mae", "test/floor_psnr", "test/floor_mae"]


@pytest.mark.parametrize("ended", [Status.killed, Status.failed, None], ids=["stopped", "failed", "killed"])
def test_a_training_that_was_stopped_and_goes_on_keeps_its_run(runs: Path, ended: Status | None) -> None:
    job = job_in(runs)
    train(job, range(2), ended)
    first = publish(job, goes_on=True)
    assert first.info.status == "RUNNING"
    stopped = publish(job)
    assert (stopped.info.status, curve_of(runs)) == (str(ended or Status.killed), CURVE[:2])
    train(job, range(1, 3), None)  # the step after the last checkpoint is done again
    assert publish(job, goes_on=True).info.status == "RUNNING"
    finish(job)
    whole = publish(job)
    assert whole.info.run_id == stopped.info.run_id == first.info.run_id
    assert whole.info.status == "FINISHED"
    assert curve_of(runs) == CURVE
    assert images(range(4)) < files_of(runs, whole).keys()


@pytest.mark.parametrize(
    ("call", "after"),
    [
        *(("log_batch", 0), ("log_batch", 1), ("set_tag", 0), ("set_tag", 1), ("set_terminated", 0)),
        *(("log_artifact", 0), ("log_artifact", 2), ("log_artifact", 3)),
    ],
)
def test_what_was_published_in_part_is_whole_and_once_in_the_end(
    runs: Path, call: str, after: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process may be killed, and a server may stop, between any two calls."""
    job = job_in(runs)
    finish(job)
    publish(job)
    before = content_of(runs)
    client_of(runs).delete_run(active_runs(runs)[NAME].info.run_id)
    real, left = getattr(MlflowClient, call), [after]

    def stops(*arguments: object, **named: object) -> object:
        if left[0] == 0:
            raise ConnectionError("gone")
        left[0] -= 1
        return real(*arguments, **named)

    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, call, stops)
        for goes_on in (True, False):
            left[0] = after
            with suppress(ConnectionError):
                publish(job, goes_on)
    publish(job)
    assert content_of(runs) == before


def test_publishing_again_writes_nothing(runs: Path) -> None:
    job = job_in(runs)
    finish(job)
    run = publish(job)
    before = written(runs)
    for goes_on in (False, True):  # another process that waits for its turn at the same training
        assert publish(job, goes_on).info.run_id == run.info.run_id
    assert written(runs) == before


def test_a_training_that_begins_anew_has_another_run(runs: Path) -> None:
    job = job_in(runs)
    finish(job)
    old = publish(job)
    shutil.rmtree(job.folder)
    train(job, range(2), Status.failed)
    new = publish(job)
    assert new.info.run_id != old.info.run_id
    assert curve_of(runs) == CURVE[:2]
    assert "test/psnr" not in new.data.metrics
    train(job, range(1), None, anew=True)  # its checkpoint was removed
    assert publish(job).info.run_id != new.info.run_id
    assert curve_of(runs) == CURVE[:1]


def test_new_scores_are_shown_instead_of_the_old_ones(runs: Path) -> None:
    job = job_in(runs, metrics=["psnr"])
    finish(job)
    assert "test/mae" not in publish(job).data.metrics
    other = job_in(runs, metrics=["mae"])
    score(other, 5.0)
    shown = publish(other).data.metrics
    assert (shown["test/mae"], "test/psnr" in shown) == (6.0, False)


def test_a_quote_in_the_name_of_a_folder_breaks_nothing(runs: Path) -> None:
    job = job_in(runs)
    folder = finish(job).folder
    study = folder.parent.rename(runs / "it's")
    store = open_store(job.settings)
    ids = [publish_training(store, study_run(store, job.settings), Training(study / folder.name)) for _ in range(2)]
    assert ids[0] == ids[1]
    assert MlflowClient(default_uri(runs)).get_run(ids[0]).data.tags["study"] == "it's"
