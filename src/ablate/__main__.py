"""Entry point of `python -m ablate` and of the console script `ablate`."""

import _thread
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from ablate.dataset.processes import end_process
from ablate.settings.study import ConfigurationError
from ablate.tasks.entry import execute


class _Stopped(KeyboardInterrupt):
    """A signal that asks the process to end; it is treated as Ctrl-C is."""

    def __init__(self, number: int) -> None:
        super().__init__(f"stopped by {signal.Signals(number).name}")
        self.number = number


def main() -> None:
    """Compose and check the command line, then run its task. Bad input gives one line on stderr and exit code 2."""
    for stream in (sys.stdout, sys.stderr):  # a locale may know no ± and no χ²
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    try:
        here = str(Path.cwd())
    except FileNotFoundError:
        sys.exit("ablate: the current folder was removed; type cd and a folder that exists, then the command again")
    if not sys.flags.safe_path and here not in sys.path:
        sys.path.insert(0, here)  # of `python -m ablate` it is the first; so a module of the user's is found by both
    try:
        with _stopping_at_signals():
            code = execute(sys.argv[1:])
            sys.stdout.flush()
    except ConfigurationError as error:
        message = re.sub(r"://[^\s@]*@", "://...@", str(error))  # no password on the screen
        print(f"ablate: {message}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # whoever read the output, such as `head`, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python writes as it ends
        sys.exit(128 + 13)
    except OSError as error:  # such as a full disk; what the system did not raise has no number
        if error.errno is None:
            raise
        sys.exit(_told(error))
    except MemoryError as error:
        sys.exit(_told(error, f"out of memory: {error or 'no size was given'}"))
    except _Stopped as stopped:
        print(_told(stopped), file=sys.stderr)
        sys.exit(128 + stopped.number)
    except KeyboardInterrupt as error:
        sys.exit(_told(error, "interrupted"))
    sys.exit(code)


def _told(error: BaseException, what: str = "") -> str:
    """What stopped the program, and what a task has noted of going on."""
    return "; ".join([f"ablate: {what or error}", *getattr(error, "__notes__", ())])


@contextmanager
def _stopping_at_signals() -> Iterator[None]:
    """Raise `_Stopped` at SIGTERM, and at SIGHUP, which closes a terminal; a signal that is ignored stays ignored."""

    def stop(number: int, _: object) -> None:
        raise _Stopped(number)

    def dropped(what: Any) -> None:
        """Send the signal again where Python ran `__del__` or the callback of a weak reference, and raised nothing."""
        if not isinstance(what.exc_value, KeyboardInterrupt):
            return before(what)
        number = getattr(what.exc_value, "number", signal.SIGINT)
        return threading.Timer(0.05, _thread.interrupt_main, [number]).start()

    known = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows has one
    watched = [number for number in known if signal.getsignal(number) is signal.SIG_DFL]
    before, sys.unraisablehook = sys.unraisablehook, dropped
    for number in watched:
        signal.signal(number, stop)
    try:
        yield
    finally:
        sys.unraisablehook = before
        for number in watched:
            signal.signal(number, signal.SIG_DFL)


def start() -> None:
    """`main` as a process of its own, which ends with it."""
    try:
        main()
    except SystemExit as end:
        end_process(end.code)


if __name__ == "__main__":
    start()
