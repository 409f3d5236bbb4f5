"""MLflow runs: one parent for each study, one child for each job; an existing run is found again."""

import json
import logging
import uuid
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from filelock import FileLock
from mlflow import MlflowClient
from mlflow.entities import Experiment, Run, ViewType
from mlflow.exceptions import MlflowException
from sqlalchemy.exc import SQLAlchemyError

from ablate.storage import write_text
from ablate.tracking.database import default_uri, make_database, make_default_database, set_aside

_LOCK_S = 60.0
_PARENT_TAG = "mlflow.parentRunId"
_OWNER_TAG = "runs"
# What is raised where a store does not answer, refuses or is full.
UNAVAILABLE = (MlflowException, SQLAlchemyError, OSError)
_ABOUT = (
    "A run of the first level is a study: its description has the comparison and links to the report and to its "
    "variants side by side. Below it (unfold with +) is a run for each variant and seed."
)
_EXPERIMENT_TAGS = {
    "mlflow.experimentKind": "custom_model_development",  # the pages then show runs and models, not prompts and traces
    "mlflow.note.content": _ABOUT,
}


_REFUSED = {
    "UNAUTHENTICATED": "the server takes another user or password than MLFLOW_TRACKING_USERNAME and "
    "MLFLOW_TRACKING_PASSWORD hold",
    "PERMISSION_DENIED": "your user may not write there; tracking.experiment=<name> makes an experiment of your own",
}


def reason(error: Exception) -> str:
    """Why a store could not be used, in one line."""
    said = " ".join(str(error).split())
    return _REFUSED.get(getattr(error, "error_code", ""), f"{type(error).__name__}: {said:.200}")


@dataclass(frozen=True)
class Store:
    """An open tracking store."""

    uri: str
    experiment_id: str
    lock: Path  # taken around whatever looks a run up and then makes it
    owner: str | None = None  # tells the folders of runs that share a server apart

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
    lock = runs / ".mlflow.lock"
    location = None if uri else (runs / "artifacts").as_uri()
    with FileLock(lock, timeout=_LOCK_S):
        if uri is None:
            make_default_database(runs)
        else:
            make_database(uri)
        why = ""
        try:
            client = MlflowClient(uri or default_uri(runs))
            known = client.get_experiment_by_name(experiment)
            if location and known and _is_own(known) and known.artifact_location != location:
                why = "the folder of runs was moved or copied since it was made"
        except MlflowException as error:
            if location is None or error.error_code == "TEMPORARILY_UNAVAILABLE":
                raise
            why = f"MLflow cannot read it ({reason(error)})"
        if why:  # such as another version of MLflow: the default store is not mended, but filled again
            set_aside(runs, why)
            make_default_database(runs)
            client, known = MlflowClient(default_uri(runs)), None
        if known is None:
            identity = _new_experiment(client, experiment, location)
        else:
            identity = str(known.experiment_id)
            if known.lifecycle_stage == "deleted":
                client.restore_experiment(identity)
        return Store(uri or default_uri(runs), identity, lock, _owner(runs) if uri else None)


def _new_experiment(client: MlflowClient, name: str, location: str | None) -> str:
    """Id of a new experiment, or of the one that somebody else has just made."""
    try:
        return str(client.create_experiment(name, location, _EXPERIMENT_TAGS))
    except MlflowException as error:
        if error.error_code != "RESOURCE_ALREADY_EXISTS" or (found := client.get_experiment_by_name(name)) is None:
            raise
        return str(found.experiment_id)


def _owner(runs: Path) -> str:
    """The name by which a server knows this folder of runs, wherever it is moved."""
    file = runs / ".owner"
    if not file.exists():
        write_text(file, uuid.uuid4().hex)
    return file.read_text("utf-8")


def _is_own(experiment: Experiment) -> bool:
    """Whether its artifacts lie beside the default store, and not at a server's."""
    location = str(experiment.artifact_location)
    return location.startswith("file:") and location.endswith("/artifacts")


def parent_run(store: Store, study: str) -> str:
    """Id of the study's parent run, which is created when there is none."""
    return _run_of_folder(store, study, {"study": study, "kind": "study"})


def task_run(store: Store, task: str, study: str) -> str:
    """Id of the run of a task such as `precision`, named as the task and created when there is none."""
    return _run_of_folder(store, task, {"study": study, "kind": task})


def _run_of_folder(store: Store, name: str, known_by: Mapping[str, str]) -> str:
    """Id of a run that is known by its study: two people who share a server may give two studies one name."""
    return _run(store, name, {**known_by, **({_OWNER_TAG: store.owner} if store.owner else {})})


def child_run(
    store: Store, parent: str, name: str, config_hash: str, tags: Mapping[str, str], start_ms: int | None = None
) -> str:
    """Id of the job's run under `parent`; a run that a killed job left, or that somebody renamed, is continued."""
    known_by = {"kind": "job", "config_hash": config_hash, _PARENT_TAG: parent, "variant": tags["variant"]}
    return _run(store, name, known_by, tags, start_ms)


def child_runs(store: Store, parent: str) -> dict[tuple[str, str], tuple[str, dict[str, str]]]:
    """Id and tags of all jobs' runs under `parent`, by their tags `variant` and `config_hash`."""
    runs: list[Run] = []
    token: str | None = ""
    while token is not None:
        page = store.client.search_runs(
            [store.experiment_id], f"tags.`{_PARENT_TAG}` = '{parent}'", page_token=token or None
        )
        runs, token = [*runs, *page], page.token or None
    by = {(r.data.tags.get("variant", ""), r.data.tags.get("config_hash", "")): r for r in runs}
    return {key: (str(run.info.run_id), dict(run.data.tags)) for key, run in by.items()}


def _run(
    store: Store,
    name: str,
    known_by: Mapping[str, str],
    tags: Mapping[str, str] | None = None,
    start_ms: int | None = None,
) -> str:
    """Id of the run that has the tags `known_by`, or of a new one with all tags."""
    query = " and ".join(f"tags.`{tag}` = '{value}'" for tag, value in known_by.items())
    with FileLock(store.lock, timeout=_LOCK_S):
        client = store.client
        found = client.search_runs([store.experiment_id], query, run_view_type=ViewType.ACTIVE_ONLY, max_results=1)
        if found:
            return str(found[0].info.run_id)
        all_tags = {**(tags or {}), **known_by}
        made = client.create_run(store.experiment_id, start_ms, all_tags, run_name=name)
        return str(made.info.run_id)


def artifact_page(store: Store, run_id: str, path: str) -> str:
    """Link, relative to MLflow's address, to the artifact viewer with a file of a run open."""
    return f"#/experiments/{store.experiment_id}/runs/{run_id}/artifacts/{quote(path)}"


def comparison_page(store: Store, run_ids: Sequence[str]) -> str:
    """Link, relative to MLflow's address, to its comparison of runs: parallel coordinates, parameters, metrics."""
    runs, experiments = (quote(json.dumps(list(ids))) for ids in (run_ids, [store.experiment_id]))
    return f"#/compare-runs?runs={runs}&experiments={experiments}"
