"""The store of runs: one parent for each study, one child for each job; an existing run is found again.

The default store, an SQLite file, is a copy of what the runs have on disk. It is therefore never mended: one that
cannot be used is set aside, and another is made and filled.
"""

import json
import logging
import sqlite3
import uuid
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import quote

from filelock import FileLock
from mlflow import MlflowClient
from mlflow.entities import Run, ViewType
from mlflow.exceptions import MlflowException
from sqlalchemy.exc import SQLAlchemyError

from ablate.storage import digest, known_json, remove_partial, write_json, write_text, written_whole

_LOG = logging.getLogger(__name__)
_LOCK_S, _BUSY_S = 60.0, 20.0
_DAMAGED = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
_OF_TRANSACTIONS = ("-journal", "-wal", "-shm")
_PARENT_TAG = "mlflow.parentRunId"
_MOST_RUNS = 50_000  # of one answer, as MLflow allows
_NOTED = ".stored.json"  # in the folder of runs: ids of runs, which nobody can edit in MLflow's pages as names and tags
# What is raised where a store does not answer, refuses or is full.
UNAVAILABLE = (MlflowException, SQLAlchemyError, OSError)
# Tags of the experiment.
_AS = "made_as"  # its first name
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


class RunDeletedError(MlflowException):
    """Somebody has deleted a run in MLflow: it is neither written to nor made a second time."""

    def __init__(self, name: str, run_id: str) -> None:
        undone = f"`mlflow runs restore --run-id {run_id}` brings it back, after `mlflow gc` it is made anew"
        super().__init__(f"{name} was deleted in MLflow, and is left so; {undone}")


def reason(error: Exception) -> str:
    """Why a store could not be used, in one line."""
    text = " ".join(str(error).split())
    return _REFUSED.get(getattr(error, "error_code", ""), f"{type(error).__name__}: {text:.200}")


@dataclass(frozen=True)
class Store:
    """An open tracking store."""

    uri: str
    experiment_id: str
    lock: Path  # taken around whatever looks a run up and then makes it
    owner: Mapping[str, str]  # a tag that tells the folders of runs that share a server apart

    @property
    def client(self) -> MlflowClient:
        return MlflowClient(self.uri)


def open_store(runs: Path, uri: str | None, experiment: str) -> Store:
    """Create database and experiment where they are missing; an experiment that was deleted is restored.

    Safe for several processes: concurrent first use of a fresh SQLite store fails otherwise. Artifacts go to
    `runs/artifacts` for the default store, also after `runs` was moved or copied; a server given by `uri` decides for
    itself, and other folders of runs may use it too. A store that cannot be used is one of `UNAVAILABLE`.
    """
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.WARNING)
    logging.getLogger("mlflow.store.db.utils").setLevel(logging.CRITICAL)  # it prints the traceback of what it raises
    runs.mkdir(parents=True, exist_ok=True)
    lock, database, about = runs / ".mlflow.lock", runs / "mlflow.db", {**_ABOUT, _AS: experiment}
    location = None if uri else (runs / "artifacts").as_uri()
    with FileLock(lock, timeout=_LOCK_S):
        if uri is not None:
            make_database(uri)
        elif not database.exists():
            _make(database)
        elif not _is_whole(database):
            replace_database(database, "it is damaged")
        why = ""
        try:
            client = MlflowClient(uri or default_uri(runs))
            known = client.get_experiment_by_name(experiment)
            if known is None:  # unless somebody has given it another name
                known = next(iter(client.search_experiments(ViewType.ALL, 1, f"tags.{_AS} = '{experiment}'")), None)
            artifacts = str(known.artifact_location) if known else ""
            is_own = artifacts.startswith("file:") and artifacts.endswith("/artifacts")  # and not at a server's
            if location and is_own and artifacts != location:
                why = "the folder of runs was moved or copied since it was made"
        except MlflowException as error:
            if location is None or error.error_code == "TEMPORARILY_UNAVAILABLE":
                raise
            why = f"MLflow cannot read it ({reason(error)})"
        if why:  # such as another version of MLflow: the default store is not mended, but filled again
            replace_database(database, why)
            client, known = MlflowClient(default_uri(runs)), None
        try:
            identity = str(known.experiment_id if known else client.create_experiment(experiment, location, about))
        except MlflowException as error:  # somebody else has just made it
            exists = error.error_code == "RESOURCE_ALREADY_EXISTS"
            if not (exists and (known := client.get_experiment_by_name(experiment))):
                raise
            identity = str(known.experiment_id)
        if known and known.lifecycle_stage == "deleted":
            client.restore_experiment(identity)
        if known and _AS not in known.tags:
            client.set_experiment_tag(identity, _AS, experiment)
        if uri is None:
            return Store(default_uri(runs), identity, lock, {})
        owner = runs / ".owner"  # the name by which a server knows this folder of runs, wherever it is moved
        if not owner.exists():
            write_text(owner, uuid.uuid4().hex)
        return Store(uri, identity, lock, {"runs": owner.read_text("utf-8")})


