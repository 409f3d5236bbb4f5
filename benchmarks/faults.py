"""Faults that a small sweep goes through, and what it must have afterwards; `chaos.py` counts them.

A round takes a folder of its own, disturbs the sweep, lets the same command finish it, and compares what is there with
the sweep that nothing has disturbed. The comparison reads files and MLflow's tables, and calls none of the program.
"""

import json
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

STUDY = "tiny-fetal"
SWEEP = [
    "-m",
    "variant=sa2h,sa2h-att",
    "preset=tiny",
    "simulator.image_shape=[96,134]",
    "dataset.frames=10",
    "training.steps=40",
    "training.checkpoint_every=5",
    "training.validate_every=20",
    "training.log_every=1",
    "evaluation.pictures=1",
    "evaluation.timed_frames=1",
    "metrics=[psnr,mae]",
]
LAUNCHERS = ("hydra/launcher=basic", "hydra.launcher.n_jobs=2")  # one job after another, and side by side
# What a clock decides, or where a run was resumed.
OF_THE_CLOCK = {"seconds", "train/seconds", "train/images_per_second", "train/resumed_at", "ms_per_frame"}
MOST_KILLS = 4  # of one sweep
DISK_MIB, MOST_FREE = 64, 2 * 2**20
HUNG_S = 1200.0  # beside other work a command of 20 s may take minutes


@dataclass(frozen=True)
class Ended:
    """The exit code of a command, negative for a signal, and what it and its workers printed."""

    code: int
    said: str


class Command:
    """`python -m ablate`, leading a session of its own that can be killed whole."""

    def __init__(self, process: "subprocess.Popen[bytes]", output: Path) -> None:
        self._process = process
        self._output = output

    @property
    def said(self) -> str:
        """What the session has printed by now."""
        return self._output.read_text("utf-8", "replace")

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def wait(self, seconds: float = HUNG_S) -> Ended:
        """Wait for the end; after so long all processes of the session are killed, and the output says so."""
        try:
            return Ended(self._process.wait(seconds), self.said)
        except subprocess.TimeoutExpired:
            os.killpg(self._process.pid, signal.SIGKILL)
            return Ended(self._process.wait(), f"{self.said}\nkilled: it did not end within {seconds:.0f} s")


def ablate(
    arguments: Sequence[str], folder: Path, environment: Mapping[str, str] | None = None, disk_of: int | None = None
) -> Command:
    """Start a command line that prints into a new file of a folder.

    Parameters
    ----------
    arguments : sequence of str
    folder : Path
    environment : mapping, optional
        Variables to set.
    disk_of : int, optional
        The process whose mounted file systems the command sees; see `small_disk`.

    Returns
    -------
    Command
    """
    entering = ["nsenter", f"--target={disk_of}", "--user", "--mount", "--preserve-credentials"] if disk_of else []
    output = folder / f"said{time.monotonic_ns()}.txt"
    with output.open("wb") as file:
        process = subprocess.Popen(
            [*entering, sys.executable, "-m", "ablate", *arguments],
            stdout=file,
            stderr=subprocess.STDOUT,
            env=os.environ | dict(environment or {}),
            start_new_session=True,
        )
    return Command(process, output)


