"""Stop between two steps when asked to (SIGTERM, Ctrl-C, SIGUSR2), so that what is saved is a whole step."""

import signal
import threading
from typing import Any

from lightning.pytorch import Callback, Trainer

_SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGUSR2)  # SIGUSR2: submitit's notice that a job's time is up


class Interruption(Callback):
    """Remember the first signal in `signal` and let the step end; a second Ctrl-C stops at once."""

    def __init__(self) -> None:
        self.signal: int | None = None
        self._previous = {number: signal.getsignal(number) for number in _SIGNALS}
        self._in_main_thread = threading.current_thread() is threading.main_thread()

    def on_train_start(self, *_: Any) -> None:
        """Take over the signals, from Lightning's handlers too; only a main thread can."""
        if self._in_main_thread:
            for number in _SIGNALS:
                signal.signal(number, self._receive)

    def on_train_batch_end(self, trainer: Trainer, *_: Any) -> None:
        """End the training if a signal has come."""
        if self.signal is not None:
            trainer.should_stop = True

    def restore(self) -> None:
        """Restore the signal handlers that were set when this was made."""
        if self._in_main_thread:
            for number, handler in self._previous.items():
                signal.signal(number, handler)

    def _receive(self, number: int, _: Any) -> None:
        if self.signal is not None and number == signal.SIGINT:
            raise KeyboardInterrupt
        self.signal = number
