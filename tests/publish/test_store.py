"""Runs are found again; a store that cannot be used, or that points elsewhere, is kept aside, and a new one filled."""

import math
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path

import mlflow.store.db.utils
import pytest
from mlflow import MlflowClient
from mlflow.entities import Metric
from mlflow.exceptions import MlflowException

from ablate.publish import default_uri
from ablate.publish import store as store_module
from ablate.publish.store import Store, open_store, reason
from ablate.publish.study_view import study_run
from ablate.settings.study import StudySettings
from support.published import client_of


def settings_in(runs: Path, uri: str | None = None, experiment: str = "ablate", study: str = "study") -> StudySettings:
    tracking = replace(StudySettings().tracking, uri=uri, experiment=experiment)
    return replace(StudySettings(), runs_dir=str(runs), study_name=study, tracking=tracking)


def opened(runs: Path, uri: str | None = None, experiment: str = "ablate") -> Store:
    return open_store(settings_in(runs, uri, experiment))


def study_in(runs: Path, uri: str | None = None, experiment: str = "ablate", study: str = "study") -> str:
    """Id of the run of a study, which is made where there is none."""
    settings = settings_in(runs, uri, experiment, study)
    return study_run(open_store(settings), settings)


def test_opening_twice_gives_the_same_runs(runs: Path) -> None:
    assert opened(runs) == opened(runs)
    assert study_in(runs) == study_in(runs)
    assert len({study_in(runs), study_in(runs, study="other"), study_in(runs, experiment="mine")}) == 3
    run = client_of(runs).get_run(study_in(runs))
    assert run.info.artifact_uri == (runs / "artifacts" / run.info.run_id / "artifacts").as_uri()
    experiment = client_of(runs).get_experiment_by_name("ablate")
    assert experiment is not None
    assert experiment.tags["mlflow.experimentKind"] == "custom_model_development"


NAMES = ["a b", "a#b", "a&b=c", "it's", "\u00e4", "a:b@c"]  # one with `?` or `%` is refused


@pytest.mark.parametrize("name", NAMES)
def test_a_folder_of_any_name_holds_a_store_and_nothing_is_written_beside_it(
    runs: Path, tmp_path: Path, name: str
) -> None:
    top = tmp_path / "top"
    folder = top / name / "runs"
    folder.mkdir(parents=True)
    shutil.copy(runs / "mlflow.db", folder)
    store = opened(folder)
    run = store.create("a run", "job", {"hash": "1"})
    (tmp_path / "shown.txt").write_text("as it was")
    store.log_files(run.info.run_id, [tmp_path / "shown.txt"])
    found = opened(folder).find("job", {"hash": "1"})
    assert found is not None
    assert found.info.run_id == run.info.run_id
    with closing(sqlite3.connect(folder / "mlflow.db")) as connection:
        assert connection.execute("SELECT run_uuid FROM runs").fetchall() == [(run.info.run_id,)]
    assert [path.name for path in top.iterdir()] == [name]
    (artifact,) = top.rglob("shown.txt")
    assert artifact.is_relative_to(folder / "artifacts")


def test_folders_of_runs_that_share_a_server_share_no_study(runs: Path, tmp_path: Path) -> None:
    uri = default_uri(runs)
    studies = [study_in(tmp_path / name, uri) for name in ("anna", "ben")]
    assert studies[0] != studies[1]
    (tmp_path / "anna").rename(tmp_path / "moved")
    assert study_in(tmp_path / "moved", uri) == studies[0]


