"""What a training logs, in its folder: metrics and states as lines of JSON, images as PNG.

Publishing reads it: what is on disk is the truth, and a tracker shows a copy.
"""

import json
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np

from ablate.storage import write_image

_FILE = "log.jsonl"
_LARGEST = 1e300  # of a value that a tracker can show


class Status(StrEnum):
    """The state of a run, in MLflow's words."""

    running = "RUNNING"
    finished = "FINISHED"
    failed = "FAILED"
    killed = "KILLED"


@dataclass(frozen=True)
class Point:
    """One value of a curve."""

    key: str
    value: float
    time_ms: int
    step: int


@dataclass(frozen=True)
class LoggedImage:
    """One image of a series."""

    key: str
    step: int
    path: Path


class LocalLog:
    """Writes the log of one training, for the process that trains it.

    A step that a resumed training does again is not logged again.
    """

    def __init__(self, folder: Path, anew: bool = False) -> None:
        """Go on with the log of a folder, or with `anew` forget what an earlier training has logged."""
        self.path = folder / _FILE
        if anew:
            self.path.unlink(missing_ok=True)
            rmtree(folder / "images", ignore_errors=True)
        self.path.touch()
        lines, whole = _lines(folder)
        with self.path.open("r+b") as file:
            file.truncate(whole)  # of a line that a killed process began
        self._logged = {(point.key, point.step) for point in _points(lines)}

    def metrics(self, values: Mapping[str, float], step: int) -> None:
        """Log the values of one step; NaN and infinite values, which MLflow cannot show, are left out."""
        new = {k: v for k, v in values.items() if abs(v) < _LARGEST and (k, step) not in self._logged}
        self._logged |= {(key, step) for key in new}
        if new:
            self._append({"step": step, "metrics": new})

    def image(self, key: str, image: np.ndarray, step: int) -> None:
        """Log an (h, w) uint8 image of a series. A key has letters, digits, spaces and `_-./`."""
        path = self.path.parent / "images" / f"{key.replace('/', '~')}+{step}.png"
        if not path.exists():
            path.parent.mkdir(exist_ok=True)
            write_image(path, image)

    def status(self, status: Status) -> None:
        """Log that the training has started or ended."""
        self._append({"status": str(status)})

    def _append(self, content: Mapping[str, Any]) -> None:
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"time": int(time.time() * 1000), **content}) + "\n")


@dataclass(frozen=True)
class Log:
    """What a training has logged so far."""

    points: tuple[Point, ...]
    images: tuple[LoggedImage, ...]  # by key and step
    states: tuple[tuple[int, Status], ...]  # ms since 1970, and what began or ended then
    began_ms: int | None  # None where nothing is logged


def read_log(folder: Path) -> Log:
    """The log in the folder of a training; empty where there is none."""
    lines, _ = _lines(folder)
    states = tuple((line["time"], Status(line["status"])) for line in lines if "status" in line)
    began_ms = lines[0]["time"] if lines else None
    return Log(tuple(_points(lines)), tuple(_images(folder)), states, began_ms)


def _lines(folder: Path) -> tuple[list[dict[str, Any]], int]:
    """The whole lines of a log, and the byte after them."""
    file = folder / _FILE
    if not file.exists():
        return [], 0
    text, newline, _ = file.read_bytes().rpartition(b"\n")
    lines = []
    for line in text.splitlines():
        with suppress(ValueError):  # a power cut may leave zeros
            lines.append(json.loads(line))
    return [line for line in lines if isinstance(line, dict) and "time" in line], len(text) + len(newline)


def _points(lines: list[dict[str, Any]]) -> list[Point]:
    return [
        Point(key, value, line["time"], line["step"])
        for line in lines
        if "metrics" in line
        for key, value in line["metrics"].items()
    ]


def _images(folder: Path) -> list[LoggedImage]:
    found = []
    for path in (folder / "images").glob("*+*.png"):
        key, _, step = path.stem.rpartition("+")
        if step.isdigit() and ".partial" not in path.name:
            found.append(LoggedImage(key.replace("~", "/"), int(step), path))
    return sorted(found, key=lambda image: (image.key, image.step))
