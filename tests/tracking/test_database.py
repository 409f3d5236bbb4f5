"""The default database is whole or not there, and one that cannot be read is kept aside while a new one is filled."""

import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import mlflow.store.db.utils
import pytest

from ablate.tracking import open_store, parent_run


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
    runs: Path, damage: Callable[[Path], None], caplog: pytest.LogCaptureFixture
) -> None:
    damage(runs / "mlflow.db")
    before = (runs / "mlflow.db").read_bytes()
    store = open_store(runs, None, "ablate")
    assert parent_run(store, "study") == parent_run(open_store(runs, None, "ablate"), "study")
    (aside,) = runs.glob("mlflow-*.db")
    assert aside.read_bytes() == before
    assert str(aside) in caplog.text


def test_the_journal_of_a_removed_database_is_not_applied_to_the_new_one(runs: Path) -> None:
    (runs / "mlflow.db").unlink()
    (runs / "mlflow.db-journal").write_bytes(b"of another file")
    assert parent_run(open_store(runs, None, "ablate"), "study")
    assert not (runs / "mlflow.db-journal").exists()
