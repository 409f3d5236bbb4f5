"""Runs are found again rather than made twice; a database that cannot be read is kept aside, and a new one filled."""

import json
import math
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path

import mlflow.data
import mlflow.store.db.utils
import pytest
from ablate.tracking import Status, StoredRun, child_run, default_uri, open_store, parent_run
from ablate.tracking import store as store_module
from mlflow import MlflowClient
from mlflow.data.schema import TensorDatasetSchema
from mlflow.exceptions import MlflowException
from mlflow.store.tracking.sqlalchemy_store import SqlAlchemyStore

TAGS = {"variant": "sa2h", "study": "study"}


def test_opening_twice_gives_the_same_runs(runs: Path) -> None:
    first = open_store(runs, None, "ablate")
    parent = parent_run(first, "quick-fetal")
    child = child_run(first, parent, "sa2h/seed0", "abc", TAGS)
    second = open_store(runs, None, "ablate")
    assert second == first
    assert parent_run(second, "quick-fetal") == parent
    assert child_run(second, parent, "sa2h/seed0", "abc", TAGS) == child
    assert child_run(second, parent, "sa2h/seed1", "abd", TAGS) != child
    assert parent_run(second, "other") != parent


def test_another_experiment_has_runs_of_its_own(runs: Path) -> None:
    known = [open_store(runs, None, name) for name in ("ablate", "mine")]
    parents = [parent_run(store, "study") for store in known]
    children = [child_run(*pair, "sa2h/seed0", "abc", TAGS) for pair in zip(known, parents, strict=True)]
    for store, *made in zip(known, parents, children, strict=True):
        held = {run.info.run_id for run in store.client.search_runs([store.experiment_id])}
        assert held == set(made)


def edited(client: MlflowClient, parent: str, child: str) -> None:
    """What a person may change in MLflow's pages."""
    client.rename_experiment(client.get_run(parent).info.experiment_id, "mine")
    for run_id in (parent, child):
        client.set_tag(run_id, "mlflow.runName", "the best")
        for tag in ("kind", "config_hash", "study", "variant", "mlflow.parentRunId"):
            if tag in client.get_run(run_id).data.tags:
                client.delete_tag(run_id, tag)


def test_what_somebody_edits_or_deletes_in_mlflow_is_found_again_and_left_so(runs: Path) -> None:
    def ids() -> tuple[str, str]:
        store = open_store(runs, None, "ablate")
        parent = parent_run(store, "study")
        return parent, child_run(store, parent, "sa2h/seed0", "abc", TAGS)

    made, client = ids(), MlflowClient(default_uri(runs))
    edited(client, *made)
    assert ids() == made
    assert client.get_run(made[1]).info.run_name == "the best"
    for run_id in reversed(made):
        client.delete_run(run_id)
        with pytest.raises(MlflowException, match=f"was deleted in MLflow, .* restore --run-id {run_id}"):
            ids()
    for run_id in made:
        client.restore_run(run_id)
    (runs / ".stored.json").write_text("{")
    client.set_tag(made[0], "study", "study")
    client.set_tag(made[0], "kind", "study")
    study, child = ids()
    assert study == made[0], "its tags tell as well"
    client.delete_run(study)
    SqlAlchemyStore(default_uri(runs), str(runs))._hard_delete_run(study)  # as `mlflow gc`
    assert ids() == (client.get_run(child).data.tags["mlflow.parentRunId"], child) != (study, child)


def test_a_run_carries_what_was_logged(runs: Path) -> None:
    store = open_store(runs, None, "ablate")
    parent = parent_run(store, "study")
    run = StoredRun(store, child_run(store, parent, "sa2h/seed0", "abc", TAGS))
    run.scores({"test/psnr": 17.5, "identical": math.inf, "undefined": math.nan})
    run.parameters({"model.width": 0.25})
    run.parameters({"model.width": 0.5, "seed": 0})  # a resumed run keeps what it has
    (runs / "a.txt").write_text("x")
    run.artifact(runs / "a.txt", "provenance")
    run.mark(Status.finished)
    client = MlflowClient(default_uri(runs))
    stored = client.get_run(run.run_id)
    assert stored.data.metrics == {"test/psnr": 17.5}
    assert stored.data.params == {"model.width": "0.25", "seed": "0"}
    assert stored.data.tags["mlflow.parentRunId"] == parent
    assert stored.info.status == "FINISHED"
    assert stored.info.artifact_uri.startswith((runs / "artifacts").as_uri())
    assert [a.path for a in client.list_artifacts(run.run_id, "provenance")] == ["provenance/a.txt"]


