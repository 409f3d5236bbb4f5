"""SQLite files of the tracking store: made whole, and set aside where they cannot be used.

The default store is a copy of what the runs have on disk. It is therefore never mended: it is made again and filled.
"""

import logging
import sqlite3
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock
from mlflow import MlflowClient

from ablate.storage import remove_partial, written_whole

_LOG = logging.getLogger(__name__)
_LOCK_S = 60.0
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_OF_TRANSACTIONS = ("-journal", "-wal", "-shm")


def database(runs: Path) -> Path:
    """The SQLite file in the folder of all runs."""
    return runs / "mlflow.db"


def default_uri(runs: Path) -> str:
    """URI of the SQLite file in the folder of all runs."""
    return f"sqlite:///{database(runs)}"


def make_default_database(runs: Path) -> None:
    """Make the SQLite file of the default store where there is none; one process at a time may call this.

    Raises
    ------
    OSError
        When another program holds the file locked for 20 s.
    """
    path = database(runs)
    if path.exists() and not _is_whole(path):
        set_aside(runs, "it is damaged")
    if not path.exists():
        _make(path)


def set_aside(runs: Path, why: str) -> None:
    """Give the file of the default store another name; its contents are kept, and a new one is filled from disk."""
    path = database(runs)
    aside = path.with_name(f"mlflow-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.db")
    for suffix in ("", *_OF_TRANSACTIONS):
        if (file := Path(f"{path}{suffix}")).exists():
            file.rename(f"{aside}{suffix}")
    _LOG.warning("%s: %s; it is now %s, and a new one is filled by task=compare of each study", path, why, aside)


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


def _is_whole(path: Path) -> bool:
    """Whether SQLite can read the file, and MLflow has laid it out to the end: the table of its version is the last."""
    with closing(sqlite3.connect(path, timeout=20)) as connection:
        try:
            tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        except sqlite3.DatabaseError as error:
            if error.sqlite_errorcode in _DAMAGED:
                return False
            raise OSError(f"{path}: {error}") from error
    return {"alembic_version", "experiments", "runs"} <= tables
