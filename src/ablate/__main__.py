"""Entry point of `python -m ablate` and of the console script `ablate`."""

import os
import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path

from ablate.dataset.processes import stop_requested
from ablate.settings.study import ConfigurationError
from ablate.tasks.command import execute


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
    if not sys.flags.safe_path and (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)  # of `python -m ablate` it is the first; so a module of the user's is found by both
    try:
        with _stopping_at_signals():
            code = execute(sys.argv[1:])
        sys.stdout.flush()
    except ConfigurationError as error:
        message = re.sub(r"://[^\s@]*@", "://...@", str(error))  # no password on the screen
        print(f"ablate: {message}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # such as `| head`, which has read enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is written when Python ends
        sys.exit(1)
    except OSError as error:  # such as a full disk; what the system did not raise has no number
        if error.errno is None:
            raise
        sys.exit(f"ablate: {error}; the same command continues where it stopped")
    except MemoryError as error:
        sys.exit(f"ablate: out of memory: {error or 'no size was given'}; the same command continues where it stopped")
    except _Stopped as stopped:
        print(f"ablate: {stopped}; the same command continues where it stopped", file=sys.stderr)
        sys.exit(128 + stopped.number)
    except KeyboardInterrupt:
        sys.exit("ablate: interrupted; the same command continues where it stopped")
    sys.exit(code)


@contextmanager
def _stopping_at_signals() -> Iterator[None]:
    """Raise `_Stopped` at SIGTERM, and at SIGHUP, which closes a terminal; a signal that is ignored stays ignored."""

    def stop(number: int, _: object) -> None:
        stop_requested.set()  # Python drops what is raised here while it runs the callback of a weak reference
        raise _Stopped(number)

    there = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]  # Windows has one
    watched = [number for number in there if signal.getsignal(number) is signal.SIG_DFL]
    for number in watched:
        signal.signal(number, stop)
    try:
        yield
    finally:
        stop_requested.clear()
        for number in watched:
            signal.signal(number, signal.SIG_DFL)


if __name__ == "__main__":
    main()
