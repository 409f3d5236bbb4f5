"""Odd surroundings: a locked database, processes that are paused, little shared memory, a strict umask, no room."""

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from faults.bench import STUDY, SWEEP, VARIANTS, Bench, Fault, Round
from faults.commands import Command, Start, ablate, start
from faults.disks import fill_up, inside_of, small_disk
from faults.judge import differences, last_step

_PAUSED_S = 60.0


def locked(bench: Bench, _: random.Random, __: int) -> Round:
    """A sweep while another program holds the database; the same command without it."""
    runs = bench.runs()
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection:
        connection.execute("BEGIN EXCLUSIVE")
        first = ablate([*SWEEP, f"runs_dir={runs}"], runs.parent).wait()
    return _again(bench, runs, "locked", [_traceback(first.said)])


def paused(bench: Bench, rng: random.Random, _: int) -> Round:
    """All processes stand still for a minute."""
    runs = bench.runs()
    command, at = ablate([*SWEEP, f"runs_dir={runs}"], runs.parent), rng.randrange(1, 30)
    command.wait_until(lambda: last_step(runs / STUDY / rng.choice(VARIANTS) / "seed0") >= at)
    command.signal(signal.SIGSTOP)
    time.sleep(_PAUSED_S)
    command.signal(signal.SIGCONT)
    return _judged(bench, runs, command, "paused")


def interrupted_twice(bench: Bench, rng: random.Random, _: int) -> Round:
    """Ctrl-C, and again before the first has had its effect."""
    runs = bench.runs()
    command, at = ablate([*SWEEP, f"runs_dir={runs}"], runs.parent), rng.randrange(1, 30)
    command.wait_until(lambda: last_step(runs / STUDY / VARIANTS[0] / "seed0") >= at)
    for _ in range(2):
        command.signal(signal.SIGINT)
        time.sleep(rng.uniform(0.0, 0.5))
    command.wait()
    return _again(bench, runs, "interrupted twice", [])


def strict(bench: Bench, _: random.Random, __: int) -> Round:
    """All files are the user's alone."""
    runs = bench.runs()
    return _judged(bench, runs, start(_under_umask, (runs,), runs.parent), "umask 077")


def _under_umask(runs: Path) -> None:
    os.umask(0o077)
    os.execv(sys.executable, [sys.executable, "-m", "ablate", *SWEEP, f"runs_dir={runs}"])


def little_shared_memory(bench: Bench, _: random.Random, __: int) -> Round:
    """Workers that load crops pass them through shared memory; containers have little."""
    runs = bench.runs()
    with small_disk(Path("/dev/shm"), 1) as inside:
        line = [*SWEEP, "crops.workers=2", f"runs_dir={runs}"]
        return _judged(bench, runs, ablate(line, runs.parent, Start.cold, inside=inside), "1 MB of /dev/shm")


def collected(bench: Bench, _: random.Random, number: int) -> Round:
    """A run, or the study, is deleted in MLflow for good."""
    runs = bench.copy()
    ablate([*SWEEP, f"runs_dir={runs}"], runs.parent).wait()  # the folder is a copy: its store is made anew
    kind, uri = ("job", "study")[number % 2], f"sqlite:///{runs}/mlflow.db"
    with closing(sqlite3.connect(runs / "mlflow.db")) as connection, connection:
        of_kind = "SELECT run_uuid FROM tags WHERE key = 'kind' AND value = ? LIMIT 1"
        connection.execute(
            f"UPDATE runs SET lifecycle_stage = 'deleted', deleted_time = 1 WHERE run_uuid = ({of_kind})", [kind]
        )
    gone = [sys.executable, "-m", "mlflow", "gc", "--backend-store-uri", uri]
    done = subprocess.run(
        gone, capture_output=True, text=True, check=False, env={**os.environ, "MLFLOW_TRACKING_URI": uri}
    )
    return _again(bench, runs, f"{kind} collected", [done.stderr[-300:]] if done.returncode else [])


def no_room_to_compare(bench: Bench, rng: random.Random, _: int) -> Round:
    """The disk is full just as a finished study is compared."""
    place, free = bench.place(), rng.randrange(2**20)
    room = place / "room"
    room.mkdir()
    line = [*SWEEP, f"runs_dir={room}/runs"]
    with small_disk(room) as inside:
        inside_of(inside, place, shutil.copytree, bench.unbroken, room / "runs")
        inside_of(inside, place, shutil.rmtree, room / "runs" / STUDY / "comparison")
        inside_of(inside, place, fill_up, room, free)
        ended = ablate(line, place, Start.cold, inside=inside).wait()
        inside_of(inside, place, (room / "ballast").unlink)
        again = ablate(line, place, Start.warm, inside=inside).wait()
        inside_of(inside, place, shutil.copytree, room, place / "kept")
    wrong = [f"exit code {again.code}: {again.said[-300:]}"] if again.code else []
    wrong += [f"{free} bytes free: {line}" for line in filter(None, [_traceback(ended.said)])]
    return Round([*wrong, *differences(place / "kept" / "runs", bench.unbroken)])


def _traceback(said: str) -> str:
    return f"a traceback: {said[said.find('Traceback') :][-300:]}" if "Traceback" in said else ""


def _again(bench: Bench, runs: Path, how: str, wrong: list[str]) -> Round:
    """The same command, and what it leaves."""
    found = _judged(bench, runs, ablate([*SWEEP, f"runs_dir={runs}"], runs.parent), how)
    return Round([*(f"{how}: {line}" for line in wrong if line), *found.wrong])


def _judged(bench: Bench, runs: Path, command: Command, how: str) -> Round:
    ended = command.wait()
    if ended.code:
        return Round([f"{how}: exit code {ended.code}: {ended.said[-300:]}"])
    return Round([f"{how}: {line}" for line in differences(runs, bench.unbroken)])


_MUST = "finished, by the same command where it stopped, scores equal to the bit"
FAULTS = tuple(
    Fault(name, what, _MUST, one, wanted, 0)
    for name, what, one, wanted in (
        ("locked", "the database is held by another program for all of a sweep", locked, 3),
        ("paused", "all processes of a sweep stopped for a minute and continued", paused, 3),
        ("int-twice", "SIGINT twice within half a second", interrupted_twice, 10),
        ("umask", "umask 077", strict, 1),
        ("shm", "/dev/shm of 1 MB, with workers that load crops", little_shared_memory, 1),
        ("gc", "a run or the study deleted in MLflow, and `mlflow gc`", collected, 2),
        ("disk-compare", "0 to 1 MB free as a finished study is compared", no_room_to_compare, 5),
    )
)
