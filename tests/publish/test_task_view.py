"""What a task leaves is on disk first: a store that is gone stops nothing, and has it later, once."""

import json
import shutil
import socket
from pathlib import Path

import pytest

from ablate.publish import published_task, task_view
from ablate.publish.store import open_store
from ablate.publish.task_view import publish_tasks
from ablate.settings.study import StudySettings
from support.published import active_runs, another_process, content_of, files_of, job_in, written

FILES = {"table.csv", "figure.png", "vector/figure.pdf"}


def settings_in(runs: Path, uri: str | None = None) -> StudySettings:
    return job_in(runs, uri=uri).settings


def work(runs: Path, uri: str | None = None, stopped_by: type[BaseException] | None = None) -> None:
    """A task named `precision`, with files, a folder and a link."""
    folder = runs / "precision"
    shutil.rmtree(folder, ignore_errors=True)
    with published_task(settings_in(runs, uri), folder) as view:
        for name in ("table.csv", "figure.png", "figure.pdf", "raw.npz"):
            (folder / name).write_text(name)
        (folder / "parts.csv").mkdir(exist_ok=True)
        (folder / "link.txt").symlink_to(runs / "mlflow.db")  # of a stranger: it is not followed
        if stopped_by is not None:
            raise stopped_by
        view.scores |= {"order/mae": 0.5, "order/psnr": float("nan")}
        view.description = "what it says"


def publish(runs: Path) -> None:
    another_process()
    settings = settings_in(runs)
    publish_tasks(open_store(settings), settings)


def assert_all_is_there(runs: Path) -> None:
    run = active_runs(runs)["precision"]
    assert run.info.status == "FINISHED"
    assert run.data.metrics == {"order/mae": 0.5}
    tags = {"kind": "precision", "study": "study", "scene": "fetal", "mlflow.note.content": "what it says"}
    assert run.data.tags.items() >= tags.items()
    assert files_of(runs, run).keys() == FILES


def test_a_task_is_in_the_store_when_it_has_ended_and_is_published_once(runs: Path) -> None:
    work(runs)
    assert_all_is_there(runs)
    before = written(runs)
    publish(runs)
    assert written(runs) == before
    first = active_runs(runs)["precision"].info.run_id
    work(runs)
    assert active_runs(runs)["precision"].info.run_id != first, "done again, it replaces its run"
    assert_all_is_there(runs)


@pytest.mark.parametrize(("error", "status"), [(KeyboardInterrupt, "KILLED"), (ZeroDivisionError, "FAILED")])
def test_a_task_that_is_stopped_is_shown_as_stopped_with_what_it_has(
    runs: Path, error: type[BaseException], status: str
) -> None:
    with pytest.raises(error):
        work(runs, stopped_by=error)
    run = active_runs(runs)["precision"]
    assert (run.info.status, files_of(runs, run).keys()) == (status, FILES)


@pytest.mark.parametrize("server", ["dead", "frozen"])
def test_a_task_goes_on_without_a_server_and_is_published_later_once(
    runs: Path, server: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(task_view, "_WAIT_S", 3.0)
    with socket.socket() as frozen:
        frozen.bind(("127.0.0.1", 0))
        frozen.listen(8)  # takes connections and never answers
        work(runs, "http://127.0.0.1:9" if server == "dead" else f"http://127.0.0.1:{frozen.getsockname()[1]}")
    (line,) = [record.getMessage() for record in caplog.records if "precision" in record.getMessage()]
    assert "task=compare publishes it" in line
    record = runs / "precision" / "task.json"
    assert json.loads(record.read_text())["status"] == "FINISHED"
    of_study = record.read_text()
    record.write_text(of_study.replace('"study": "study"', '"study": "another"'))
    publish(runs)
    assert not active_runs(runs)
    record.write_text(of_study)
    publish(runs)
    assert_all_is_there(runs)
    before = content_of(runs)
    publish(runs)
    assert content_of(runs) == before


@pytest.mark.parametrize("damage", [{"status": 3}, {"tags": ["scene"]}, {"scores": 1}, {"time": "now"}, None])
def test_a_damaged_record_stops_no_comparison(
    runs: Path, damage: dict[str, object] | None, caplog: pytest.LogCaptureFixture
) -> None:
    work(runs)
    record = runs / "precision" / "task.json"
    whole = record.read_text()
    record.write_text(whole[:-20] if damage is None else json.dumps(json.loads(whole) | damage))
    before = written(runs)
    publish(runs)
    assert "task.json: not published" in caplog.text
    assert written(runs) == before
