"""MLflow runs: one parent for each study, one child for each job; an existing run is found again."""

import json
import logging
import os
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from urllib.parse import quote

os.environ.setdefault("MLFLOW_DISABLE_TELEMETRY", "true")

import numpy as np
from filelock import FileLock
from mlflow import MlflowClient
from mlflow.entities import Dataset, DatasetInput, Metric, Param, RunTag, ViewType

_PARENT_TAG = "mlflow.parentRunId"
_ABOUT = (
    "A run of the first level is a study: its description has the comparison and links to the report and to its "
    "variants side by side. Below it (unfold with +) is a run for each variant and seed."
)
_EXPERIMENT_TAGS = {
    "mlflow.experimentKind": "custom_model_development",  # the pages then show runs and models, not prompts and traces
    "mlflow.note.content": _ABOUT,
}
# MLflow writes an image and then a smaller copy; an image with both files is complete.
_WHOLE_IMAGE = re.compile(r".+?\+step\+\d+\+(?=.*\+compressed\.webp$)")


class Status(StrEnum):
    """How a run ended, in MLflow's words."""

    finished = "FINISHED"
    failed = "FAILED"
    killed = "KILLED"


@dataclass(frozen=True)
class Store:
    """An open tracking store."""

    uri: str
    experiment_id: str
    lock: Path  # taken around whatever looks a run up and then makes it

    @property
    def client(self) -> MlflowClient:
        return MlflowClient(self.uri)


def default_uri(runs: Path) -> str:
    """URI of the SQLite file in the folder of all runs."""
    return f"sqlite:///{runs / 'mlflow.db'}"


def open_store(runs: Path, uri: str | None, experiment: str) -> Store:
    """Create database and experiment where they are missing.

    Safe for several processes: concurrent first use of a fresh SQLite store fails otherwise. Artifacts go to
    `runs/artifacts` for the default store; a server given by `uri` decides for itself.
    """
    logging.getLogger("alembic").setLevel(logging.WARNING)
    logging.getLogger("mlflow").setLevel(logging.WARNING)
    runs.mkdir(parents=True, exist_ok=True)
    lock = runs / ".mlflow.lock"
    with FileLock(lock):
        client = MlflowClient(uri or default_uri(runs))
        found = client.get_experiment_by_name(experiment)
        if found is None:
            location = None if uri else (runs / "artifacts").as_uri()
            identity = str(client.create_experiment(experiment, location, _EXPERIMENT_TAGS))
        else:
            identity = str(found.experiment_id)
    return Store(uri or default_uri(runs), identity, lock)


def parent_run(store: Store, study: str) -> str:
    """Id of the study's parent run, which is created when there is none."""
    return _run(store, study, {"study": study, "kind": "study"})


def task_run(store: Store, task: str, study: str) -> str:
    """Id of the run of a task such as `precision`, named as the task and created when there is none."""
    return _run(store, task, {"study": study, "kind": task})


def child_run(store: Store, parent: str, name: str, config_hash: str, tags: Mapping[str, str]) -> str:
    """Id of the job's run under `parent`; a run that a killed job left is continued."""
    known_by = {"kind": "job", "config_hash": config_hash, _PARENT_TAG: parent}
    return _run(store, name, known_by, tags, f"attributes.run_name = '{name}'")


def _run(
    store: Store, name: str, known_by: Mapping[str, str], tags: Mapping[str, str] | None = None, *conditions: str
) -> str:
    """Id of the run that has the tags `known_by` and meets the conditions, or of a new one with all tags."""
    query = " and ".join([*conditions, *(f"tags.`{tag}` = '{value}'" for tag, value in known_by.items())])
    with FileLock(store.lock):
        client = store.client
        found = client.search_runs([store.experiment_id], query, run_view_type=ViewType.ACTIVE_ONLY, max_results=1)
        if found:
            run_id = str(found[0].info.run_id)
            client.update_run(run_id, status="RUNNING")
            return run_id
        made = client.create_run(store.experiment_id, tags={**(tags or {}), **known_by}, run_name=name)
        return str(made.info.run_id)