def test_an_experiment_that_somebody_else_makes_in_the_same_moment_is_used(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = opened(runs)
    lookup = MlflowClient.get_experiment_by_name
    answers = iter([lambda *_: None, lambda *_: None, lookup])
    monkeypatch.setattr(MlflowClient, "get_experiment_by_name", lambda *a: next(answers)(*a))
    assert opened(runs) == made


def test_values_that_no_page_can_show_are_left_out_and_many_arrive_once(runs: Path) -> None:
    store, run_id = opened(runs), study_in(runs)
    values = {f"v{k}": float(k) for k in range(1200)}
    store.log_metrics(run_id, [Metric(key, value, 1, 0) for key, value in values.items()])
    store.log_metrics(run_id, [Metric("nan", math.nan, 1, 0), Metric("inf", math.inf, 1, 0), Metric("v1", 1.0, 1, 0)])
    assert client_of(runs).get_run(run_id).data.metrics == values
    assert len(client_of(runs).get_metric_history(run_id, "v1")) == 1


def test_a_reason_is_what_was_raised_in_one_line() -> None:
    assert reason(OSError("the disk\nis full")) == "OSError: the disk is full"
    assert len(reason(ValueError("x" * 5000))) < 250


def test_what_a_database_refuses_is_raised_and_not_printed_with_a_traceback(
    runs: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    store, run = opened(runs), study_in(runs)
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection, connection:
        connection.execute("ALTER TABLE runs RENAME TO elsewhere")  # an OperationalError, as a full disk is
    with pytest.raises(MlflowException, match="no such table"):
        store.client.set_terminated(run)
    assert "Traceback" not in capfd.readouterr().err


def test_a_database_that_is_locked_or_cannot_be_opened_is_left_where_it_is(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_module, "_BUSY_S", 0.1)
    (tmp_path / "mlflow.db").mkdir()
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        for folder, why in ((runs, "database is locked"), (tmp_path, "unable to open database file")):
            with pytest.raises(OSError, match=f"mlflow.db: {why}"):
                opened(folder)
            assert len(list(folder.glob("mlflow*db"))) == 1


class Killed(BaseException):
    """In place of SIGKILL."""


def test_a_process_that_is_killed_while_it_makes_the_database_leaves_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def killed(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(mlflow.store.db.utils, "_upgrade_db", killed)
        patch.setattr(Path, "unlink", lambda *_, **__: None)  # what is killed does not tidy up
        with pytest.raises(Killed):
            opened(tmp_path)
    assert list(tmp_path.glob("*.partial.db")), "nothing was begun"
    assert not (tmp_path / "mlflow.db").exists()
    assert study_in(tmp_path)
    assert not list(tmp_path.glob("*.partial.db"))


def changed(database: Path, statement: str, *values: str) -> None:
    with closing(sqlite3.connect(database)) as connection, connection:
        connection.execute(statement, values)


def of_another_schema(runs: Path) -> None:
    changed(runs / "mlflow.db", "UPDATE alembic_version SET version_num = 'of the future'")


def overwritten(runs: Path) -> None:
    (runs / "mlflow.db").write_bytes(b"no database" * 1000)


def half_made(runs: Path) -> None:
    (runs / "mlflow.db").unlink()
    changed(runs / "mlflow.db", "CREATE TABLE experiments (experiment_id INTEGER)")


def with_artifacts_elsewhere(runs: Path) -> None:
    opened(runs)
    changed(runs / "mlflow.db", "UPDATE experiments SET artifact_location = ?", (runs.parent / "elsewhere").as_uri())


@pytest.mark.parametrize("damage", [of_another_schema, overwritten, half_made, with_artifacts_elsewhere])
def test_a_database_that_cannot_be_used_is_kept_aside(
    runs: Path,
    empty_database: Path,
    damage: Callable[[Path], None],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(store_module, "_make", partial(shutil.copy, empty_database))  # the same, and seconds sooner
    (runs / "artifacts").mkdir()
    damage(runs)
    before = (runs / "mlflow.db").read_bytes()
    store = opened(runs)
    assert study_in(runs) == study_in(runs)
    store.client.log_text(study_in(runs), "told", "note.txt")
    assert [path.read_text() for path in (runs / "artifacts").rglob("note.txt")] == ["told"]
    (aside,) = runs.glob("mlflow.*.db")
    assert aside.read_bytes() == before
    assert str(aside.with_suffix("")) in caplog.text
    assert aside.with_suffix(".artifacts").is_dir()  # what the old database names lies in a folder of its own
    assert not (runs.parent / "elsewhere").exists()


def test_the_journal_of_a_removed_database_is_not_applied_to_the_new_one(runs: Path) -> None:
    (runs / "mlflow.db").unlink()
    (runs / "mlflow.db-journal").write_bytes(b"of another file")
    assert study_in(runs)
    assert not (runs / "mlflow.db-journal").exists()


_OPEN = """
import sys
from pathlib import Path
from publish.test_store import study_in

print(study_in(Path(sys.argv[1])))
"""


@pytest.mark.slow
def test_processes_that_start_together_share_one_database(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _OPEN, str(tmp_path)]
    tests = Path(__file__).parents[1]
    started = [subprocess.Popen(command, cwd=tests, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    outputs = [process.communicate(timeout=600)[0] for process in started]
    assert [process.returncode for process in started] == [0] * 4
    assert len(set(outputs)) == 1
    assert len(outputs[0].strip()) == 32
