"""The store is a copy of the runs on disk: a server that is gone stops nothing, and a new store is filled again."""

import shutil
import socket
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ablate.comparison import compare
from ablate.comparison.compare import compare_study
from ablate.jobs.compose import jobs_of
from ablate.runs.job import Job
from ablate.runs.train import run_job
from ablate.tracking import default_uri
from mlflow import MlflowClient
from mlflow.entities import Run
from mlflow.tracking._tracking_service import utils

from ablate.settings.study import TrackingSettings

TINY = ["preset=tiny", "simulator.image_shape=[96,134]", "dataset.frames=10", "training.steps=4"]
OFTEN = ["training.validate_every=2", "training.log_every=1"]


def job_in(runs: Path, *more: str) -> Job:
    (job,) = jobs_of(["variant=sa2h", f"runs_dir={runs}", *TINY, *OFTEN, *more])
    return job


@pytest.fixture
def frozen() -> Iterator[str]:
    """Address of a server that takes connections and never answers."""
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        server.listen(64)
        yield f"http://127.0.0.1:{server.getsockname()[1]}"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, empty_database: Path) -> Job:
    """A finished study of one run, tracked in the default store."""
    runs = tmp_path_factory.mktemp("made") / "runs"
    runs.mkdir()
    shutil.copy(empty_database, runs)
    job = job_in(runs)
    run_job(job)
    compare_study(job.settings)
    return job


def moved(made: Job, to: Path) -> Job:
    """The same study in a copy of its folder of runs."""
    shutil.copytree(made.settings.results, to)
    utils._artifact_repos_cache.clear()  # as in another process: MLflow remembers the place of a run's artifacts
    return job_in(to)


def stored(runs: Path) -> dict[str, Run]:
    """The runs of a default store, by kind: one each."""
    store = MlflowClient(default_uri(runs))
    (experiment,) = [e for e in store.search_experiments() if e.name == "ablate"]
    tracked = store.search_runs([experiment.experiment_id])
    assert sorted(run.data.tags["kind"] for run in tracked) == ["job", "study"]
    return {run.data.tags["kind"]: run for run in tracked}


def content(runs: Path) -> dict[str, Any]:
    """What a default store shows of a study: values by key and step, artifacts, state, parameters."""
    store, kinds = MlflowClient(default_uri(runs)), stored(runs)
    child = kinds["job"]
    history = [p for key in child.data.metrics for p in store.get_metric_history(child.info.run_id, key)]
    assert set(Counter((p.key, p.step) for p in history).values()) == {1}
    artifacts = {kind: Path(run.info.artifact_uri.removeprefix("file://")) for kind, run in kinds.items()}
    files = {kind: {p.relative_to(f) for p in f.rglob("*") if p.is_file()} for kind, f in artifacts.items()}
    assert all(f.is_relative_to(runs) for f in artifacts.values())
    return {
        "points": {(p.key, p.step): (p.value, p.timestamp * ("/" in p.key and p.step > 0)) for p in history},
        "files": {k: {str(p) for p in paths if p.parts[0] != "images"} for k, paths in files.items()},
        "images": len([p for p in files["job"] if p.parts[0] == "images"]),
        "params": {kind: run.data.params for kind, run in kinds.items()},
        "states": {kind: run.info.status for kind, run in kinds.items()},
        "floor": kinds["study"].data.metrics,
    }


def test_a_removed_database_is_filled_again_from_disk(made: Job, tmp_path: Path, empty_database: Path) -> None:
    before = content(made.settings.results)
    assert before["points"].keys() >= {("train/l1", 4), ("val/psnr_fan_curve", 4), ("test/psnr", 0)}
    assert before["states"] == {"job": "FINISHED", "study": "FINISHED"}
    job = moved(made, tmp_path / "runs")
    shutil.rmtree(tmp_path / "runs" / "artifacts")
    shutil.copy(empty_database, tmp_path / "runs")
    compare_study(job.settings)
    assert content(tmp_path / "runs") == before


def test_an_experiment_that_was_deleted_is_there_again(made: Job, tmp_path: Path) -> None:
    job = moved(made, tmp_path / "runs")
    compare_study(job.settings)
    before = content(tmp_path / "runs")
    MlflowClient(default_uri(tmp_path / "runs")).delete_experiment("1")
    compare_study(job.settings)
    assert content(tmp_path / "runs") == before


def test_a_copy_of_the_runs_leaves_the_artifacts_of_the_original_alone(made: Job, tmp_path: Path) -> None:
    original = made.settings.results / "artifacts"
    before = {path: path.stat().st_mtime_ns for path in original.rglob("*")}
    job = moved(made, tmp_path / "runs")
    compare_study(job.settings, rebuild=True)
    assert content(tmp_path / "runs")["files"] == content(made.settings.results)["files"]
    assert {path: path.stat().st_mtime_ns for path in original.rglob("*")} == before


def test_the_same_command_writes_nothing_twice(made: Job) -> None:
    def state() -> tuple[Any, list[int], int]:
        kinds = stored(made.settings.results)
        files = [path.stat().st_mtime_ns for path in sorted((made.settings.results / "artifacts").rglob("*"))]
        return content(made.settings.results), files, kinds["study"].info.end_time

    before = state()
    compare_study(made.settings)
    assert state() == before


def test_a_store_that_answers_too_slowly_is_not_waited_for(made: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(compare, "_TRACKING_S", 0.2)
    monkeypatch.setattr(compare, "copy_study", lambda _: time.sleep(60))
    started = time.perf_counter()
    assert "Note: not all is in MLflow yet (TimeoutError: no end after 0.2 s)" in compare_study(made.settings)
    assert time.perf_counter() - started < 50


def test_training_goes_on_without_a_server_and_is_logged_later_once(
    made: Job, runs: Path, frozen: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "3")
    shutil.copytree(made.settings.results / "data", runs / "data")
    job = job_in(runs, f"tracking.uri={frozen}")
    run_job(job)
    assert (job.folder / "result.json").exists()
    started = time.monotonic()
    assert "not all is in MLflow yet" in compare_study(job.settings)
    assert time.monotonic() - started < 30
    later = replace(job.settings, tracking=TrackingSettings())
    assert "not all" not in compare_study(later)
    there, whole = content(runs), content(made.settings.results)
    assert there["points"].keys() == whole["points"].keys()
    assert there["files"] == whole["files"]
    assert there["images"] == whole["images"]
