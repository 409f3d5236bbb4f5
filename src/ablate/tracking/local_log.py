"""What a training logs, in the folder of its run: metrics as lines of JSON, images as PNG. The store has a copy.

The copy is made in a thread of its own: a store that is silent holds nothing up.
"""

import _thread
import json
import logging
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import Future, wait
from contextlib import suppress
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from mlflow.entities import Metric

from ablate.storage import write_image
from ablate.tracking.store import reason

T = TypeVar("T")
_FILE = "log.jsonl"
_LOG = logging.getLogger(__name__)
_EVERY_S = 5.0
_WAIT_S = 5.0


class Status(StrEnum):
    """The state of a run, in MLflow's words."""

    running = "RUNNING"
    finished = "FINISHED"
    failed = "FAILED"
    killed = "KILLED"


class LocalLog:
    """Writes the log of one run, for the process that trains it; see `read_log` and `logged_images`.

    A step that a resumed training does again is not logged again.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / _FILE
        self.path.touch()
        lines, whole = read_log(folder)
        with self.path.open("r+b") as file:
            file.truncate(whole)  # of a line that a killed process began
        self._known = {(point.key, point.step) for point in points(lines)}

    def metrics(self, values: Mapping[str, float], step: int) -> None:
        """Log the values of one step; NaN and infinite values are left out, which MLflow cannot show."""
        new = {key: v for key, v in values.items() if abs(v) < 1e300 and (key, step) not in self._known}
        self._known |= {(key, step) for key in new}
        if new:
            self._append({"step": step, "metrics": new})

    def image(self, key: str, image: np.ndarray, step: int) -> None:
        """Log an (h, w) uint8 image of a series. A key has letters, digits, spaces and `_-./`."""
        path = self.path.parent / "images" / f"{key.replace('/', '~')}+{step}.png"
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            write_image(path, image)

    def status(self, status: Status) -> None:
        """Log that the run has started or ended."""
        self._append({"status": str(status)})

    def _append(self, content: Mapping[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": int(time.time() * 1000), **content}) + "\n")


def read_log(folder: Path, start: int = 0) -> tuple[list[dict[str, Any]], int]:
    """The whole lines of a run's log from a byte on, and the byte after them; none where there is no log."""
    if not (folder / _FILE).exists():
        return [], 0
    with (folder / _FILE).open("rb") as file:
        file.seek(start)
        text, newline, _ = file.read().rpartition(b"\n")
    lines = []
    for line in text.splitlines():
        with suppress(ValueError):  # a power cut may leave zeros
            lines.append(json.loads(line))
    return [line for line in lines if isinstance(line, dict)], start + len(text) + len(newline)


def points(lines: list[dict[str, Any]]) -> list[Metric]:
    """The values in lines of a log."""
    steps = [line for line in lines if "metrics" in line]
    return [Metric(key, value, line["time"], line["step"]) for line in steps for key, value in line["metrics"].items()]


def logged_images(folder: Path) -> list[tuple[str, int, Path]]:
    """Key, step and file of each image in a run's log."""
    files = [path for path in (folder / "images").glob("*+*.png") if ".partial" not in path.name]
    split = [(path.stem.rpartition("+"), path) for path in files]
    return sorted((key.replace("~", "/"), int(step), path) for (key, _, step), path in split if step.isdigit())


class Background:
    """Calls `work` now and every few seconds. What it raises is logged once and not raised: it is tried again."""

    def __init__(self, work: Callable[[], object]) -> None:
        self._work = work
        self._last: Callable[[], object] | None = None
        self._closed = threading.Event()
        self._failing = False
        self._ended = _in_thread(self._run)

    def close(self, last: Callable[[], object] | None = None) -> bool:
        """Let the work end and do `last`; True if that is done within five seconds, else it goes on in its thread."""
        self._last = last
        self._closed.set()
        return bool(wait([self._ended], _WAIT_S).done) and not self._failing

    def _run(self) -> None:
        while True:
            self._try(self._work)
            if self._closed.wait(_EVERY_S):
                break
        if self._last is not None:
            self._try(self._last)

    def _try(self, work: Callable[[], object]) -> None:
        try:
            work()
        except Exception as error:  # the thread would end in silence
            if not self._failing:
                _say(f"not tracked for now, work goes on ({reason(error)})")
            self._failing = True
        else:
            self._failing = False


def within(seconds: float, work: Callable[[], T]) -> T:
    """What `work` returns or raises; a TimeoutError where it takes longer, and then it goes on in its thread."""
    outcome = _in_thread(work)
    try:
        return outcome.result(seconds)
    except TimeoutError as error:
        raise error if outcome.done() else TimeoutError(f"no end after {seconds:g} s") from None


def _in_thread(work: Callable[[], T]) -> "Future[T]":
    """Begin work beside the program, which does not wait for it when it ends."""
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    try:
        _thread.start_new_thread(run, ())  # `Thread.start` may wait for ever where there is no memory: CPython 140746
    except RuntimeError as error:  # the system has no memory for a thread, or allows no more of them
        raise MemoryError(str(error)) from None
    return outcome


@cache
def _say(message: str) -> None:
    """Log a message that this process has not logged before: each job of a sweep would repeat it."""
    _LOG.warning("%s", message)
