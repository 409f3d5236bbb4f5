"""Processes of the campaign: command lines and functions, each in a session of its own that can be killed whole."""

import ctypes
import faulthandler
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

# Loaded once by the process that warm commands are forked from.
_LOADED = [
    "ablate.__main__",
    "ablate.tasks",
    "ablate.runs.train",
    "ablate.comparison.compare",
    "ablate.runs.simulated",
    "ablate.tracking.store",
    "ablate.tracking.stored_run",
]
_HUNG_S = 1200.0  # beside other work a command of 20 s may take minutes


class Start(StrEnum):
    """How a command starts: with a new interpreter, or as a fork of a process that has imported all it needs."""

    cold = "cold"
    warm = "warm"


@dataclass(frozen=True)
class Ended:
    """The exit code of a process, negative for a signal, and what it and its workers printed."""

    code: int
    said: str


class Command:
    """A process that leads a session of its own."""

    def __init__(self, process: multiprocessing.process.BaseProcess, said: Path) -> None:
        self._process, self._said = process, said
        self.pid = int(process.pid or 0)

    def wait(self, seconds: float = _HUNG_S) -> Ended:
        """Wait for the end. What takes longer is killed, and its output says so and where each thread waited."""
        self._process.join(seconds)
        if self._process.exitcode is None:
            self.signal(signal.SIGABRT)
            self._process.join(10.0)
            self.signal(signal.SIGKILL)
            self._process.join()
            said = f"{self.said}\nhung: it did not end within {seconds:.0f} s"
            print(said, flush=True)
            return Ended(-signal.SIGKILL, said)
        return Ended(self._process.exitcode, self.said)

    @property
    def said(self) -> str:
        """What the session has printed by now."""
        return self._said.read_text("utf-8", "replace") if self._said.exists() else ""

    @property
    def is_alive(self) -> bool:
        return self._process.is_alive()

    def signal(self, number: int) -> None:
        """Send a signal to every process of the session that has no group of its own; none may be left."""
        with suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def members(self) -> list[int]:
        """The living processes of the session."""
        return [pid for pid in _processes() if _stat(pid)[3:4] == [str(self.pid)] and _stat(pid)[0] != "Z"]

    def wait_until(self, condition: Callable[[], object]) -> bool:
        """Wait until a condition holds; False where the process ends before, or takes too long."""
        until = time.monotonic() + _HUNG_S
        while not condition():
            if not self.is_alive or time.monotonic() > until:
                return bool(condition())
            time.sleep(0.005)
        return True


def start(
    work: Callable[..., object],
    arguments: Sequence[object],
    said_in: Path,
    environment: Mapping[str, str] | None = None,
    inside: int | None = None,
) -> Command:
    """Call a function in a fork of a process that has imported the program.

    Parameters
    ----------
    work : callable
        A function of a module.
    arguments : sequence
    said_in : Path
        Folder for what it prints.
    environment : mapping, optional
        Variables to set.
    inside : int, optional
        A process whose mounted file systems it sees; see `disks.small_disk`.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_LOADED)
    said = said_in / f"said{time.monotonic_ns()}.txt"
    process = context.Process(target=_in_session, args=(work, arguments, said, dict(environment or {}), inside))
    process.start()
    _begun.append(command := Command(process, said))
    return command


def ablate(
    arguments: Sequence[str],
    said_in: Path,
    how: Start = Start.warm,
    environment: Mapping[str, str] | None = None,
    inside: int | None = None,
) -> Command:
    """Start `python -m ablate` with these arguments; the rest as for `start`."""
    return start(_ablate, (list(arguments), how), said_in, environment, inside)


_begun: list[Command] = []


@contextmanager
def none_left_behind() -> Iterator[None]:
    """Kill what was started inside and is still alive at the end."""
    try:
        yield
    finally:
        for command in _begun:
            if command.is_alive:
                command.signal(signal.SIGKILL)
        _begun.clear()


def _in_session(
    work: Callable[..., object],
    arguments: Sequence[object],
    said: Path,
    environment: Mapping[str, str],
    inside: int | None,
) -> None:
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a campaign in the background is told to ignore it,
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # and one under nohup this one
    output = os.open(said, os.O_CREAT | os.O_WRONLY | os.O_APPEND)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.environ.update(environment)
    faulthandler.enable(2)  # one that hangs says where,
    os.environ["PYTHONFAULTHANDLER"] = "1"  # and so does a program that it starts
    if inside is not None:
        _enter(inside)
    work(*arguments)


def _ablate(arguments: list[str], how: Start) -> None:
    if how is Start.cold:
        os.execv(sys.executable, [sys.executable, "-m", "ablate", *arguments])
    from ablate.__main__ import main

    sys.argv = ["ablate", *arguments]
    main()


def _enter(pid: int) -> None:
    """See the file systems that are mounted for another process."""
    libc = ctypes.CDLL(None, use_errno=True)
    for kind in ("user", "mnt"):
        with Path(f"/proc/{pid}/ns/{kind}").open("rb") as space:
            if libc.setns(space.fileno(), 0):
                raise OSError(ctypes.get_errno(), f"setns {kind}")


def _processes() -> list[int]:
    return [int(path.name) for path in Path("/proc").iterdir() if path.name.isdigit()]


def _stat(pid: int) -> list[str]:
    """State, parent, group, session, ... of a process; empty strings where it is gone."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return [""]
