"""Runs are found again rather than made twice, also by processes that start together."""

import json
import math
import multiprocessing
from pathlib import Path

import numpy as np
import pytest
from mlflow import MlflowClient
from PIL import Image

from ablate.tracking import RunLog, Status, child_run, default_uri, open_store, parent_run


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
    run = RunLog(store, child_run(store, parent, "sa2h/seed0", "abc", {"variant": "sa2h"}))
    run.metrics({"test/psnr": 17.5, "identical": math.inf, "undefined": math.nan}, step=3)
    run.parameters({"model.width": 0.25})
    run.parameters({"model.width": 0.5, "seed": 0})  # a resumed run keeps what it has
    (runs / "a.txt").write_text("x")
    run.artifact(runs / "a.txt", "provenance")
    run.end(Status.finished)
    client = MlflowClient(default_uri(runs))
    found = client.get_run(run.run_id)
    assert found.data.metrics == {"test/psnr": 17.5}
    assert found.data.params == {"model.width": "0.25", "seed": "0"}
    assert found.data.tags["mlflow.parentRunId"] == parent
    assert found.info.status == "FINISHED"
    assert found.info.artifact_uri.startswith((runs / "artifacts").as_uri())
    assert [a.path for a in client.list_artifacts(run.run_id, "provenance")] == ["provenance/a.txt"]


def test_a_resumed_run_has_each_image_of_a_series_once(runs: Path) -> None:
    store = open_store(runs, None, "ablate")
    parent = parent_run(store, "study")
    frames = np.random.default_rng(0).integers(0, 256, (3, 20, 30), np.uint8)

    def image_files() -> dict[str, Path]:
        folder = Path(store.client.get_run(parent).info.artifact_uri.removeprefix("file://")) / "images"
        return {path.name.partition("timestamp")[0]: path for path in sorted(folder.glob("*.png"))}

    first = RunLog(store, parent)
    for step in (0, 8):
        first.image("frame 7 - a/b", frames[step // 8], step)
    once = image_files()
    assert list(once) == ["frame 7 - a~b+step+0+", "frame 7 - a~b+step+8+"]
    small = next(once["frame 7 - a~b+step+8+"].parent.glob("*step+8+*.webp"))
    small.unlink()  # killed between the two files of an image

    second = RunLog(store, parent)
    for step in (0, 8, 16):
        second.image("frame 7 - a/b", frames[step // 8], step)
    files = image_files()
    assert files["frame 7 - a~b+step+0+"] == once["frame 7 - a~b+step+0+"]
    assert len(files) == 3
    for k, step in enumerate((0, 8, 16)):
        path = files[f"frame 7 - a~b+step+{step}+"]
        np.testing.assert_array_equal(np.asarray(Image.open(path)), frames[k])
        assert path.with_name(f"{path.stem}+compressed.webp").exists()


def test_a_run_has_its_data_set_once_and_the_experiment_is_one_of_models(runs: Path) -> None:
    store = open_store(runs, None, "ablate")
    run = RunLog(store, parent_run(store, "study"))
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