def artifact_page(store: Store, run_id: str, path: str) -> str:
    """Link, relative to MLflow's address, to the artifact viewer with a file of a run open."""
    return f"#/experiments/{store.experiment_id}/runs/{run_id}/artifacts/{quote(path)}"


def comparison_page(store: Store, run_ids: Sequence[str]) -> str:
    """Link, relative to MLflow's address, to its comparison of runs: parallel coordinates, parameters, metrics."""
    runs, experiments = (quote(json.dumps(list(ids))) for ids in (run_ids, [store.experiment_id]))
    return f"#/compare-runs?runs={runs}&experiments={experiments}"


class RunLog:
    """Writes to one run. Metrics are sent in batches, because each call costs a SQLite transaction."""

    def __init__(self, store: Store, run_id: str) -> None:
        self.store, self.run_id = store, run_id
        self._client = store.client
        self._waiting: list[Metric] = []
        self._images: set[str] | None = None  # those that the run has, once known
        self._flushed = time.monotonic()

    def metrics(self, values: Mapping[str, float], step: int = 0) -> None:
        """Queue values of one step; sent when five seconds have passed or 500 are waiting.

        NaN and infinite values are left out: MLflow would store infinity as the largest float.
        """
        now = int(time.time() * 1000)
        self._waiting += [
            Metric(key, float(value), now, int(step)) for key, value in values.items() if abs(float(value)) < 1e300
        ]
        if len(self._waiting) > 500 or time.monotonic() - self._flushed > 5:
            self.flush()

    def flush(self) -> None:
        """Send what is waiting."""
        while self._waiting:
            batch, self._waiting = self._waiting[:1000], self._waiting[1000:]
            self._client.log_batch(self.run_id, metrics=batch)
        self._flushed = time.monotonic()

    def parameters(self, values: Mapping[str, object]) -> None:
        """Log parameters; those that the run already has are left as they are."""
        known = self._client.get_run(self.run_id).data.params
        new = [Param(k, str(v)) for k, v in values.items() if k not in known]
        if new:
            self._client.log_batch(self.run_id, params=new)

    def tags(self, values: Mapping[str, object]) -> None:
        self._client.log_batch(self.run_id, tags=[RunTag(k, str(v)) for k, v in values.items()])

    def describe(self, markdown: str) -> None:
        """Set the description on the run's first page."""
        self.tags({"mlflow.note.content": markdown})

    def artifact(self, path: Path, folder: str | None = None) -> None:
        self._client.log_artifact(self.run_id, str(path), folder)

    def image(self, key: str, image: np.ndarray, step: int) -> None:
        """Log an (h, w) uint8 image of a series: MLflow shows those of one key with a slider over steps.

        A key has letters, digits, spaces and `_-./`. An image that the run has of this key and step is left: a job
        that goes on at its last checkpoint makes some again.
        """
        if self._images is None:
            there = self._client.list_artifacts(self.run_id, "images")
            self._images = {m[0] for a in there if (m := _WHOLE_IMAGE.match(Path(a.path).name))}
        name = f"{key.replace('/', '~')}+step+{step}+"
        if name not in self._images:
            self._client.log_image(self.run_id, image, key=key, step=step)
            self._images.add(name)

    def dataset(self, name: str, digest: str, folder: Path, frames: int) -> None:
        """Log the data set that the run is trained on; logging it again changes nothing."""
        made = Dataset(name, digest, "local", str(folder), profile=json.dumps({"num_rows": frames}))
        self._client.log_inputs(self.run_id, [DatasetInput(made)])

    def end(self, status: Status) -> None:
        """Send what is waiting and close the run."""
        self.flush()
        self._client.set_terminated(self.run_id, str(status))
