"""Stop between two steps when asked to (SIGTERM, Ctrl-C, SIGHUP, SIGUSR2), so that what is saved is a whole step."""

import signal
import threading
from typing import Any

from lightning.pytorch import Callback

# SIGHUP: the terminal is closed; SIGUSR2: submitit's notice that a job's time is up. Windows has neither.
_NAMES = ("SIGTERM", "SIGINT", "SIGHUP", "SIGUSR2")
_SIGNALS = tuple(getattr(signal, name) for name in _NAMES if hasattr(signal, name))


class Interruption(Callback):
    """Remember the first signal in `signal`; the step then ends, and `LastCheckpoint` stops the training.

    A second Ctrl-C stops at once. A signal that the process is told to ignore, as by `nohup`, stays ignored.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        found = {number: signal.getsignal(number) for number in _SIGNALS}
        self._previous = {k: handler for k, handler in found.items() if handler is not signal.SIG_IGN}
        self._in_main_thread = threading.current_thread() is threading.main_thread()

    def on_train_start(self, *_: Any) -> None:
        """Take over the signals, from Lightning's handlers too; only a main thread can."""
        if self._in_main_thread:
            for number in self._previous:
                signal.signal(number, self._receive)

    def restore(self) -> None:
        """Restore the signal handlers that were set when this was made."""
        if self._in_main_thread:
            for number, handler in self._previous.items():
                signal.signal(number, handler)

    def _receive(self, number: int, _: Any) -> None:
        if self.signal == signal.SIGINT == number:
            raise KeyboardInterrupt
        self.signal = self.signal or number