class Bench:
    """Folders for the rounds, and the sweep that no fault has touched."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._rounds = 0
        self.unbroken = self.place() / "runs"
        started = time.monotonic()
        ended = ablate([*SWEEP, f"runs_dir={self.unbroken}"], self.unbroken.parent).wait()
        self.seconds = time.monotonic() - started  # of the unbroken sweep
        if ended.code:
            raise RuntimeError(f"the unbroken sweep failed:\n{ended.said}")

    def place(self) -> Path:
        """A new empty folder."""
        self._rounds += 1
        folder = self._folder / f"round{self._rounds}"
        folder.mkdir(parents=True)
        return folder


def differences(runs: Path, unbroken: Path) -> list[str]:
    """What a finished sweep lacks, has twice or has otherwise than the unbroken one, a line each.

    Scores of runs and of frames and the table of paired differences must be equal to the bit, but for what a clock
    decides. MLflow has each run once, and each metric of each step once, with the same value.
    """
    expected, found = _scores(unbroken), _scores(runs)
    names = sorted(expected.keys() | found.keys())
    wrong = [f"{name}: missing, added or another" for name in names if expected.get(name) != found.get(name)]
    expected_runs, expected_points = _tracked(unbroken / "mlflow.db")
    found_runs, found_points = _tracked(runs / "mlflow.db")
    if found_runs != expected_runs:
        wrong.append(f"MLflow: the runs are {found_runs}, not {expected_runs}")
    if twice := len(found_points) - len(set(found_points)):
        wrong.append(f"MLflow: {twice} values are there twice")
    if odd := set(found_points) ^ set(expected_points):
        wrong.append(f"MLflow: {len(odd)} values are missing or others, as {min(odd)}")
    return wrong


def _scores(runs: Path) -> dict[str, Any]:
    """What the files of a study say, by their names; None where one cannot be read."""
    readers = (("*.json", _scalars), ("*.parquet", _table), ("paired.csv", Path.read_bytes))
    found: dict[str, Any] = {}
    for pattern, read in readers:
        for path in (runs / STUDY).rglob(pattern):
            name = str(path.relative_to(runs))
            try:
                found[name] = read(path)
            except (OSError, ValueError):  # pyarrow's ArrowInvalid is a ValueError
                found[name] = None
    return found


def _scalars(file: Path) -> dict[str, Any]:
    """The scores in a JSON file; most files have none."""
    content = json.loads(file.read_text("utf-8"))
    scalars = content.get("scalars", {}) if isinstance(content, dict) else {}
    return {key: value for key, value in scalars.items() if key not in OF_THE_CLOCK}


def _table(file: Path) -> str:
    return pd.read_parquet(file).to_csv()  # as many digits as tell any two numbers apart


def _tracked(database: Path) -> tuple[list[tuple[str, str]], list[tuple[str, str, int, float]]]:
    """Names and states of MLflow's runs, and their metrics as (run, key, step, value)."""
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        runs = connection.execute("SELECT name, status FROM runs WHERE lifecycle_stage = 'active'").fetchall()
        points = connection.execute(
            "SELECT r.name, m.key, m.step, m.value FROM metrics m JOIN runs r USING (run_uuid) "
            "WHERE r.lifecycle_stage = 'active'"
        ).fetchall()
    return sorted(runs), [point for point in points if point[1] not in OF_THE_CLOCK]


def killed(bench: Bench, rng: random.Random, number: int) -> list[str]:
    """Kill all processes of a sweep from nothing, up to four times, at moments within an unbroken one's time."""
    runs = bench.place() / "runs"
    line = [*SWEEP, LAUNCHERS[number % 2], f"runs_dir={runs}"]
    for _ in range(rng.randint(1, MOST_KILLS)):
        command = ablate(line, runs.parent)
        command.wait(rng.uniform(0, bench.seconds))
    return _finished(bench, line, runs)


def disk_full(bench: Bench, rng: random.Random, _: int) -> list[str]:
    """Train the second job of a sweep whose first has finished, with 0 to 2 MB free; then with enough."""
    place = bench.place()
    disk = place / "disk"
    runs = disk / "runs"
    line = [*SWEEP, f"runs_dir={runs}"]
    free = rng.randrange(MOST_FREE)
    with small_disk(disk) as pid:
        seen = Path(f"/proc/{pid}/root{disk}")  # the disk, from outside
        shutil.copytree(bench.unbroken / "data", seen / "runs" / "data")
        trained = [path.parent for path in (bench.unbroken / STUDY).rglob("last.ckpt")]
        finished = min(trained).relative_to(bench.unbroken)
        shutil.copytree(bench.unbroken / finished, seen / "runs" / finished)
        before = _contents(seen / "runs" / finished)
        (seen / "ballast").write_bytes(bytes(max(0, shutil.disk_usage(seen).free - free)))
        wrong = _traceback(ablate(line, place, disk_of=pid).wait())
        after = _contents(seen / "runs" / finished)
        wrong += [f"{path} of a finished run changed" for path in before if after.get(path) != before[path]]
        (seen / "ballast").unlink()
        again = ablate(line, place, disk_of=pid).wait()
        shutil.copytree(seen / "runs", place / "kept")
    if again.code:
        return [*wrong, f"{free} bytes free, then enough: exit code {again.code}: {again.said[-300:]}"]
    return [*wrong, *differences(place / "kept", bench.unbroken)]


