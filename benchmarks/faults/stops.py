"""Signals, a worker that is killed and memory that runs out, while a sweep trains."""

import os
import random
import resource
import signal
from collections.abc import Callable
from pathlib import Path

from faults.bench import LAUNCHERS, STEPS, STUDY, SWEEP, VARIANTS, Bench, Fault, Round
from faults.commands import Command, ablate
from faults.judge import differences, last_step, result_files

# A checkpoint of each step where a process has no time to write one; else only that of the signal counts.
_EVERY = {True: "training.checkpoint_every=1", False: "training.checkpoint_every=1000"}


def stop(how: str, bench: Bench, rng: random.Random, number: int) -> Round:
    """Stop a sweep at a random step, then let the same command finish it; every second round side by side."""
    runs = bench.runs()
    launcher = ("basic", "processes")[number % 2]
    is_sudden = how in ("SIGKILL", "memory")
    line = [*SWEEP, *LAUNCHERS[launcher], _EVERY[is_sudden], f"runs_dir={runs}"]
    command = ablate(line, runs.parent)
    victim, at = rng.choice(VARIANTS), rng.randrange(1, STEPS - 4)
    command.wait_until(lambda: last_step(_folder(runs, victim)) >= at)
    _HOW[how](command, _folder(runs, victim))
    ended = command.wait()
    logged = {variant: last_step(_folder(runs, variant)) for variant in VARIANTS}
    finished = result_files(runs)
    others = [v for v in VARIANTS if v != victim and is_sudden and launcher == "processes"]
    wrong = [f"{v} did not finish" for v in others if f"{v}/seed0" not in finished]
    wrong += [f"{launcher}: it hung"] * ("hung: it did not end" in ended.said)
    was_ended = is_sudden and ended.code < 0  # by the system; it could say nothing
    if len(finished) < len(VARIANTS) and not was_ended:
        if "the same command" not in ended.said:
            wrong.append(f"{launcher}: it ended without a word on what is missing: ...{ended.said[-200:]}")
        if ended.code == 0:
            wrong.append(f"{launcher}: exit code 0")
    again = ablate(line, runs.parent).wait()
    if again.code:
        return Round([*wrong, f"{launcher}: the same command ends with {again.code}: {again.said[-300:]}"])
    lost = {
        v: logged[v] - int(result_files(runs)[f"{v}/seed0"]["scalars"]["train/resumed_at"])
        for v in VARIANTS
        if f"{v}/seed0" not in finished
    }
    wrong += [f"{launcher}: {v} had done {logged[v]} steps and lost {n}" for v, n in lost.items() if n > 1]
    count = int(len(finished) < len(VARIANTS))
    most = {"steps lost": float(max([0, *lost.values()]))}
    return Round([*wrong, *differences(runs, bench.unbroken)], count, most)


def _folder(runs: Path, variant: str) -> Path:
    return runs / STUDY / variant / "seed0"


def _to_all(number: int) -> Callable[[Command, Path], None]:
    return lambda command, _: command.signal(number)


def _kill_worker(command: Command, folder: Path) -> None:
    for pid in _workers(command, folder):
        os.kill(pid, signal.SIGKILL)


def _no_more_memory(command: Command, folder: Path) -> None:
    """Whatever the process asks the system for from now on is refused."""
    for pid in _workers(command, folder):
        for limit in (resource.RLIMIT_AS, resource.RLIMIT_DATA):
            resource.prlimit(pid, limit, (1, 1))


def _workers(command: Command, folder: Path) -> list[int]:
    """The processes of a command that hold the lock of a run."""
    lock = str(folder / ".lock")
    return [pid for pid in command.members() if lock in _open_files(pid)]


def _open_files(pid: int) -> set[str]:
    try:
        return {str(path.readlink()) for path in Path(f"/proc/{pid}/fd").iterdir()}
    except OSError:  # it has ended
        return set()


_HOW = {
    "SIGINT": _to_all(signal.SIGINT),
    "SIGTERM": _to_all(signal.SIGTERM),
    "SIGHUP": _to_all(signal.SIGHUP),
    "SIGKILL": _kill_worker,
    "memory": _no_more_memory,
}
_MUST = "at most one step lost, it says what is missing; finished by the same command, scores equal to the bit"
_OTHERS = f"{_MUST}; side by side the other job loses nothing"


def _row(name: str, how: str, what: str, must: str) -> Fault:
    def tried(bench: Bench, rng: random.Random, number: int) -> Round:
        return stop(how, bench, rng, number)

    return Fault(name, f"{what}, one after another and side by side in turns", must, tried, 20, 0)


FAULTS = (
    _row("int", "SIGINT", "SIGINT to all processes of a sweep", _MUST),
    _row("term", "SIGTERM", "SIGTERM to all processes of a sweep", _MUST),
    _row("hup", "SIGHUP", "SIGHUP to all processes of a sweep", _MUST),
    _row("worker", "SIGKILL", "SIGKILL of the process that trains one job", _OTHERS),
    _row("memory", "memory", "the process that trains one job gets no more memory", _OTHERS),
)
