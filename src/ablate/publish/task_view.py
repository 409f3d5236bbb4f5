"""MLflow's run of a task such as `precision`: the files of its folder, and what the task says of them."""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from filelock import FileLock
from mlflow.entities import Metric

from ablate.publish.results_view import NOTE
from ablate.publish.store import Store, open_store, plain_files, reason
from ablate.publish.training_view import PUBLISHED
from ablate.publish.waiting import in_time
from ablate.settings.study import StudySettings, Task
from ablate.storage import digest, read_json, write_json
from ablate.study.log import Status
from ablate.study.provenance import git_state, hardware

_LOG = logging.getLogger(__name__)
_RECORD = "task.json"
_TASKS = (Task.precision, Task.stability)  # their names are those of their folders
_SHOWN = (".csv", ".txt", ".md", ".png", ".pdf")  # what is published of a folder
_LOCK_S, _WAIT_S = 60.0, 60.0


@dataclass
class TaskView:
    """What the store shows of a task beside its files; it is read when the task has ended."""

    scores: dict[str, float] = field(default_factory=dict)
    description: str = ""
    status: Status = Status.finished


@contextmanager
def published_task(settings: StudySettings, folder: Path) -> Iterator[TaskView]:
    """Publish a task, known by the name of its `folder`, that runs inside, when it has ended.

    A minute later the store is waited for no longer; `task=compare` publishes what it did not take.
    """
    folder.mkdir(parents=True, exist_ok=True)
    view = TaskView()
    try:
        yield view
    except BaseException as error:
        view.status = Status.killed if isinstance(error, KeyboardInterrupt) else Status.failed
        raise
    finally:
        code = {name: value for name, value in git_state().items() if name != "git_diff"}
        record = {
            "study": settings.study,
            "tags": {"hardware": hardware(), "scene": settings.scene_name, **code},
            "time": int(time.time() * 1000),
            **asdict(view),
        }
        write_json(folder / _RECORD, record)
        try:
            in_time(_WAIT_S, lambda: _publish(open_store(settings), folder))
        except Exception as error:  # whatever it is, the task has its result
            _LOG.warning("%s is not in MLflow yet (%s); task=compare publishes it", folder.name, reason(error))


def publish_tasks(store: Store, settings: StudySettings) -> None:
    """Publish the tasks of a study that the store lacks."""
    for task in _TASKS:
        folder = settings.results / task
        record = folder / _RECORD
        if record.exists():
            try:
                if read_json(record)["study"] == settings.study:
                    _publish(store, folder)
            except (ValueError, KeyError, TypeError, AttributeError) as error:  # it is damaged
                _LOG.warning("%s: not published (%s)", record, error)


def _publish(store: Store, folder: Path) -> None:
    record: dict[str, Any] = read_json(folder / _RECORD)
    kind, known_by = folder.name, {"study": str(record["study"])}
    ended_ms, status = int(record["time"]), Status(record["status"])
    tags = {NOTE: str(record["description"])} | {name: str(value) for name, value in record["tags"].items()}
    metrics = [Metric(name, float(value), ended_ms, 0) for name, value in record["scores"].items()]
    state = digest(record)
    with FileLock(store.lock, timeout=_LOCK_S):
        run = store.find(kind, known_by)
        if run is not None and run.data.tags.get(PUBLISHED) == state:
            return
        if run is not None:
            store.discard(run)
        run_id = store.create(kind, kind, known_by | tags, ended_ms).info.run_id
        store.log_files(run_id, [path for path in plain_files(folder.iterdir()) if path.suffix in _SHOWN])
        store.log_metrics(run_id, metrics)
        store.client.set_terminated(run_id, str(status), ended_ms)
        store.client.set_tag(run_id, PUBLISHED, state)
