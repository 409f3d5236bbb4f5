"""The store of runs: its database, its experiment, and runs by what they are known by.

The default store, an SQLite file, holds nothing that is not on disk. It is therefore never mended: one that cannot be
used, or that points elsewhere, is set aside, and a new one is filled.
"""

import logging
import sqlite3
import uuid
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock
from mlflow import MlflowClient
from mlflow.entities import Experiment, Run
from mlflow.exceptions import MlflowException
from sqlalchemy.exc import SQLAlchemyError

from ablate.settings.study import StudySettings
from ablate.storage import remove_partial, write_text, written_whole

_LOG = logging.getLogger(__name__)
_LOCK_S, _BUSY_S = 60.0, 20.0
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_OF_TRANSACTIONS = ("-journal", "-wal", "-shm")
# What is raised where a store does not answer, refuses or is full.
UNAVAILABLE = (MlflowException, SQLAlchemyError, OSError)
# Tags of the experiment.
_ABOUT = {
    "mlflow.experimentKind": "custom_model_development",  # the pages then show runs and models, not prompts and traces
    "mlflow.note.content": "A run of the first level is a study: its description has the comparison and links to the "
    "report and to its variants side by side. Below it (unfold with +) is a run for each variant and seed.",
}
_REFUSED = {
    "UNAUTHENTICATED": "the server takes another user or password than MLFLOW_TRACKING_USERNAME and "
    "MLFLOW_TRACKING_PASSWORD hold",
    "PERMISSION_DENIED": "your user may not write there; tracking.experiment=<name> makes an experiment of your own",
}


def reason(error: BaseException) -> str:
    """Why a store could not be used, in one line."""
    text = " ".join(str(error).split())
    return _REFUSED.get(getattr(error, "error_code", ""), f"{type(error).__name__}: {text:.200}")


@dataclass(frozen=True)
class Store:
    """An open tracking store."""

    uri: str
    experiment_id: str
    lock: Path  # taken around whatever looks a run up and then makes or replaces it
    artifacts: str  # the address below which all artifacts lie; empty where a server decides
    owner: Mapping[str, str]  # a tag that tells the folders of runs that share a server apart

    @property
    def client(self) -> MlflowClient:
        return MlflowClient(self.uri)

    def find(self, known_by: Mapping[str, str]) -> Run | None:
        """The run that has these tags; None where there is none, or its artifacts would be written elsewhere."""
        query = " and ".join(f"tags.`{tag}` = {_quoted(value)}" for tag, value in {**known_by, **self.owner}.items())
        for run in self.client.search_runs([self.experiment_id], query):
            if str(run.info.artifact_uri).startswith(self.artifacts):
                return run
        return None

    def create(self, name: str, known_by: Mapping[str, str], start_ms: int | None = None) -> Run:
        """A new run with these tags."""
        tags = {**known_by, **self.owner}
        return self.client.create_run(self.experiment_id, start_ms, tags, run_name=name)


def _quoted(value: str) -> str:
    """A value of a query; MLflow's grammar has no escape, but two kinds of quotes."""
    return f'"{value}"' if "'" in value else f"'{value}'"


def default_uri(runs: Path) -> str:
    """The SQLite file in a folder of runs."""
    return f"sqlite:///{runs / 'mlflow.db'}"


def store_uri(settings: StudySettings) -> str:
    """The address of the store that the settings name."""
    return settings.tracking.uri or default_uri(settings.results)


