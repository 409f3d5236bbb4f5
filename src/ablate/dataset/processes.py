"""Worker processes: as many as there are cores for, and none that outlives whoever started it; signals; the end."""

import atexit
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

# SIGHUP: the terminal is closed; SIGUSR2: submitit's notice that a job's time is up. Windows has neither.
_SIGNALS = [getattr(signal, name) for name in ("SIGTERM", "SIGINT", "SIGHUP", "SIGUSR2") if hasattr(signal, name)]
_BESIDE = "beside the program"  # the name of threads that the end of a process does not wait for


def allotted_cores() -> int:
    """Cores that this process may use: of its job on a cluster, or of its container, not of the machine."""
    from joblib import cpu_count  # here: most commands start no processes

    cores: int = cpu_count()
    return cores


def end_with_parent() -> None:
    """In a worker process, send oneself SIGTERM once the parent is gone; elsewhere, nothing.

    A parent that is killed outright cannot end its workers, and may be gone before a worker has asked. SIGTERM rather
    than a hard end: training writes a checkpoint first.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        parent.join()  # a pipe that the system closes when the parent ends, also before this
        os.kill(os.getpid(), signal.SIGTERM)

    threading.Thread(target=watch, daemon=True).start()


def start_beside(work: Callable[[], object]) -> threading.Thread:
    """Start a thread for work that the process does not wait for; a process that may leave it ends by `end_process`."""
    thread = threading.Thread(target=work, name=_BESIDE, daemon=True)
    thread.start()
    return thread


def end_process(code: object) -> NoReturn:
    """End this process as `sys.exit(code)` does, and at once where a thread of `start_beside` is still at work.

    An interpreter that ends stops such a thread wherever it is: inside of torch this aborts the process, inside of
    Arrow it hangs.
    """
    if not any(thread.name == _BESIDE for thread in threading.enumerate()):
        sys.exit(code)  # type: ignore[arg-type]
    if isinstance(code, str):
        sys.stderr.write(f"{code}\n")
    atexit._run_exitfuncs()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code if isinstance(code, int) else int(code is not None))


def work_for_parent(content: bytes) -> None:
    """In a worker process, call what is pickled in `content`: a function and its arguments.

    The parent is watched before anything is imported for them, which may take longer than the parent lives.
    """
    end_with_parent()
    try:
        function, arguments = pickle.loads(content)
        function(*arguments)
    except KeyboardInterrupt:
        end_process(128 + signal.SIGINT)
    except SystemExit as end:
        end_process(end.code)
    end_process(None)


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Hold back SIGINT; processes that are started meanwhile never see it. Windows cannot, and they do see it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Interruption:
    """Remember the first signal (SIGTERM, Ctrl-C, SIGHUP, SIGUSR2) in `signal`, so that what is saved is a whole step.

    The step then ends, and `LastCheckpoint` stops the training. A second Ctrl-C stops at once. A signal that the
    process is told to ignore, as by `nohup`, stays ignored.
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

    def _receive(self, number: int, _: Any) -> None:
        if self.signal == signal.SIGINT == number:
            raise KeyboardInterrupt
        self.signal = self.signal or number
