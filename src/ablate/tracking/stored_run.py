"""One run of a store. What it has is left as it is, so whatever failed on the way may be done again.

Of a task such as `precision`, what the store shows is on disk first, and the store has a copy.
"""

import json
import logging
import math
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from mlflow.entities import Dataset, DatasetInput, InputTag, LoggedModelOutput, Metric, Param, RunTag
from PIL import Image

from ablate.storage import digest, read_json, write_json
from ablate.tracking.local_log import Status, logged_images, points, read_log, within
from ablate.tracking.provenance import git_state, hardware
from ablate.tracking.store import Store, parent_run, reason

STATE = "digest_of_what_was_copied"  # a tag: the digest of what was on disk when all of it had been copied
_LOG = logging.getLogger(__name__)
_RECORD = "run.json"
_WAIT_S = 60.0
_BATCH = 500
# MLflow writes an image and then a smaller copy; an image with both files is complete.
_WHOLE_IMAGE = re.compile(r".+?\+step\+\d+\+(?=.*\+compressed\.webp$)")


class StoredRun:
    """Writes to one run. After an error, make another: it is then not known what has arrived."""

    def __init__(self, store: Store, run_id: str) -> None:
        self.store, self.run_id = store, run_id
        self._client = store.client
        self._read = 0  # bytes of the local log that have been copied

    def copy_log(self, folder: Path) -> None:
        """Copy what is new in the log of a run's folder: curves and images, each step once."""
        lines, end = read_log(folder, self._read)
        new = [point for point in points(lines) if (point.key, point.step) not in self._steps]
        for k in range(0, len(new), _BATCH):
            batch = new[k : k + _BATCH]
            self._client.log_batch(self.run_id, metrics=batch)
            self._steps.update((point.key, point.step) for point in batch)
        for key, step, path in logged_images(folder):
            self._copy_image(key, step, path)
        self._read = end

    def copy_newest(self, folder: Path) -> None:
        """Copy the last image of each series once more, as `newest/`: of a series MLflow shows the first."""
        for key, (step, path) in {key: (step, path) for key, step, path in logged_images(folder)}.items():
            self._copy_image(f"newest/{Path(key).name}", step, path)

    def _copy_image(self, key: str, step: int, path: Path) -> None:
        name = f"{key.replace('/', '~')}+step+{step}+"
        if name not in self._images:
            with Image.open(path) as image:
                self._client.log_image(self.run_id, np.asarray(image), key=key, step=step)
            self._images.add(name)

    def scores(
        self, values: Mapping[str, float], time_ms: int | None = None, model: str | None = None, whole: bool = False
    ) -> None:
        """Log one value for each name at step 0; NaN and infinite values are left out.

        A value that replaces another one is logged one step later, because MLflow keeps both. Where these values are
        the `whole` of `test/` and `val/`, others that MLflow has become NaN, as it cannot forget them.

        The same values of the same time are stored once, also where a server takes a call that was given up. With the
        id of a model they are that model's too, on the data set of the run.
        """
        run = self._client.get_run(self.run_id)
        known = run.data.metrics
        used = run.inputs.dataset_inputs if model else []
        finite = {k: float(v) for k, v in values.items() if abs(float(v)) < 1e300}
        scored = [k for k in known if whole and k.startswith(("test/", "val/")) and not k.endswith("_curve")]
        new = {k: v for k, v in finite.items() if known.get(k) != v}
        new |= {k: math.nan for k in scored if k not in finite and math.isfinite(known[k])}
        logged_ms = time_ms or int(time.time() * 1000)
        steps = {k: self._client.get_metric_history(self.run_id, k)[-1].step + 1 for k in new.keys() & known.keys()}
        model_and_data = (model, used[0].dataset.name, used[0].dataset.digest) if used else (model,)
        if new:
            logged = [Metric(k, v, logged_ms, steps.get(k, 0), *model_and_data) for k, v in new.items()]
            self._client.log_batch(self.run_id, metrics=logged)

    def model(self, name: str) -> str:
        """Id of the model that the run has made, for MLflow's page of models; it is created when there is none."""
        run = self._client.get_run(self.run_id)
        made = [output.model_id for output in run.outputs.model_outputs] if run.outputs else []
        if made:
            return str(made[0])
        valid = re.sub(r"[/:.%\"']", "-", name)
        model = self._client.create_logged_model(self.store.experiment_id, valid, self.run_id)
        self._client.finalize_logged_model(model.model_id, "READY")
        self._client.log_outputs(self.run_id, [LoggedModelOutput(model.model_id, 0)])
        return str(model.model_id)

    def parameters(self, values: Mapping[str, object]) -> None:
        """Log parameters; those that the run already has are left as they are."""
        known = self._client.get_run(self.run_id).data.params
        words = {True: "yes", False: "no"}
        new = [Param(k, words[v] if isinstance(v, bool) else str(v)) for k, v in values.items() if k not in known]
        if new:
            self._client.log_batch(self.run_id, params=new)

    def tags(self, values: Mapping[str, object]) -> None:
        self._client.log_batch(self.run_id, tags=[RunTag(k, str(v)) for k, v in values.items()])

    def describe(self, markdown: str) -> None:
        """Set the description on the run's first page."""
        self.tags({"mlflow.note.content": markdown})

    def artifacts(self) -> set[str]:
        """Names of the files that lie in no folder."""
        return {file.path for file in self._client.list_artifacts(self.run_id) if not file.is_dir}

    def artifact(self, path: Path, folder: str | None = None) -> None:
        self._client.log_artifact(self.run_id, str(path), folder)

    def dataset(
        self, name: str, digest: str, folder: Path, frames: int, read: Mapping[str, str], drawn: Mapping[str, str]
    ) -> None:
        """Log the data set that the run is trained on; logging it again changes nothing.

        `read` and `drawn` are the types of the maps that networks read and of the images that they are to render, each
        (frames, H, W), by name.
        """
        from mlflow.data.schema import TensorDatasetSchema  # its import takes a second
        from mlflow.types import Schema, TensorSpec

        def schema(maps: Mapping[str, str]) -> Schema:
            return Schema([TensorSpec(np.dtype(dtype), (-1, -1, -1), key) for key, dtype in maps.items()])

        source, profile = json.dumps({"uri": str(folder)}), json.dumps({"num_rows": frames})
        tensors = json.dumps(TensorDatasetSchema(schema(read), schema(drawn)).to_dict())
        made = Dataset(name, digest, "local", source, tensors, profile)
        self._client.log_inputs(self.run_id, [DatasetInput(made, [InputTag("mlflow.data.context", "training")])])

    def tag(self, name: str) -> str | None:
        """The value of a tag, None where the run has none."""
        return self._client.get_run(self.run_id).data.tags.get(name)

    def mark(self, status: Status, time_ms: int | None = None) -> None:
        """Open the run again, or close it; a run that is marked so already stays as it is."""
        if self._client.get_run(self.run_id).info.status == status:
            return
        if status is Status.running:
            self._client.update_run(self.run_id, status=str(status))
        else:
            self._client.set_terminated(self.run_id, str(status), time_ms)

    @cached_property
    def _steps(self) -> set[tuple[str, int]]:
        """Key and step of each value that the run has."""
        keys = self._client.get_run(self.run_id).data.metrics
        return {(key, point.step) for key in keys for point in self._client.get_metric_history(self.run_id, key)}

    @cached_property
    def _images(self) -> set[str]:
        there = self._client.list_artifacts(self.run_id, "images")
        return {match[0] for a in there if (match := _WHOLE_IMAGE.match(Path(a.path).name))}