@contextmanager
def small_disk(folder: Path) -> Iterator[int]:
    """Mount an empty file system at a new folder, for the process whose id is given and those that enter it."""
    folder.mkdir()
    mount = f"mount -t tmpfs -o size={DISK_MIB}M tmpfs {folder} && echo mounted && exec sleep 100000"
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        try:
            if holder.stdout.readline() != "mounted\n":
                raise RuntimeError("file systems cannot be mounted here; leave the fault `disk` out")
            yield holder.pid
        finally:
            holder.kill()


def at_once(bench: Bench, rng: random.Random, _: int) -> list[str]:
    """Start the same sweep twice within two seconds, in a fresh folder of runs."""
    runs = bench.place() / "runs"
    line = [*SWEEP, f"runs_dir={runs}"]
    first = ablate(line, runs.parent)
    time.sleep(rng.uniform(0, 2))
    second = ablate(line, runs.parent)
    ended = [first.wait(), second.wait()]
    wrong = [f"exit code {each.code}: {each.said[-300:]}" for each in ended if each.code]
    return wrong or differences(runs, bench.unbroken)


def damaged(bench: Bench, rng: random.Random, _: int) -> list[str]:
    """Change bytes of one file of a finished sweep and repeat the command; then once more with the file as it was."""
    runs = Path(shutil.copytree(bench.unbroken, bench.place() / "runs"))
    line = [*SWEEP, f"runs_dir={runs}"]
    if wrong := _finished(bench, line, runs):
        return [f"the folder was copied: {found}" for found in wrong]
    victim = rng.choice([path for path in sorted(_contents(runs)) if path.parts[0] in {STUDY, "data"}])
    content = (runs / victim).read_bytes()
    (runs / victim).write_bytes(changed_bytes(rng, content))
    wrong = [f"{victim}: {found}" for found in _traceback(ablate(line, runs.parent).wait())]
    (runs / victim).write_bytes(content)
    return [*wrong, *(f"{victim}, as it was again: {found}" for found in _finished(bench, line, runs))]


def changed_bytes(rng: random.Random, content: bytes) -> bytes:
    """One to eight times: bits flipped, bytes replaced or taken out, or the rest cut off."""
    changed = bytearray(content)
    for _ in range(rng.randint(1, 8)):
        at = rng.randrange(len(changed) + 1)
        end = min(len(changed), at + rng.choice((1, 4, 100)))
        how = rng.choice(("flip", "replace", "remove", "cut"))
        if how == "flip" and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif how == "replace":
            changed[at:end] = rng.randbytes(end - at)
        elif how == "remove":
            del changed[at:end]
        elif how == "cut":
            del changed[at:]
    return bytes(changed)


def _contents(folder: Path) -> dict[Path, bytes]:
    """The files below a folder, without locks."""
    files = [path for path in folder.rglob("*") if path.is_file() and not path.name.endswith(".lock")]
    return {path.relative_to(folder): path.read_bytes() for path in files}


def _traceback(ended: Ended) -> list[str]:
    start = ended.said.find("Traceback")
    return [f"a traceback: {ended.said[start:][-300:]}"] if start >= 0 else []


def _finished(bench: Bench, line: Sequence[str], runs: Path) -> list[str]:
    """Let the same command finish, and compare."""
    ended = ablate(line, runs.parent).wait()
    if ended.code:
        return [f"exit code {ended.code}: {ended.said[-300:]}"]
    return differences(runs, bench.unbroken)