def open_store(settings: StudySettings) -> Store:
    """Open the store that the settings name; database and experiment are created where they are missing.

    Safe for several processes: concurrent first use of a fresh SQLite store fails otherwise. Artifacts of the default
    store go to `<runs_dir>/artifacts`; a server given by `tracking.uri` decides for itself, and other folders of runs
    may use it too. A store that cannot be used is one of `UNAVAILABLE`.
    """
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.WARNING)
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)  # it prints the traceback of what it raises
    runs, experiment = settings.results, settings.tracking.experiment
    runs.mkdir(parents=True, exist_ok=True)
    lock = runs / ".mlflow.lock"
    with FileLock(lock, timeout=_LOCK_S):
        if settings.tracking.uri is None:
            return Store(default_uri(runs), _own_experiment(runs, experiment), lock, _artifacts(runs), {})
        uri = settings.tracking.uri
        _make_database(uri)
        owner = runs / ".owner"  # the name by which a server knows this folder of runs, wherever it is moved
        if not owner.exists():
            write_text(owner, uuid.uuid4().hex)
        return Store(uri, _experiment(MlflowClient(uri), experiment), lock, "", {"runs": owner.read_text("utf-8")})


def _artifacts(runs: Path) -> str:
    return (runs / "artifacts").as_uri()


def _own_experiment(runs: Path, name: str) -> str:
    """Id of the experiment in the default store; a database that cannot be used, or is another folder's, is replaced.

    It may come from anybody: artifacts are written to this folder of runs alone.
    """
    database, location = runs / "mlflow.db", _artifacts(runs)
    if not database.exists():
        _make(database)
    elif not _is_whole(database):
        _replace(database, "it is damaged")
    client = MlflowClient(default_uri(runs))
    try:
        experiment = client.get_experiment_by_name(name)
        if experiment is None or experiment.artifact_location == location:
            return _experiment(client, name, location)
        why = "its artifacts lie in another folder"
    except MlflowException as error:
        if error.error_code == "TEMPORARILY_UNAVAILABLE":
            raise
        why = f"MLflow cannot read it ({reason(error)})"  # such as another version of MLflow
    _replace(database, why)
    return _experiment(MlflowClient(default_uri(runs)), name, location)


def _experiment(client: MlflowClient, name: str, location: str | None = None) -> str:
    """Id of an experiment, which is made, or restored, where it is not there."""
    experiment: Experiment | None = client.get_experiment_by_name(name)
    if experiment is None:
        try:
            return str(client.create_experiment(name, location, _ABOUT))
        except MlflowException as error:  # somebody else has just made it
            experiment = client.get_experiment_by_name(name)
            if error.error_code != "RESOURCE_ALREADY_EXISTS" or experiment is None:
                raise
    if experiment.lifecycle_stage == "deleted":
        client.restore_experiment(experiment.experiment_id)
    return str(experiment.experiment_id)


def _replace(path: Path, why: str) -> None:
    """Set the default store aside, with its artifacts, and make a new one."""
    aside = path.with_name(f"mlflow.{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.db")
    artifacts = path.with_name("artifacts")
    if artifacts.exists():  # first: what is killed here begins again
        artifacts.rename(aside.with_suffix(".artifacts"))
    for suffix in ("", *_OF_TRANSACTIONS):
        file = Path(f"{path}{suffix}")
        if file.exists():
            file.rename(f"{aside}{suffix}")
    _LOG.warning("%s: %s; it is now %s.*; task=compare of each study fills a new one", path, why, aside.with_suffix(""))
    _make(path)


def _make_database(uri: str) -> None:
    """Make the SQLite file that `tracking.uri` names where there is none; other stores are left alone."""
    path = Path(uri.removeprefix("sqlite:///"))
    if not uri.startswith("sqlite:///") or "?" in uri or path.exists():
        return
    with FileLock(f"{path}.lock", timeout=_LOCK_S):  # another folder of runs may make the same file
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
    """Whether SQLite can read the file, and MLflow has laid it out to the end: the table of its version is the last.

    An OSError where it cannot be opened, or another program holds it locked for `_BUSY_S`.
    """
    try:
        with closing(sqlite3.connect(path, timeout=_BUSY_S)) as connection:
            tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    except sqlite3.DatabaseError as error:
        if error.sqlite_errorcode in _DAMAGED:
            return False
        raise OSError(f"{path}: {error}") from error
    return {"alembic_version", "experiments", "runs"} <= tables
