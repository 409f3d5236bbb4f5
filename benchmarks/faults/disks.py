"""Disks that are full: the folder of runs, TMPDIR and the database, each on a small file system of its own."""

import hashlib
import os
import random
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from faults.bench import STUDY, SWEEP, VARIANTS, Bench, Fault, Round
from faults.commands import Start, ablate, start
from faults.judge import differences

_SIZE_MIB = 64
_MOST_FREE = 2 * 2**20
_DONE, _LEFT = (f"{variant}/seed0" for variant in VARIANTS)


def full(which: str, bench: Bench, rng: random.Random, _: int) -> Round:
    """Train the second job of a study whose first has finished, with 0 to 2 MB free; then with enough."""
    place = bench.place()
    room = place / "room"
    room.mkdir()
    runs = room / "runs" if which == "runs" else place / "runs"
    line = [*SWEEP, f"runs_dir={runs}"]
    if which == "database":
        line.append(f"tracking.uri=sqlite:///{room}/tracking.db")
    environment = {"TMPDIR": str(room)} if which == "TMPDIR" else {}
    free = rng.randrange(_MOST_FREE)
    with small_disk(room) as inside:
        inside_of(inside, place, _begin, bench.unbroken, runs)
        before = inside_of(inside, place, _digests, runs)
        inside_of(inside, place, fill_up, room, free)
        ended = ablate(line, place, Start.cold, environment, inside).wait()
        after = inside_of(inside, place, _digests, runs)
        inside_of(inside, place, (room / "ballast").unlink)
        again = ablate(line, place, Start.warm, environment, inside).wait()
        inside_of(inside, place, shutil.copytree, room, place / "kept")
    wrong = []
    if "Traceback" in ended.said:
        wrong.append(f"{free} bytes free, a traceback: {ended.said[ended.said.find('Traceback') :][-300:]}")
    if not set(before.splitlines()) <= set(after.splitlines()):
        wrong.append(f"{free} bytes free: a finished file changed")
    if again.code:
        return Round([*wrong, f"with space again it ends with {again.code}: {again.said[-300:]}"])
    kept = place / "kept" / "runs" if which == "runs" else runs
    database = place / "kept" / "tracking.db" if which == "database" else None
    return Round([*wrong, *differences(kept, bench.unbroken, database)])


@contextmanager
def small_disk(folder: Path, mib: int = _SIZE_MIB) -> Iterator[int]:
    """Mount an empty file system at a folder for the process whose id is given, and those that enter; see `start`."""
    mount = f"mount -t tmpfs -o size={mib}M tmpfs {folder} && echo mounted && exec sleep 100000"
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        if holder.stdout.readline() != "mounted\n":
            raise RuntimeError("file systems cannot be mounted here; leave the faults of disks out")
        try:
            yield holder.pid
        finally:
            holder.kill()


def inside_of(inside: int, place: Path, work: object, *arguments: object) -> str:
    """Call a function where the small disk is seen; returns what it prints."""
    ended = start(work, arguments, place, inside=inside).wait()  # type: ignore[arg-type]
    if ended.code:
        raise RuntimeError(ended.said)
    return ended.said


def _begin(unbroken: Path, runs: Path) -> None:
    """The pairs, the database's file and the first job of the unbroken study, as they are when that has finished."""
    shutil.copytree(unbroken / "data", runs / "data")
    shutil.copytree(unbroken / STUDY / _DONE, runs / STUDY / _DONE)


def _digests(runs: Path) -> None:
    for path in sorted((runs / STUDY / _DONE).glob("*")):
        if path.is_file() and path.name not in (".lock", ".copy.lock"):
            print(path.name, hashlib.sha256(path.read_bytes()).hexdigest())


def fill_up(room: Path, free: int) -> None:
    disk = os.statvfs(room)
    with (room / "ballast").open("wb") as file:
        file.write(bytes(max(0, disk.f_bavail * disk.f_bsize - free)))


_MUST = "no finished file damaged, no traceback; the same command finishes with space, scores equal to the bit"
FAULTS = tuple(
    Fault(name, f"0 to 2 MB free {where}", _MUST, partial(full, which), 10, 0)
    for name, which, where in (
        ("disk", "runs", "in the folder of runs"),
        ("tmpdir", "TMPDIR", "in TMPDIR"),
        ("disk-database", "database", "on the disk of the database"),
    )
)