def test_a_run_has_its_data_set_and_its_model_once_and_the_scores_are_of_both(runs: Path) -> None:
    store = open_store(runs, None, "ablate")
    for _ in range(2):
        run = StoredRun(store, parent_run(store, "study"))
        run.dataset("fetal-abc", "abc", runs / "data", 240, {"segmentation": "uint8"}, {"target": "uint8"})
        run.scores({"test/psnr": 17.5}, 1000, run.model("sa2h.depth-8"))
    stored = store.client.get_run(run.run_id)
    (used,) = stored.inputs.dataset_inputs
    assert (used.dataset.name, used.dataset.digest) == ("fetal-abc", "abc")
    assert json.loads(used.dataset.profile) == {"num_rows": 240}
    assert mlflow.data.get_source(used).uri == str(runs / "data")
    schema = TensorDatasetSchema.from_dict(json.loads(used.dataset.schema))
    assert (schema.features.input_names(), schema.targets.input_names()) == (["segmentation"], ["target"])
    assert {tag.key: tag.value for tag in used.tags} == {"mlflow.data.context": "training"}
    (model,) = store.client.search_logged_models([store.experiment_id])
    assert (model.name, model.source_run_id, model.status) == ("sa2h-depth-8", run.run_id, "READY")
    (score,) = model.metrics
    assert (score.key, score.value, score.dataset_name, score.dataset_digest) == ("test/psnr", 17.5, "fetal-abc", "abc")
    assert stored.data.metrics == {"test/psnr": 17.5}
    assert store.client.get_experiment(store.experiment_id).tags["mlflow.experimentKind"] == "custom_model_development"


def test_scores_of_a_call_that_was_given_up_and_arrived_all_the_same_are_stored_once(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = open_store(runs, None, "ablate")
    run = StoredRun(store, parent_run(store, "study"))
    before = store.client.get_run(run.run_id)
    run.scores({"test/psnr": 17.5}, 1000)  # arrives after it is looked for
    with monkeypatch.context() as patch:
        patch.setattr(MlflowClient, "get_run", lambda *_: before)
        run.scores({"test/psnr": 17.5}, 1000)
    run.scores({"test/psnr": 18.0}, 2000)  # scored again
    history = store.client.get_metric_history(run.run_id, "test/psnr")
    assert [(p.value, p.timestamp, p.step) for p in history] == [(17.5, 1000, 0), (18.0, 2000, 1)]
    assert store.client.get_run(run.run_id).data.metrics == {"test/psnr": 18.0}


def test_a_score_that_is_no_more_becomes_nan_once_and_curves_and_times_stay(runs: Path) -> None:
    store = open_store(runs, None, "ablate")
    run = StoredRun(store, parent_run(store, "study"))
    run.scores({"test/psnr": 17.5, "test/dark": 1.0, "val/psnr_curve": 9.0, "ms_per_frame": 5.0})
    for _ in range(2):
        run.scores({"test/psnr": 17.5, "test/dark": math.nan}, whole=True)
    kept = store.client.get_run(run.run_id).data.metrics
    assert math.isnan(kept.pop("test/dark"))
    assert kept == {"test/psnr": 17.5, "val/psnr_curve": 9.0, "ms_per_frame": 5.0}
    assert len(store.client.get_metric_history(run.run_id, "test/dark")) == 2


_OPEN = """
import sys
from pathlib import Path
from ablate.tracking import child_run, open_store, parent_run

store, tags = open_store(Path(sys.argv[1]), None, "ablate"), {"variant": "sa2h", "study": "study"}
print(child_run(store, parent_run(store, "study"), "sa2h/seed0", "abc", tags))
"""


@pytest.mark.slow
def test_processes_that_start_together_share_one_database(tmp_path: Path) -> None:
    command = [sys.executable, "-c", _OPEN, str(tmp_path)]
    started = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(4)]
    outputs = [process.communicate(timeout=600)[0] for process in started]
    assert [process.returncode for process in started] == [0] * 4
    assert len(set(outputs)) == 1
    assert len(outputs[0].strip()) == 32


