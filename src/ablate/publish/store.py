"""The store of runs: its database, its experiment, and runs by what they are known by.

The default store, an SQLite file, holds nothing that is not on disk. It is therefore never mended: one that cannot be
used, or that points elsewhere, is set aside, and a new one is filled.
"""

import logging
import math
import sqlite3
import uuid
from collections.abc import Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock
from mlflow import MlflowClient
from mlflow.entities import Experiment, Metric, Run
from mlflow.exceptions import MlflowException

from ablate.settings.study import StudySettings
from ablate.storage import remove_partial, write_text, written_whole

_LOG = logging.getLogger(__name__)
_LOCK_S, _BUSY_S = 60.0, 20.0
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_OF_TRANSACTIONS = ("-journal", "-wal", "-shm")
_KIND = "kind"  # a tag: job, study, or the name of a task
_REPLACED = "replaced"  # the kind of a run in whose place is another one
MOST_FOUND = 50_000  # MLflow takes no larger number
_MOST_VALUES = 500  # of a batch; MLflow takes 1,000
ABOUT = (
    "A run of the first level is a study: its description says which network is best, and links to its leaderboard, "
    "its variants side by side and its report. Below it (unfold with +) is a run for each variant and seed."
)
_KIND_OF_EXPERIMENT = {"mlflow.experimentKind": "custom_model_development"}  # pages of runs and models, not of prompts
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
    lock: Path  # around what looks the run of a study or a task up and makes it; no other lock is taken inside
    artifacts: str  # the address below which all artifacts lie; empty where a server decides
    owner: Mapping[str, str]  # a tag that tells the folders of runs that share a server apart

    @property
    def client(self) -> MlflowClient:
        return MlflowClient(self.uri)

    def find(self, kind: str, known_by: Mapping[str, str]) -> Run | None:
        """The run of a kind that has these tags; None where there is none, or its artifacts would lie elsewhere."""
        wanted = {_KIND: kind, **known_by, **self.owner}
        query = " and ".join(f"tags.`{tag}` = {_quoted(value)}" for tag, value in wanted.items())
        for run in self.client.search_runs([self.experiment_id], query):
            if self._holds(run):
                return run
        return None

    def _holds(self, run: Run) -> bool:
        """Whether the artifacts of a run lie where this store writes; a server decides that by itself."""
        place = f"{self.artifacts}/{run.info.run_id}/artifacts"
        return not self.artifacts or (run.info.artifact_uri == place and run.info.run_id.isalnum())

    def create(self, name: str, kind: str, known_by: Mapping[str, str], start_ms: int | None = None) -> Run:
        """A new run.

        Parameters
        ----------
        name : str
            Shown in MLflow's pages.
        kind : str
            `study`, `job`, or a task such as `precision`.
        known_by : mapping of str to str
            Tags that it is found by.
        start_ms : int, optional
            When what it shows began, ms since 1970; left out, now.
        """
        tags = {_KIND: kind, **known_by, **self.owner}
        return self.client.create_run(self.experiment_id, start_ms, tags, run_name=name)

    def discard(self, run: Run) -> None:
        """Delete a run in whose place another one is made; it stays deleted when its experiment is restored."""
        self.client.set_tag(run.info.run_id, _KIND, _REPLACED)
        self.client.delete_run(run.info.run_id)

    def log_metrics(self, run_id: str, metrics: Iterable[Metric]) -> None:
        """Publish values; NaN and infinite ones, which MLflow's pages cannot show, are left out."""
        finite = [metric for metric in metrics if math.isfinite(metric.value)]
        for start in range(0, len(finite), _MOST_VALUES):
            self.client.log_batch(run_id, metrics=finite[start : start + _MOST_VALUES])

    def log_files(self, run_id: str, paths: Iterable[Path]) -> None:
        """Publish files, PDFs in a folder of their own."""
        for path in paths:
            self.client.log_artifact(run_id, str(path), "vector" if path.suffix == ".pdf" else None)


def plain_files(paths: Iterable[Path]) -> list[Path]:
    """The files among `paths`, by name; no links, which in a folder from anybody may lead to any file of a machine."""
    return sorted(path for path in paths if path.is_file() and not path.is_symlink())


def _quoted(value: str) -> str:
    """A value of a query; MLflow's grammar has no escape, but two kinds of quotes."""
    return f'"{value}"' if "'" in value else f"'{value}'"


def default_uri(runs: Path) -> str:
    """The SQLite file in a folder of runs."""
    return f"sqlite:///{runs / 'mlflow.db'}"  # a folder with `?` or `%` is refused before


def store_uri(settings: StudySettings) -> str:
    """The address of the store that the settings name."""
    return settings.tracking.uri or default_uri(settings.results)


def open_store(settings: StudySettings) -> Store:
    """Open the store that the settings name; database and experiment are created where they are missing.

    Safe for several processes: concurrent first use of a fresh SQLite store fails otherwise. Artifacts of the default
    store go to `<runs_dir>/artifacts`; a server given by `tracking.uri` decides for itself, and other folders of runs
    may use it too. A store that cannot be used raises what MLflow, its database or the system says.
    """
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.WARNING)
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)  # it prints the traceback of what it raises
    runs, uri = settings.results, settings.tracking.uri
    experiment = settings.tracking.experiment
    runs.mkdir(parents=True, exist_ok=True)
    lock = runs / ".mlflow.lock"
    if uri is None:
        with FileLock(lock, timeout=_LOCK_S):
            experiment_id = _default_experiment(runs, experiment)
        return Store(default_uri(runs), experiment_id, lock, artifacts=_artifacts(runs), owner={})
    with FileLock(lock, timeout=_LOCK_S):
        owner = _owner(runs)
    experiment_id = _experiment(MlflowClient(uri), experiment)  # without the lock: a silent server is waited for here
    return Store(uri, experiment_id, lock, artifacts="", owner={"runs": owner})


def _owner(runs: Path) -> str:
    """The name by which a server knows this folder of runs, wherever it is moved."""
    file = runs / ".owner"
    if not file.exists():
        write_text(file, uuid.uuid4().hex)
    return file.read_text("utf-8")


def _artifacts(runs: Path) -> str:
    return (runs / "artifacts").as_uri()


def _default_experiment(runs: Path, name: str) -> str:
    """Id of the experiment in the default store; a database that cannot be used, or is another folder's, is replaced.

    It may come from anybody: artifacts are written to this folder of runs alone.
    """
    database, location = runs / "mlflow.db", _artifacts(runs)
    if not database.exists():
        _make(database)
    elif not _is_whole(database):
        _replace(database, "it is damaged")
    try:
        client = MlflowClient(default_uri(runs))
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
            return str(client.create_experiment(name, location, _KIND_OF_EXPERIMENT | {"mlflow.note.content": ABOUT}))
        except MlflowException as error:  # somebody else has just made it
            experiment = client.get_experiment_by_name(name)
            if error.error_code != "RESOURCE_ALREADY_EXISTS" or experiment is None:
                raise
    experiment_id = str(experiment.experiment_id)
    if experiment.lifecycle_stage == "deleted":
        client.restore_experiment(experiment_id)  # with every run that was ever deleted
        for run in client.search_runs([experiment_id], f"tags.{_KIND} = '{_REPLACED}'", max_results=MOST_FOUND):
            client.delete_run(run.info.run_id)
    return experiment_id


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
