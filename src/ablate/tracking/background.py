"""Work in a thread of its own: a store that does not answer holds nothing up, and a busy machine is watched."""

import logging
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from ablate.tracking.local_log import LocalLog, points, read_log
from ablate.tracking.store import reason

T = TypeVar("T")
_LOG = logging.getLogger(__name__)
_EVERY_S = 5.0
_WAIT_S = 5.0
_SAMPLED_EVERY_S = 10.0  # as MLflow itself does
_GROUP = "system/"  # MLflow shows these on a page of their own


class Background:
    """Calls `work` now and every few seconds. What it raises is logged once and not raised: it is tried again."""

    def __init__(self, work: Callable[[], object], every_s: float = _EVERY_S) -> None:
        self._work, self._every_s = work, every_s
        self._last: Callable[[], object] | None = None
        self._closed, self.tried = threading.Event(), threading.Event()
        self._failing = False
        self._thread = threading.Thread(target=self._run, name="tracking", daemon=True)
        self._thread.start()

    def close(self, last: Callable[[], object] | None = None, wait_s: float = _WAIT_S) -> bool:
        """Let the work end and do `last`; True if it has been done within five seconds, or within `wait_s`.

        Otherwise the thread goes on for as long as the process does.
        """
        self._last = last
        self._closed.set()
        self._thread.join(wait_s)
        return not self._thread.is_alive() and not self._failing

    def _run(self) -> None:
        while True:
            self._try(self._work)
            self.tried.set()
            if self._closed.wait(self._every_s):
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
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    threading.Thread(target=run, name="tracking", daemon=True).start()
    try:
        return outcome.result(seconds)
    except TimeoutError as error:
        raise error if outcome.done() else TimeoutError(f"no end after {seconds:g} s") from None


@cache
def _say(message: str) -> None:
    """Log a message that this process has not logged before: each job of a sweep would repeat it."""
    _LOG.warning("%s", message)


@contextmanager
def system_metrics(folder: Path, log: LocalLog, every_s: float = _SAMPLED_EVERY_S) -> Iterator[None]:
    """Log how busy the machine is to the log of a run, in `folder`, for as long as the body runs.

    The step counts samples. A resumed run goes on counting.
    """
    lines, _ = read_log(folder)
    taken = max((point.step for point in points(lines) if point.key.startswith(_GROUP)), default=-1) + 1
    from mlflow.system_metrics.metrics import cpu_monitor, disk_monitor, gpu_monitor, network_monitor

    monitors: list[Any] = [cpu_monitor.CPUMonitor(), disk_monitor.DiskMonitor(), network_monitor.NetworkMonitor()]
    with suppress(ImportError, RuntimeError):  # no NVIDIA GPU, or not its package
        monitors.append(gpu_monitor.GPUMonitor())

    def sample() -> None:
        nonlocal taken
        values: dict[str, float] = {}
        for monitor in monitors:
            monitor.collect_metrics()
            values |= monitor.aggregate_metrics()
            monitor.clear_metrics()
        log.metrics({f"{_GROUP}{name}": value for name, value in values.items()}, taken)
        taken += 1

    background = Background(sample, every_s)
    try:
        yield
    finally:
        background.close()
