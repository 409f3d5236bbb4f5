"""What a run logs is on disk first; the store has each step once, whatever fails on the way."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from ablate.tracking import LocalLog, Status, StoredRun, open_store, parent_run, read_log
from mlflow import MlflowClient
from mlflow.exceptions import MlflowException
from PIL import Image


def points(run: StoredRun, key: str) -> list[tuple[int, float]]:
    return [(point.step, point.value) for point in run.store.client.get_metric_history(run.run_id, key)]


def new_run(runs: Path) -> StoredRun:
    store = open_store(runs, None, "ablate")
    return StoredRun(store, parent_run(store, "study"))


def test_a_resumed_training_logs_each_step_once_and_a_line_cut_short_is_dropped(tmp_path: Path) -> None:
    first = LocalLog(tmp_path)
    first.status(Status.running)
    for step in (4, 8):
        first.metrics({"l1": step / 2, "undefined": math.nan, "infinite": -math.inf}, step)
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"time": 1, "step": 12, "metr')
    second = LocalLog(tmp_path)
    for step in (8, 12):
        second.metrics({"l1": 7.0, "l2": 1.0}, step)
    lines = [{k: v for k, v in line.items() if k != "time"} for line in read_log(tmp_path)[0]]
    assert lines == [
        {"status": "RUNNING"},
        {"step": 4, "metrics": {"l1": 2.0}},
        {"step": 8, "metrics": {"l1": 4.0}},
        {"step": 8, "metrics": {"l2": 1.0}},
        {"step": 12, "metrics": {"l1": 7.0, "l2": 1.0}},
    ]


@pytest.mark.parametrize("arrives", [True, False], ids=["the answer is lost", "the call is lost"])
def test_what_a_store_did_not_take_is_logged_later_once(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arrives: bool
) -> None:
    log = LocalLog(tmp_path)
    run = new_run(runs)
    log.metrics({"l1": 1.0, "l2": 2.0}, 4)
    run.copy_log(tmp_path)
    log.metrics({"l1": 0.5}, 8)
    works: Callable[..., Any] = MlflowClient.log_batch

    def fails(*arguments: Any, **more: Any) -> None:
        if arrives:
            works(*arguments, **more)
        raise MlflowException("the server is gone")

    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, "log_batch", fails)
        with pytest.raises(MlflowException):
            run.copy_log(tmp_path)
    log.metrics({"l1": 0.25}, 12)
    again = new_run(runs)
    for _ in range(2):
        again.copy_log(tmp_path)
    new_run(runs).copy_log(tmp_path)  # as another process
    assert points(again, "l1") == [(4, 1.0), (8, 0.5), (12, 0.25)]
    assert points(again, "l2") == [(4, 2.0)]


def test_a_store_has_each_image_of_a_series_once_and_whole(runs: Path, tmp_path: Path) -> None:
    frames = np.random.default_rng(0).integers(0, 256, (3, 20, 30), np.uint8)
    log, run = LocalLog(tmp_path), new_run(runs)

    def image_files() -> dict[str, Path]:
        folder = Path(run.store.client.get_run(run.run_id).info.artifact_uri.removeprefix("file://")) / "images"
        return {path.name.partition("timestamp")[0]: path for path in sorted(folder.glob("*.png"))}

    for step in (0, 8):
        log.image("frame 7 - a/b", frames[step // 8], step)
    run.copy_log(tmp_path)
    once = image_files()
    assert list(once) == ["frame 7 - a~b+step+0+", "frame 7 - a~b+step+8+"]
    small = next(once["frame 7 - a~b+step+8+"].parent.glob("*step+8+*.webp"))
    small.unlink()  # killed between the two files of an image

    log.image("frame 7 - a/b", frames[2], 16)
    log.image("frame 7 - a/b", frames[0], 8)  # a step that is done again
    new_run(runs).copy_log(tmp_path)
    files = image_files()
    assert files["frame 7 - a~b+step+0+"] == once["frame 7 - a~b+step+0+"]
    assert len(files) == 3
    for k, step in enumerate((0, 8, 16)):
        path = files[f"frame 7 - a~b+step+{step}+"]
        np.testing.assert_array_equal(np.asarray(Image.open(path)), frames[k])
        assert path.with_name(f"{path.stem}+compressed.webp").exists()
