"""Work in a thread of its own, so that a store that does not answer holds nothing up."""

import logging
import threading
from collections.abc import Callable
from functools import cache

from ablate.tracking.store import reason

_LOG = logging.getLogger(__name__)
_EVERY_S = 5.0
_WAIT_S = 5.0


class Background:
    """Calls `work` now and every few seconds. What it raises is logged once and not raised: it is tried again."""

    def __init__(self, work: Callable[[], object]) -> None:
        self._work = work
        self._last: Callable[[], object] | None = None
        self._closed = threading.Event()
        self._failing = False
        self._thread = threading.Thread(target=self._run, name="tracking", daemon=True)
        self._thread.start()

    def close(self, last: Callable[[], object] | None = None) -> bool:
        """Let the work end and do `last`; True if it has been done within five seconds.

        Otherwise the thread goes on for as long as the process does.
        """
        self._last = last
        self._closed.set()
        self._thread.join(_WAIT_S)
        return not self._thread.is_alive() and not self._failing

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


@cache
def _say(message: str) -> None:
    """Log a message that this process has not logged before: each job of a sweep would repeat it."""
    _LOG.warning("%s", message)
