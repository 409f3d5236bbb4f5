"""What a training logs, in the folder of its run: metrics as lines of JSON, images as PNG. The store has a copy."""

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ablate.storage import write_image

_LOG = "log.jsonl"


class Status(StrEnum):
    """The state of a run, in MLflow's words."""

    running = "RUNNING"
    finished = "FINISHED"
    failed = "FAILED"
    killed = "KILLED"


class Point(NamedTuple):
    """A value of a curve; `time_ms` is since 1970."""

    key: str
    value: float
    time_ms: int
    step: int


class LocalLog:
    """Writes the log of one run, for the process that trains it; see `read_log` and `logged_images`.

    A step that a resumed training does again is not logged again.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / _LOG
        self.path.touch()
        lines, whole = read_log(folder)
        with self.path.open("r+b") as file:
            file.truncate(whole)  # of a line that a killed process began
        self._known = {(point.key, point.step) for point in points(lines)}

    def metrics(self, values: Mapping[str, float], step: int = 0) -> None:
        """Log the values of one step; NaN and infinite values are left out, which MLflow cannot show."""
        new = {
            key: float(value)
            for key, value in values.items()
            if abs(float(value)) < 1e300 and (key, int(step)) not in self._known
        }
        self._known |= {(key, int(step)) for key in new}
        if new:
            self._append({"step": int(step), "metrics": new})

    def image(self, key: str, image: np.ndarray, step: int) -> None:
        """Log an (h, w) uint8 image of a series. A key has letters, digits, spaces and `_-./`."""
        path = self.path.parent / "images" / f"{key.replace('/', '~')}+{step}.png"
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            write_image(path, image)

    def status(self, status: Status) -> None:
        """Log that the run has started or ended."""
        self._append({"status": str(status)})

    def _append(self, content: Mapping[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": int(time.time() * 1000), **content}) + "\n")


def read_log(folder: Path, start: int = 0) -> tuple[list[dict[str, Any]], int]:
    """The whole lines of a run's log from a byte on, and the byte after them; none where there is no log."""
    if not (folder / _LOG).exists():
        return [], 0
    with (folder / _LOG).open("rb") as file:
        file.seek(start)
        text, newline, _ = file.read().rpartition(b"\n")
    lines = []
    for line in text.splitlines():
        with suppress(ValueError):  # a power cut may leave zeros
            lines.append(json.loads(line))
    return [line for line in lines if isinstance(line, dict)], start + len(text) + len(newline)


def points(lines: list[dict[str, Any]]) -> list[Point]:
    """The values in lines of a log."""
    steps = [line for line in lines if "metrics" in line]
    return [Point(key, value, line["time"], line["step"]) for line in steps for key, value in line["metrics"].items()]


def logged_images(folder: Path) -> list[tuple[str, int, Path]]:
    """Key, step and file of each image in a run's log."""
    files = [path for path in (folder / "images").glob("*+*.png") if ".partial" not in path.name]
    split = [(path.stem.rpartition("+"), path) for path in files]
    return sorted((key.replace("~", "/"), int(step), path) for (key, _, step), path in split if step.isdigit())
