"""Runs are found again rather than made twice, also by processes that start together."""

import json
import math
import multiprocessing
from pathlib import Path

import pytest
from mlflow import MlflowClient

from ablate.tracking import Status, StoredRun, child_run, default_uri, open_store, parent_run


def test_opening_twice_gives_the_same_runs(runs: Path) -> None:
    first = open_store(runs, None, "ablate")
    parent = parent_run(first, "quick-fetal")
    child = child_run(first, parent, "sa2h/seed0", "abc", {"variant": "sa2h"})
    second = open_store(runs, None, "ablate")
    assert second == first
    assert parent_run(second, "quick-fetal") == parent
    assert child_run(second, parent, "sa2h/seed0", "abc", {"variant": "sa2h"}) == child
    assert child_run(second, parent, "sa2h/seed1", "abd", {"variant": "sa2h"}) != child
    assert parent_run(second, "other") != parent


def test_a_run_carries_what_was_logged(runs: Path) -> None:
    store = open_store(runs, None, "ablate")
    parent = parent_run(store, "study")
    run = StoredRun(store, child_run(store, parent, "sa2h/seed0", "abc", {"variant": "sa2h"}))
    run.scores({"test/psnr": 17.5, "identical": math.inf, "undefined": math.nan})
    run.parameters({"model.width": 0.25})
    run.parameters({"model.width": 0.5, "seed": 0})  # a resumed run keeps what it has
    (runs / "a.txt").write_text("x")
    run.artifact(runs / "a.txt", "provenance")
    run.mark(Status.finished)
    client = MlflowClient(default_uri(runs))
    found = client.get_run(run.run_id)
    assert found.data.metrics == {"test/psnr": 17.5}
    assert found.data.params == {"model.width": "0.25", "seed": "0"}
    assert found.data.tags["mlflow.parentRunId"] == parent
    assert found.info.status == "FINISHED"
    assert found.info.artifact_uri.startswith((runs / "artifacts").as_uri())
    assert [a.path for a in client.list_artifacts(run.run_id, "provenance")] == ["provenance/a.txt"]


def test_a_run_has_its_data_set_once_and_the_experiment_is_one_of_models(runs: Path) -> None:
    store = open_store(runs, None, "ablate")
    run = StoredRun(store, parent_run(store, "study"))
    for _ in range(2):
        run.dataset("fetal-abc", "abc", runs / "data", 240)
    (used,) = store.client.get_run(run.run_id).inputs.dataset_inputs
    assert (used.dataset.name, used.dataset.digest) == ("fetal-abc", "abc")
    assert json.loads(used.dataset.profile) == {"num_rows": 240}
    assert store.client.get_experiment(store.experiment_id).tags["mlflow.experimentKind"] == "custom_model_development"


def _open(folder: Path) -> str:
    store = open_store(folder, None, "ablate")
    return child_run(store, parent_run(store, "study"), "sa2h/seed0", "abc", {"variant": "sa2h"})


@pytest.mark.slow
def test_processes_that_start_together_share_one_database(tmp_path: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(4) as pool:
        runs = pool.map(_open, [tmp_path] * 8)
    assert len(set(runs)) == 1
