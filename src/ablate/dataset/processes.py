"""Worker processes that do not outlive whoever started them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time

_EVERY_S = 1.0


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
