"""Entry point of `python -m ablate` and of the console script `ablate`."""

import re
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from io import TextIOWrapper

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
    try:
        with _stopping_at_signals():
            code = execute(sys.argv[1:])
    except ConfigurationError as error:
        message = re.sub(r"://[^\s@]*@", "://...@", str(error))  # no password on the screen
        print(f"ablate: {message}", file=sys.stderr)
        sys.exit(2)
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
