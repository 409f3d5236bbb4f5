"""Work beside the program, for which it waits only so long, and which may fail."""

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from ablate.dataset.processes import start_beside
from ablate.publish.store import reason

_LOG = logging.getLogger(__name__)
_SAID = threading.Event()
T = TypeVar("T")


def in_time(seconds: float, work: Callable[[], T]) -> T:
    """What `work` returns or raises; a TimeoutError where it takes longer, and then it goes on in its thread.

    That does no harm to what is published: a run counts as whole when its last tag is there.
    """
    outcome: Future[T] = Future()

    def run() -> None:
        try:
            outcome.set_result(work())
        except BaseException as error:
            outcome.set_exception(error)

    start_beside(run)
    try:
        return outcome.result(seconds)
    except TimeoutError as error:
        raise error if outcome.done() else TimeoutError(f"no end after {seconds:g} s") from None


def tried(work: Callable[[], object]) -> None:
    """Do work of publishing; whatever it raises is told, and the program goes on."""
    try:
        work()
    except Exception as error:
        say(error)


def say(error: Exception) -> None:
    """Say once a process why something is not published: each job of a sweep would repeat it."""
    level = logging.DEBUG if _SAID.is_set() else logging.WARNING
    _SAID.set()
    _LOG.log(level, "not published to MLflow for now, work goes on (%s)", reason(error))
