"""MLflow runs: one parent a study, one child a job, found again rather than made twice."""

from __future__ import annotations

import json
import logging
import os
import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

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


# MLflow writes an image, then its small copy; only with both is it whole.
_WHOLE_IMAGE = re.compile(r".+?\+step\+\d+\+(?=.*\+compressed\.webp$)")


class Status(StrEnum):
    """How a run ended, in MLflow's words."""

    finished = "FINISHED"
    failed = "FAILED"
    killed = "KILLED"


@dataclass(frozen=True)
class Store:
    """An open tracking store.

    Attributes
    ----------
    uri : str
    experiment_id : str
    lock : Path
        Taken around whatever looks a run up and then makes it.
    """

    uri: str
    experiment_id: str
    lock: Path

    @property
    def client(self) -> MlflowClient:
        return MlflowClient(self.uri)


def default_uri(runs: Path) -> str:
    """SQLite file in the folder that holds everything produced."""
    return f"sqlite:///{runs / 'mlflow.db'}"


def open_store(runs: Path, uri: str | None, experiment: str) -> Store:
    """Create database and experiment where they are missing.

    Safe for several processes: concurrent first use of a fresh SQLite store fails otherwise. Artifacts go to
    `runs/artifacts` for the default store; a server given by `uri` decides for itself.

    Parameters
    ----------
    runs : Path
    uri : str or None
    experiment : str

    Returns
    -------
    Store
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
    """Id of the study's parent run, made when there is none."""
    return _run(store, f"tags.study = '{study}' and tags.kind = 'study'", study, {"study": study, "kind": "study"})


def task_run(store: Store, task: str, study: str) -> str:
    """Id of the run of a task that looks at a study from outside; made when there is none, named as the task."""
    tags = {"study": study, "kind": task}
    return _run(store, f"tags.study = '{study}' and tags.kind = '{task}'", task, tags)


def child_run(store: Store, parent: str, name: str, config_hash: str, tags: Mapping[str, str]) -> str:
    """Id of the job's run under `parent`; the one that a killed job left behind is taken up again."""
    wanted = {**tags, "kind": "job", "config_hash": config_hash, _PARENT_TAG: parent}
    query = (
        f"attributes.run_name = '{name}' and tags.config_hash = '{config_hash}' and tags.`{_PARENT_TAG}` = '{parent}'"
    )
    return _run(store, query, name, wanted)


def _run(store: Store, query: str, name: str, tags: Mapping[str, str]) -> str:
    with FileLock(store.lock):
        client = store.client
        found = client.search_runs([store.experiment_id], query, run_view_type=ViewType.ACTIVE_ONLY, max_results=1)
        if found:
            run_id = str(found[0].info.run_id)
            client.update_run(run_id, status="RUNNING")
            return run_id
        made = client.create_run(store.experiment_id, tags=dict(tags), run_name=name)
        return str(made.info.run_id)


class RunLog:
    """Writes to one run, metrics in batches: a call costs a SQLite transaction whatever it holds.

    Parameters
    ----------
    store : Store
    run_id : str
    """

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
        """Parameters of the run; those that it already has are left as they are."""
        known = self._client.get_run(self.run_id).data.params
        new = [Param(k, str(v)) for k, v in values.items() if k not in known]
        if new:
            self._client.log_batch(self.run_id, params=new)

    def tags(self, values: Mapping[str, object]) -> None:
        self._client.log_batch(self.run_id, tags=[RunTag(k, str(v)) for k, v in values.items()])

    def describe(self, markdown: str) -> None:
        """The text on the run's first page."""
        self.tags({"mlflow.note.content": markdown})

    def artifact(self, path: Path, folder: str | None = None) -> None:
        self._client.log_artifact(self.run_id, str(path), folder)

    def image(self, key: str, image: np.ndarray, step: int) -> None:
        """An image of a series: MLflow shows those of one key with a slider over steps.

        One that the run has of this key and step is left: a job that goes on at its last checkpoint makes some again.

        Parameters
        ----------
        key : str
            Letters, digits, spaces and `_-./`.
        image : (h, w) uint8
        step : int
        """
        if self._images is None:
            there = self._client.list_artifacts(self.run_id, "images")
            self._images = {m[0] for a in there if (m := _WHOLE_IMAGE.match(Path(a.path).name))}
        name = f"{key.replace('/', '~')}+step+{step}+"
        if name not in self._images:
            self._client.log_image(self.run_id, image, key=key, step=step)
            self._images.add(name)

    def dataset(self, name: str, digest: str, folder: Path, frames: int) -> None:
        """The data set that the run learns from; the run has it once, however often this is called."""
        made = Dataset(name, digest, "local", str(folder), profile=json.dumps({"num_rows": frames}))
        self._client.log_inputs(self.run_id, [DatasetInput(made)])

    def end(self, status: Status) -> None:
        """Send what is waiting and close the run."""
        self.flush()
        self._client.set_terminated(self.run_id, str(status))
