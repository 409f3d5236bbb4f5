"""What a task leaves is on disk first: a store that is gone stops nothing, and has it later, once."""

import _thread
import json
import socket
import time
from pathlib import Path

import pytest
from ablate.tracking import Status, copy_tasks, default_uri, open_store, recorded_task, stored_run, within
from mlflow import MlflowClient
from mlflow.entities import Run


def work(
    runs: Path, uri: str | None, status: Status = Status.finished, stopped_by: type[BaseException] | None = None
) -> None:
    """A task named `precision`, of two files."""
    folder = runs / "precision"
    with recorded_task(folder, "study", lambda: open_store(runs, uri, "ablate")) as record:
        for name in ("table.csv", "figure.pdf"):
            (folder / name).write_text("x")
            record.files.append(folder / name)
        record.files.append(folder / "not written.csv")
        if stopped_by is not None:
            raise stopped_by
        record.tags["scene"] = "fetal"
        record.scores |= {"order/mae": 0.5, "order/psnr": float("nan")}
        record.description = "said"
        record.status = status


def stored(runs: Path) -> tuple[Run, set[str]]:
    """The only run of a store, and its artifacts."""
    client = MlflowClient(default_uri(runs))
    experiment = client.get_experiment_by_name("ablate")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    folders = (None, "vector")
    return run, {a.path for f in folders for a in client.list_artifacts(run.info.run_id, f) if not a.is_dir}


def assert_all_is_there(runs: Path, status: str = "FINISHED") -> int:
    run, files = stored(runs)
    assert (run.info.run_name, run.info.status) == ("precision", status)
    assert run.data.metrics == {"order/mae": 0.5}
    assert run.data.tags["scene"] == "fetal"
    assert run.data.tags["mlflow.note.content"] == "said"
    assert files == {"table.csv", "vector/figure.pdf"}
    return int(run.info.end_time)


@pytest.mark.parametrize("status", [Status.finished, Status.failed])
def test_a_task_is_in_the_store_when_it_has_ended(runs: Path, status: Status) -> None:
    work(runs, None, status)
    assert_all_is_there(runs, str(status))


@pytest.mark.parametrize("server", ["dead", "frozen"])
def test_a_task_goes_on_without_a_server_and_is_stored_later_once(
    runs: Path, monkeypatch: pytest.MonkeyPatch, server: str
) -> None:
    monkeypatch.setenv("MLFLOW_HTTP_REQUEST_TIMEOUT", "2")
    monkeypatch.setattr(stored_run, "_WAIT_S", 10.0)
    with socket.socket() as frozen:
        frozen.bind(("127.0.0.1", 0))
        frozen.listen(8)  # takes connections and never answers
        work(runs, "http://127.0.0.1:9" if server == "dead" else f"http://127.0.0.1:{frozen.getsockname()[1]}")
    assert json.loads((runs / "precision" / "run.json").read_text())["status"] == "FINISHED"
    store = open_store(runs, None, "ablate")
    copy_tasks(store, runs, "another study")
    assert not store.client.search_runs([store.experiment_id])
    copy_tasks(store, runs, "study")
    ended = assert_all_is_there(runs)
    copy_tasks(store, runs, "study")
    assert assert_all_is_there(runs) == ended
    assert len(store.client.get_metric_history(stored(runs)[0].info.run_id, "order/mae")) == 1


def test_a_task_that_is_stopped_is_stored_as_stopped_with_what_it_has(runs: Path) -> None:
    for error, status in ((KeyboardInterrupt, "KILLED"), (ZeroDivisionError, "FAILED")):
        with pytest.raises(error):
            work(runs, None, stopped_by=error)
        run, files = stored(runs)
        assert (run.info.status, files) == (status, {"table.csv", "vector/figure.pdf"})


@pytest.mark.parametrize("damage", ["", "[]", '{"study": "study"}', '{"study": "study", "status": 3, "tags": {}}'])
def test_a_damaged_record_stops_no_comparison(runs: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    (runs / "precision").mkdir()
    (runs / "precision" / "run.json").write_text(damage)
    copy_tasks(open_store(runs, None, "ablate"), runs, "study")
    assert "run.json: not copied to the tracking store" in caplog.text


def test_a_record_names_files_of_its_own_folder_only(runs: Path) -> None:
    (runs / "secret.txt").write_text("canary")
    work(runs, "http://127.0.0.1:9")
    path = runs / "precision" / "run.json"
    (runs / "precision" / "secret.txt").write_text("public")
    path.write_text(json.dumps(json.loads(path.read_text()) | {"files": ["../secret.txt"]}))
    store = open_store(runs, None, "ablate")
    copy_tasks(store, runs, "study")
    uri = store.client.get_run(stored(runs)[0].info.run_id).info.artifact_uri
    assert (Path(uri.removeprefix("file://")) / "secret.txt").read_text() == "public"


def test_work_that_takes_longer_is_not_waited_for() -> None:
    assert within(10, lambda: 3) == 3
    with pytest.raises(ZeroDivisionError):
        within(10, lambda: 1 // 0)
    started = time.perf_counter()
    with pytest.raises(TimeoutError, match=r"^no end after 0\.1 s$"):
        within(0.1, lambda: time.sleep(5))
    assert time.perf_counter() - started < 4


def test_a_thread_that_the_system_has_no_memory_for_is_memory_that_is_out(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(_thread, "start_new_thread", refused)
    with pytest.raises(MemoryError, match="can't start new thread"):
        within(10, lambda: 3)
