"""SQLite files: that of the default store is a copy of what the runs have on disk, so it may be made again."""

import logging
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock
from mlflow import MlflowClient
from mlflow.store.db.utils import _get_latest_schema_revision

from ablate.storage import remove_partial, written_whole

_LOG = logging.getLogger(__name__)
_LOCK_S = 60.0
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_ERROR)  # the last: a table is not there
_OF_TRANSACTIONS = ("-journal", "-wal", "-shm")
# Where MLflow stores the place of artifacts.
_PLACES = (
    ("experiments", "artifact_location"),
    ("runs", "artifact_uri"),
    ("logged_models", "artifact_location"),
    ("model_versions", "source"),
    ("model_versions", "storage_location"),
)


def database(runs: Path) -> Path:
    """The SQLite file in the folder of all runs."""
    return runs / "mlflow.db"


def default_uri(runs: Path) -> str:
    """URI of the SQLite file in the folder of all runs."""
    return f"sqlite:///{database(runs)}"


def make_default_database(runs: Path) -> None:
    """Make the SQLite file of the default store where there is none; one process at a time may call this.

    A file that this version of MLflow cannot read keeps its contents under another name.
    """
    path = database(runs)
    if path.exists() and _schema(path) != _get_latest_schema_revision():
        aside = path.with_name(f"mlflow-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.db")
        _move(path, aside)
        _LOG.warning("%s: damaged, or of another version of MLflow; it is now %s, and a new one is filled", path, aside)
    if not path.exists():
        _make(path)


def make_database(uri: str) -> None:
    """Make the SQLite file that `tracking.uri` names where there is none; other stores are left alone.

    Another folder of runs may make the same file, so a lock is taken beside it.
    """
    path = Path(uri.removeprefix("sqlite:///"))
    if not uri.startswith("sqlite:///") or "?" in uri or path.exists():
        return
    with FileLock(f"{path}.lock", timeout=_LOCK_S):
        if not path.exists():
            _make(path)


def _make(path: Path) -> None:
    """Make the file under another name, so that a kill or a full disk leaves none that cannot be opened."""
    remove_partial(path)
    for suffix in _OF_TRANSACTIONS:  # of a file that was removed; SQLite would apply them to the new one
        Path(f"{path}{suffix}").unlink(missing_ok=True)
    with written_whole(path) as partial:
        MlflowClient(f"sqlite:///{partial}").search_experiments()


def move_artifacts(runs: Path, stored: str, now: str) -> None:
    """Replace `stored`, the URI of the folder of artifacts, by `now` in all places: the folder of runs has moved."""
    with closing(sqlite3.connect(database(runs), timeout=20)) as connection, connection:
        for table, column in _PLACES:
            moved = f"UPDATE {table} SET {column} = ? || substr({column}, ?) WHERE {column} = ? OR {column} GLOB ?"
            connection.execute(moved, (now, len(stored) + 1, stored, f"{_literal(stored)}/*"))


def _literal(text: str) -> str:
    """A GLOB pattern that matches a text and nothing else."""
    return "".join(f"[{c}]" if c in "*?[" else c for c in text)


def _schema(path: Path) -> str | None:
    """The revision of MLflow's tables; None where the file has none that can be read."""
    with closing(sqlite3.connect(path, timeout=20)) as connection:
        try:
            row = connection.execute("SELECT version_num FROM alembic_version").fetchone()
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode in _DAMAGED:
                return None
            raise
    return None if row is None else str(row[0])


def _move(path: Path, to: Path) -> None:
    """Rename a database with the files of its unfinished transactions."""
    for suffix in ("", *_OF_TRANSACTIONS):
        if (file := Path(f"{path}{suffix}")).exists():
            file.rename(f"{to}{suffix}")
