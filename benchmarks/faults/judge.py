"""What a study has that went through a fault, against the unbroken one; nothing of the program's own code is asked."""

import json
import sqlite3
from collections import Counter
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from faults.bench import STUDY

# What a clock decides, or where a run was resumed.
_OF_THE_CLOCK = {"seconds", "train/seconds", "train/images_per_second", "train/resumed_at", "ms_per_frame"}


@dataclass(frozen=True)
class Tracked:
    """What a database of MLflow holds of all active runs.

    Attributes
    ----------
    runs : list of (name, status)
    points : list of (name of the run, key, step, value)
    """

    runs: list[tuple[str, str]]
    points: list[tuple[str, str, int, float]]


def tracked(database: Path) -> Tracked:
    """Read runs and metrics from the tables of MLflow's SQLite file."""
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        runs = connection.execute("SELECT name, status FROM runs WHERE lifecycle_stage = 'active'").fetchall()
        points = connection.execute(
            "SELECT r.name, m.key, m.step, m.value FROM metrics m JOIN runs r USING (run_uuid) "
            "WHERE r.lifecycle_stage = 'active'"
        ).fetchall()
    return Tracked(runs, points)


def differences(runs: Path, unbroken: Path, database: Path | None = None) -> list[str]:
    """What a finished study lacks, has twice or has otherwise than the unbroken one, a line each.

    Results and values of frames must be equal to the bit, but for what a clock decides; MLflow has one run a job, all
    finished, and each metric of each step once, with the same value.
    """
    return [*_of_results(runs, unbroken), *_of_tracking(database or runs / "mlflow.db", unbroken / "mlflow.db")]


def result_files(runs: Path) -> dict[str, dict[str, Any]]:
    """`result.json` of each run of the study, by name; a damaged one is an empty mapping."""
    found = {}
    for path in sorted((runs / STUDY).glob("*/seed*/result.json")):
        try:
            found[f"{path.parent.parent.name}/{path.parent.name}"] = json.loads(path.read_text("utf-8"))
        except ValueError:
            found[f"{path.parent.parent.name}/{path.parent.name}"] = {}
    return found


def damaged_results(runs: Path, names: Iterator[str] | list[str]) -> list[str]:
    """Which of the runs have no whole `result.json` and `per_image.parquet`."""
    found = result_files(runs)
    return [f"{name}: its result is lost" for name in names if not found.get(name) or _frames(runs, name) is None]


def logged_points(folder: Path) -> dict[tuple[str, int], float]:
    """The values in `log.jsonl` of a run, by key and step."""
    values = {}
    for line in (folder / "log.jsonl").read_text("utf-8").splitlines():
        content = json.loads(line)
        values |= {(key, content["step"]): value for key, value in content.get("metrics", {}).items()}
    return values


def last_step(folder: Path) -> int:
    """The last step of training that a run has logged; 0 where there is none."""
    try:
        batch = json.loads((folder / "spec.json").read_text("utf-8"))["settings"]["training"]["batch_size"]
        lines = (folder / "log.jsonl").read_text("utf-8").splitlines()
    except OSError:
        return 0
    steps = [0]
    for line in lines:
        try:
            content = json.loads(line)
        except ValueError:  # a line that is being written
            continue
        if "train/l1" in content.get("metrics", {}):
            steps.append(content["step"] // batch)
    return max(steps)


def _of_results(runs: Path, unbroken: Path) -> Iterator[str]:
    there, here = result_files(unbroken), result_files(runs)
    for name in sorted(there.keys() | here.keys()):
        if not here.get(name):
            yield f"{name}: no result"
        elif name not in there:
            yield f"{name}: not a run of this study"
        else:
            yield from (f"{name}: {what}" for what in _unequal(here[name], there[name]))
            if _frames(runs, name) != _frames(unbroken, name):
                yield f"{name}: per_image.parquet differs"
    paired = [folder / STUDY / "comparison" / "paired.csv" for folder in (unbroken, runs)]
    if not paired[1].exists() or paired[0].read_bytes() != paired[1].read_bytes():
        yield "comparison: missing or another"


def _unequal(here: dict[str, Any], there: dict[str, Any]) -> Iterator[str]:
    if here.get("hash") != there["hash"]:
        yield "another hash"
    ours, theirs = (
        {k: v for k, v in content.get("scalars", {}).items() if k not in _OF_THE_CLOCK} for content in (here, there)
    )
    if ours != theirs:
        keys = [key for key in sorted(ours.keys() | theirs.keys()) if ours.get(key) != theirs.get(key)]
        yield f"other scores: {', '.join(keys[:3])}{', ...' if len(keys) > 3 else ''}"


def _frames(runs: Path, name: str) -> Any:
    """The values of frames as plain columns; None where they cannot be read."""
    from pyarrow import ArrowException
    from pyarrow.parquet import ParquetFile

    try:
        with ParquetFile(runs / STUDY / name / "per_image.parquet") as file:
            return file.read(use_threads=False).to_pydict()
    except (OSError, ArrowException):
        return None


def _of_tracking(database: Path, unbroken: Path) -> Iterator[str]:
    here, there = tracked(database), tracked(unbroken)
    if sorted(here.runs) != sorted(there.runs):
        yield f"MLflow: the runs are {sorted(here.runs)}, not {sorted(there.runs)}"
    twice = [key for key, count in Counter(point[:3] for point in here.points).items() if count > 1]
    if twice:
        yield f"MLflow: {len(twice)} values are logged twice, as {twice[0]}"
    ours, theirs = ({p for p in found.points if p[1] not in _OF_THE_CLOCK} for found in (here, there))
    if ours != theirs:
        odd = sorted(ours ^ theirs, key=str)
        yield f"MLflow: {len(theirs - ours)} values are missing and {len(ours - theirs)} are others, as {odd[0]}"