def test_folders_of_runs_that_share_a_server_share_no_study(runs: Path, tmp_path: Path) -> None:
    uri = default_uri(runs)
    anna, ben = (open_store(tmp_path / name, uri, "ablate") for name in ("anna", "ben"))
    assert anna.experiment_id == ben.experiment_id
    studies = [parent_run(store, "quick-fetal") for store in (anna, ben)]
    assert studies[0] != studies[1]
    pairs = zip((anna, ben), studies, strict=True)
    children = {child_run(store, study, "sa2h/seed0", "abc", TAGS) for store, study in pairs}
    assert len(children) == 2
    (tmp_path / "anna").rename(tmp_path / "moved")
    assert parent_run(open_store(tmp_path / "moved", uri, "ablate"), "quick-fetal") == studies[0]


def test_an_experiment_that_somebody_else_makes_in_the_same_moment_is_used(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    there = open_store(runs, None, "ablate").experiment_id
    lookup = MlflowClient.get_experiment_by_name
    answers = iter([lambda *_: None, lookup])
    monkeypatch.setattr(MlflowClient, "get_experiment_by_name", lambda *a: next(answers)(*a))
    assert open_store(runs, None, "ablate").experiment_id == there


def test_what_a_database_refuses_is_raised_and_not_printed_with_a_traceback(
    runs: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    store = open_store(runs, None, "ablate")
    run = parent_run(store, "study")
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection, connection:
        connection.execute("ALTER TABLE runs RENAME TO elsewhere")  # an OperationalError, as a full disk is
    with pytest.raises(MlflowException, match="no such table"):
        StoredRun(store, run).mark(Status.finished)
    assert "Traceback" not in capfd.readouterr().err


def test_a_database_that_is_locked_or_cannot_be_opened_is_one_that_does_not_answer(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(store_module, "_BUSY_S", 0.1)
    (tmp_path / "mlflow.db").mkdir()
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        for folder, why in ((runs, "database is locked"), (tmp_path, "unable to open database file")):
            with pytest.raises(OSError, match=f"mlflow.db: {why}"):
                open_store(folder, None, "ablate")


class Killed(BaseException):
    """In place of SIGKILL."""


@pytest.mark.parametrize("name", ["mlflow.db", "own.db"], ids=["the default store", "a file that tracking.uri names"])
def test_a_process_that_is_killed_while_it_makes_the_database_leaves_none(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    uri = None if name == "mlflow.db" else f"sqlite:///{tmp_path / name}"

    def killed(*_: object) -> None:
        raise Killed

    with monkeypatch.context() as patch:
        patch.setattr(mlflow.store.db.utils, "_upgrade_db", killed)
        patch.setattr(Path, "unlink", lambda *_, **__: None)  # what is killed does not tidy up
        with pytest.raises(Killed):
            open_store(tmp_path, uri, "ablate")
    assert list(tmp_path.glob("*.partial.db")), "nothing was begun"
    assert not (tmp_path / name).exists()
    store = open_store(tmp_path, uri, "ablate")
    assert parent_run(store, "study")
    assert not list(tmp_path.glob("*.partial.db"))


def of_another_schema(path: Path) -> None:
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE alembic_version SET version_num = 'of the future'")


def overwritten(path: Path) -> None:
    path.write_bytes(b"no database" * 1000)


def half_made(path: Path) -> None:
    path.unlink()
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("CREATE TABLE experiments (experiment_id INTEGER)")


@pytest.mark.parametrize("damage", [of_another_schema, overwritten, half_made])
def test_a_database_that_cannot_be_read_is_kept_aside(
    runs: Path,
    empty_database: Path,
    damage: Callable[[Path], None],
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(store_module, "_make", partial(shutil.copy, empty_database))  # the same, and seconds sooner
    damage(runs / "mlflow.db")
    (runs / "artifacts").mkdir()
    before = (runs / "mlflow.db").read_bytes()
    store = open_store(runs, None, "ablate")
    assert parent_run(store, "study") == parent_run(open_store(runs, None, "ablate"), "study")
    (aside,) = runs.glob("mlflow-*.db")
    assert aside.read_bytes() == before
    assert str(aside.with_suffix("")) in caplog.text
    assert aside.with_suffix(".artifacts").is_dir()  # what the new database names lies in a folder of its own
    assert not (runs / "artifacts").exists()


def test_the_journal_of_a_removed_database_is_not_applied_to_the_new_one(runs: Path) -> None:
    (runs / "mlflow.db").unlink()
    (runs / "mlflow.db-journal").write_bytes(b"of another file")
    assert parent_run(open_store(runs, None, "ablate"), "study")
    assert not (runs / "mlflow.db-journal").exists()
