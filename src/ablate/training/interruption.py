"""Stop between two steps when asked to (SIGTERM, Ctrl-C, SIGHUP, SIGUSR2), so that what is saved is a whole step."""

import signal
import threading
from typing import Any

# SIGHUP: the terminal is closed; SIGUSR2: submitit's notice that a job's time is up. Windows has neither.
_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGUSR2") if hasattr(signal, name)]

#: Set by a signal handler of the process that cannot be sure of its exception: Python drops what a handler raises while
#: it runs the callback of a weak reference. A training that sees it after a step stops as after SIGTERM.
stop_requested = threading.Event()


class Interruption:
    """Remember the first signal in `signal`; the step then ends, and `LastCheckpoint` stops the training.

    A second Ctrl-C stops at once. A signal that the process is told to ignore, as by `nohup`, stays ignored.
    """

    def __init__(self) -> None:
        self.signal: int | None = None
        in_main_thread = threading.current_thread() is threading.main_thread()
        handlers = {number: signal.getsignal(number) for number in _SIGNALS if in_main_thread}
        self._previous = {number: handler for number, handler in handlers.items() if handler is not signal.SIG_IGN}

    def take_over(self) -> None:
        """Receive the signals from now on, in place of Lightning's handlers too; only a main thread can."""
        for number in self._previous:
            signal.signal(number, self._receive)

    def restore(self) -> None:
        """Restore the signal handlers that were set when this was made."""
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    @property
    def is_asked_for(self) -> bool:
        """Whether the training is to stop: a signal came, or `stop_requested` is set, which counts as SIGTERM."""
        if self.signal is None and stop_requested.is_set():
            self.signal = signal.SIGTERM
        return self.signal is not None

    def _receive(self, number: int, _: Any) -> None:
        if self.signal == signal.SIGINT == number:
            raise KeyboardInterrupt
        self.signal = self.signal or number
