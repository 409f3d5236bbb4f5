"""Runs of tasks such as `precision`: what the store shows of them is on disk first, and the store has a copy."""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ablate.storage import digest, read_json, write_json
from ablate.tracking.background import Background
from ablate.tracking.local_log import Status
from ablate.tracking.store import Store, task_run
from ablate.tracking.stored_run import STATE, StoredRun

_LOG = logging.getLogger(__name__)
_RECORD = "run.json"
_WAIT_S = 60.0


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
    """Record a task, known by the name of its `folder`, while it runs inside, and copy the record to the store.

    The store is opened and written to in a thread, before the task and after it, since tasks measure times. A minute
    after the task has ended the store is waited for no longer; `copy_tasks` copies what it did not take.
    """
    folder.mkdir(parents=True, exist_ok=True)
    record = TaskRecord()

    def write(status: Status) -> None:
        known = {"study": study, "status": status, "time": int(time.time() * 1000), "description": record.description}
        files = [path.name for path in record.files if path.exists()]
        write_json(folder / _RECORD, {**known, "files": files, "tags": record.tags, "scores": record.scores})

    write(Status.running)
    background = Background(lambda: _copy(folder, opened()), every_s=threading.TIMEOUT_MAX)
    background.tried.wait(5.0)
    status = Status.failed
    try:
        yield record
        status = record.status
    except KeyboardInterrupt:
        status = Status.killed
        raise
    finally:
        write(status)
        if not background.close(lambda: _copy(folder, opened()), _WAIT_S):
            _LOG.warning("not all of %s is in MLflow yet; task=compare copies the rest", folder.name)


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
    run = StoredRun(store, task_run(store, folder.name, record["study"]))
    if run.tag(STATE) == (state := digest(record)):
        return
    run.mark(Status.running)
    run.tags(record["tags"])
    if record["status"] != Status.running:
        for name in record["files"]:
            path = folder / Path(name).name  # a record may come from anybody
            run.artifact(path, "vector" if path.suffix == ".pdf" else None)
        run.scores(record["scores"], record["time"])
        run.describe(record["description"])
        run.mark(Status(record["status"]), record["time"])
    run.tags({STATE: state})
