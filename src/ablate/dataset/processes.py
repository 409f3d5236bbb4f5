"""Worker processes: as many as there are cores for, and none that outlives whoever started it."""

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

_EVERY_S = 1.0


def allotted_cores() -> int:
    """Cores that this process may use: on a cluster those of its job, which are fewer than the machine's."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def end_with_parent() -> None:
    """In a worker process, send oneself SIGTERM once the parent is gone; elsewhere, nothing.

    A parent that is killed outright cannot end its workers, and those of joblib would go on for minutes. SIGTERM
    rather than a hard end: training writes a checkpoint first.
    """
    if multiprocessing.current_process().name == "MainProcess":
        return
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_EVERY_S)
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Hold back SIGINT; processes that are started meanwhile never see it."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