def parent_run(store: Store, study: str, task: str = "") -> str:
    """Id of the study's parent run, or of its run of a task such as `precision`; it is created when there is none."""
    return _run(store, task or study, {"study": study, "kind": task or "study", **store.owner}, {})


def child_run(
    store: Store, parent: str, name: str, config_hash: str, tags: Mapping[str, str], start_ms: int | None = None
) -> str:
    """Id of the job's run, whoever left or renamed it; `parent` takes over one of a study's run that is no more."""
    known_by = {"kind": "job", "config_hash": config_hash, "variant": tags["variant"], "study": tags["study"]}
    run_id = _run(store, name, {**known_by, **store.owner}, {**tags, _PARENT_TAG: parent}, start_ms)
    above = store.client.get_run(run_id).data.tags.get(_PARENT_TAG)
    if above and above != parent and _run_of(store.client, above) is None:  # `mlflow gc` has removed the study's run
        store.client.set_tag(run_id, _PARENT_TAG, parent)
    return run_id


def child_runs(store: Store, parent: str) -> dict[tuple[str, str], tuple[str, dict[str, str]]]:
    """Id and tags of all jobs' runs under `parent`, by their tags `variant` and `config_hash`."""
    query = f"tags.`{_PARENT_TAG}` = '{parent}'"
    runs = store.client.search_runs([store.experiment_id], query, max_results=_MOST_RUNS)
    by = {(r.data.tags.get("variant", ""), r.data.tags.get("config_hash", "")): r for r in runs}
    return {key: (str(run.info.run_id), dict(run.data.tags)) for key, run in by.items()}


def _run(
    store: Store, name: str, known_by: Mapping[str, str], tags: Mapping[str, str], start_ms: int | None = None
) -> str:
    """Id of the run that was made for `known_by`, or has them as tags, or of a new one with all tags.

    What somebody has edited since stays; a run that was deleted is a `RunDeletedError`.
    """
    query = " and ".join(f"tags.`{tag}` = '{value}'" for tag, value in known_by.items())
    noted = store.lock.with_name(_NOTED)
    with FileLock(store.lock, timeout=_LOCK_S):
        client, ids = store.client, known_json(noted)
        run = _run_of(client, ids.get(key := digest([store.uri, known_by])))
        if run is None or run.info.experiment_id != store.experiment_id:
            matches = client.search_runs([store.experiment_id], query, ViewType.ALL)
            # Active ones come before deleted ones.
            run = min(matches, key=lambda run: run.info.lifecycle_stage, default=None)
        run = run or client.create_run(store.experiment_id, start_ms, {**tags, **known_by}, run_name=name)
        if run.info.lifecycle_stage == "deleted":
            raise RunDeletedError(name, run.info.run_id)
        if ids.get(key) != run.info.run_id:
            write_json(noted, {**ids, key: run.info.run_id})
        return str(run.info.run_id)


def _run_of(client: MlflowClient, run_id: str | None) -> Run | None:
    """The run of a noted id; None where none is noted, or the store has it no more."""
    try:
        return client.get_run(run_id) if run_id else None
    except MlflowException as error:
        if error.error_code == "RESOURCE_DOES_NOT_EXIST":
            return None
        raise


def pages(store: Store, run_id: str, run_ids: Sequence[str]) -> tuple[str, str]:
    """Links, relative to MLflow's address, to the report of a study's run, and to the comparison of some runs."""
    runs, experiments = (quote(json.dumps(list(ids))) for ids in (run_ids, [store.experiment_id]))
    report = f"#/experiments/{store.experiment_id}/runs/{run_id}/artifacts/report.html"
    return report, f"#/compare-runs?runs={runs}&experiments={experiments}"


def default_uri(runs: Path) -> str:
    """URI of the SQLite file in the folder of all runs."""
    return f"sqlite:///{runs / 'mlflow.db'}"


def replace_database(path: Path, why: str) -> None:
    """Give the default store, with its artifacts, another name: it is kept, and a new one is filled from disk."""
    aside = path.with_name(f"mlflow-{datetime.now(UTC):%Y%m%d-%H%M%S-%f}.db")
    if (artifacts := path.with_name("artifacts")).exists():  # first: what is killed here begins again
        artifacts.rename(aside.with_suffix(".artifacts"))
    for suffix in ("", *_OF_TRANSACTIONS):
        if (file := Path(f"{path}{suffix}")).exists():
            file.rename(f"{aside}{suffix}")
    _LOG.warning("%s: %s; it is now %s.*; task=compare of each study fills a new one", path, why, aside.with_suffix(""))
    _make(path)


def make_database(uri: str) -> None:
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