@dataclass
class TaskRecord:
    """What the store shows of a task; it is read when the task has ended.

    `files` lie in the folder of the task and are its artifacts, PDFs in `vector`.
    """

    files: list[Path] = field(default_factory=list)
    tags: dict[str, str] = field(default_factory=dict)
    scores: dict[str, float] = field(default_factory=dict)
    description: str = ""
    status: Status = Status.finished


@contextmanager
def recorded_task(folder: Path, study: str, opened: Callable[[], Store]) -> Iterator[TaskRecord]:
    """Record a task, known by the name of its `folder`, that runs inside, and then copy the record to the store.

    A minute after the task has ended the store is waited for no longer; `copy_tasks` copies what it did not take.
    """
    folder.mkdir(parents=True, exist_ok=True)
    code = {name: value for name, value in git_state().items() if name != "git_diff"}
    record, status = TaskRecord(tags={"hardware": hardware(), **code}), Status.failed
    try:
        yield record
        status = record.status
    except KeyboardInterrupt:
        status = Status.killed
        raise
    finally:
        known = {"study": study, "status": status, "time": int(time.time() * 1000), "description": record.description}
        files = [path.name for path in record.files if path.exists()]
        write_json(folder / _RECORD, {**known, "files": files, "tags": record.tags, "scores": record.scores})
        try:
            within(_WAIT_S, lambda: _copy(folder, opened()))
        except Exception as error:  # whatever it is, the task has its result
            _LOG.warning("%s is not in MLflow yet (%s); task=compare copies it", folder.name, reason(error))


def copy_tasks(store: Store, runs: Path, study: str) -> None:
    """Copy the tasks of a study to a store that lacks them."""
    for path in sorted(runs.glob(f"*/{_RECORD}")):
        try:
            if read_json(path)["study"] == study:
                _copy(path.parent, store)
        except (ValueError, KeyError, TypeError) as error:
            _LOG.warning("%s: not copied to the tracking store (%s)", path, error)


def _copy(folder: Path, store: Store) -> None:
    """Copy the record of a task, with the files that it names, unless the store has it."""
    record: dict[str, Any] = read_json(folder / _RECORD)
    run = StoredRun(store, parent_run(store, record["study"], folder.name))
    if run.tag(STATE) == (state := digest(record)):
        return
    run.mark(Status.running)
    run.tags(record["tags"])
    for name in record["files"]:
        path = folder / Path(name).name  # a record may come from anybody
        run.artifact(path, "vector" if path.suffix == ".pdf" else None)
    run.scores(record["scores"], record["time"])
    run.describe(record["description"])
    run.mark(Status(record["status"]), record["time"])
    run.tags({STATE: state})
