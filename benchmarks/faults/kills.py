"""SIGKILL at random moments of a sweep, at each write of a scoring, in the making of the database, of the parent."""

import json
import os
import random
import signal
import sys
import time
from pathlib import Path
from typing import Any

from faults.bench import LAUNCHERS, STUDY, SWEEP, VARIANTS, Bench, Fault, Round, make_database
from faults.commands import Start, ablate, start
from faults.judge import damaged_results, differences, tracked

_MOST_KILLS = 4  # of one study
_PARENT_EVERY_S, _PARENT_MOMENTS = 0.5, 31
_WORKERS_END_S = 5.0


def at_random_moments(bench: Bench, rng: random.Random, number: int) -> Round:
    """Kill a sweep that begins with nothing up to four times, all of its processes; then let it finish.

    A moment is drawn from the time that the unbroken study took, or from what the last sweep of the same kind took that
    ended before its moment.
    """
    runs = bench.place() / "runs"
    kind = how, launcher = (Start.cold, Start.warm)[number % 2], ("basic", "processes")[number // 2 % 2]
    line = [*SWEEP, *LAUNCHERS[launcher], f"runs_dir={runs}"]
    count = 0
    for tried in range(rng.randint(1, _MOST_KILLS)):
        command, begun = ablate(line, runs.parent, how), time.monotonic()
        strikes = begun + rng.uniform(0, _took.get(kind, max(bench.seconds, 1.0)))
        if not command.wait_until(lambda strikes=strikes: time.monotonic() > strikes):  # too late
            if not tried:  # the others have less to do
                _took[kind] = time.monotonic() - begun
            break
        count += command.is_alive
        command.signal(signal.SIGKILL)
        command.wait()
    ended = ablate(line, runs.parent).wait()
    wrong = differences(runs, bench.unbroken) if not ended.code else [f"exit code {ended.code}: {ended.said[-300:]}"]
    return Round(wrong, count)


def at_each_write(bench: Bench, _: random.Random, number: int) -> Round:
    """Score a finished run again, killed before its n-th write to the folder of runs; n is the number of the round.

    A file that is opened to be written in its place is emptied first, as it is when a process is killed after that.
    The round in which the process ends by itself is the last.
    """
    if bench not in _rescored:
        _rescored[bench] = bench.copy()
    runs = _rescored[bench]
    path = runs / STUDY / VARIANTS[0] / "seed0" / "result.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "metrics_version": 1}), "utf-8")
    arguments = ([*SWEEP, f"runs_dir={runs}"], number + 1, str(runs))
    ended = start(_killed_at_write, arguments, runs.parent).wait()
    wrong = damaged_results(runs, [f"{variant}/seed0" for variant in VARIANTS])
    if ended.code not in (0, -signal.SIGKILL):
        wrong.append(f"exit code {ended.code}: {ended.said[-300:]}")
    is_last = ended.code != -signal.SIGKILL
    return Round(wrong or (differences(runs, bench.unbroken) if is_last else []), is_last=is_last)


_rescored: dict[Bench, Path] = {}
_took: dict[tuple[Start, str], float] = {}  # seconds of a sweep from nothing that no kill has met


def _killed_at_write(arguments: list[str], last: int, below: str) -> None:
    writes = 0

    def watch(event: str, about: tuple[Any, ...]) -> None:
        nonlocal writes
        path = about[0] if about else None
        if isinstance(path, os.PathLike):
            path = os.fspath(path)
        if not isinstance(path, str) or not path.startswith(below) or path.endswith(".lock"):
            return
        opened = event == "open" and isinstance(about[1], str) and set(about[1]) & set("wax+")
        if not opened and event not in ("os.rename", "os.remove", "os.rmdir", "os.mkdir"):
            return
        writes += 1
        if writes >= last:
            if opened and "w" in about[1] and os.path.isfile(path):  # noqa: PTH113, a temporary file names its folder
                os.truncate(path, 0)
            os.kill(os.getpid(), signal.SIGKILL)

    from ablate.__main__ import main

    sys.argv = ["ablate", *arguments]
    sys.addaudithook(watch)
    main()


def in_the_making_of_the_database(bench: Bench, rng: random.Random, _: int) -> Round:
    """Kill a process that makes MLflow's database; then open it."""
    folder = bench.place()
    begun = time.monotonic()
    if not bench.database_seconds:
        start(make_database, (folder / "timed",), folder).wait()
        bench.database_seconds = time.monotonic() - begun
    command = start(make_database, (folder / "runs",), folder)
    time.sleep(rng.uniform(0, bench.database_seconds))
    count = int(command.is_alive)
    command.signal(signal.SIGKILL)
    command.wait()
    ended = start(_parent_run, (folder / "runs",), folder).wait()
    if ended.code:
        return Round([f"it cannot be opened: {ended.said[-300:]}"], count)
    found = tracked(folder / "runs" / "mlflow.db").runs
    return Round([] if [name for name, _ in found] == [STUDY] else [f"its runs are {found}"], count)


def _parent_run(runs: Path) -> None:
    from ablate.tracking import open_store, parent_run

    parent_run(open_store(runs, None, "ablate"), STUDY)


def of_the_parent(bench: Bench, _: random.Random, number: int) -> Round:
    """Kill the process that started a sweep of two workers, 0, 0.5 ... 15 s after its start."""
    runs = bench.runs()
    line = [*SWEEP, *LAUNCHERS["processes"], "training.steps=100000", "training.validate_every=0", f"runs_dir={runs}"]
    command = ablate(line, runs.parent, Start.cold)
    time.sleep(number * _PARENT_EVERY_S)
    os.kill(command.pid, signal.SIGKILL)
    command.wait()
    killed = time.monotonic()
    while (left := command.members()) and time.monotonic() - killed < _WORKERS_END_S:
        time.sleep(0.02)
    lived = time.monotonic() - killed
    command.signal(signal.SIGKILL)
    wrong = [f"killed after {number * _PARENT_EVERY_S} s, {len(left)} processes lived on"] if left else []
    return Round(wrong, 1, {"until the last worker had ended, s": lived}, number + 1 >= _PARENT_MOMENTS)


FAULTS = (
    Fault(
        "kill",
        f"SIGKILL of a sweep from nothing at random moments, up to {_MOST_KILLS} of a study",
        "finished by the same command, scores equal to the bit, no (run, metric, step) twice",
        at_random_moments,
        100,
        2,
    ),
    Fault(
        "rescore",
        "SIGKILL at each write while a finished run is scored again",
        "0 results lost",
        at_each_write,
        1000,
        2,
    ),
    Fault(
        "database",
        "SIGKILL while the database is made",
        "the database opens, with one run of the study",
        in_the_making_of_the_database,
        20,
        2,
    ),
    Fault(
        "parent",
        "the parent alone killed 0, 0.5 ... 15 s after its start",
        "no worker alive after 5 s",
        of_the_parent,
        _PARENT_MOMENTS,
        1,
    ),
)
