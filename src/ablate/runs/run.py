"""One run as it lies on disk: everything in its folder, and the state that this makes up."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from filelock import FileLock

from ablate.metrics import METRICS_VERSION
from ablate.runs.data_set import DataSet
from ablate.setting import check_name
from ablate.settings.conf import build
from ablate.settings.study import StudySettings
from ablate.storage import digest, digest_of_files, known_json
from ablate.training.settings import LAST

_LOG = logging.getLogger(__name__)
_PARAMETERS = {"parameters_generator", "parameters_discriminator"}  # the scalars that every run has
_KINDS: Mapping[str, type] = {
    **{"hash": str, "label": str, "seed": int, "data": str, "pixels": str, "scalars": dict},
    **{"metrics": list, "sources": dict, "metrics_version": int, "notes": list, "started": str, "ended": str},
}


class State(StrEnum):
    """What can be done with the folder of a run."""

    missing = "missing"
    resumable = "resumable"
    finished = "finished"
    unusable = "unusable"


@dataclass(frozen=True)
class Run:
    """The folder of a run: `<study>/<label>/seed<k>`. Values are read when they are asked for, and once."""

    folder: Path

    # What the folder holds.

    @property
    def checkpoint(self) -> Path:
        """The checkpoint that a training goes on from, and whose generator is evaluated; it may be missing."""
        return self.folder / LAST

    @property
    def provenance(self) -> list[Path]:
        """The files that say what the run was made with: settings, code, environment."""
        return sorted(p for p in (self.folder / "provenance").glob("*") if ".partial" not in p.suffixes)

    @property
    def scores_file(self) -> Path:
        """Every metric of every frame, as Parquet."""
        return self.folder / "per_image.parquet"

    @property
    def pictures_file(self) -> Path:
        """Rendered frames and their numbers, for figures."""
        return self.folder / "pictures.npz"

    @cached_property
    def spec(self) -> dict[str, Any]:
        """What the run is: hash, label, changed, semantic, settings; empty where it is missing or damaged."""
        return known_json(self.folder / "spec.json")

    @cached_property
    def result(self) -> dict[str, Any]:
        """What the run came to: its scalars and what they were computed from; empty where missing or damaged."""
        return known_json(self.folder / "result.json")

    @cached_property
    def made_with(self) -> dict[str, Any]:
        """Code, packages and hardware in short; empty where missing or damaged."""
        return known_json(self.folder / "provenance" / "made_with.json")

    @property
    def starts(self) -> list[dict[str, Any]]:
        """What each process that began to train it was started with; empty where that is not known."""
        starts = known_json(self.folder / "provenance" / "starts.json").get("starts")
        return [start for start in starts if isinstance(start, dict)] if isinstance(starts, list) else []

    # What it is called.

    @property
    def label(self) -> str:
        return str(self.spec.get("label", self.folder.parent.name))

    @property
    def seed(self) -> int:
        return int(self.spec["semantic"]["seed"])

    @property
    def name(self) -> str:
        return f"{self.folder.parent.name}/{self.folder.name}"

    @property
    def hash(self) -> str:
        return str(self.spec.get("hash", ""))

    @property
    def data(self) -> str:
        """The name of its pairs."""
        return str(self.result["data"])

    @property
    def data_set(self) -> DataSet:
        """The pairs that it was trained on and scored against; they may have been deleted."""
        return DataSet(self.folder.parents[2] / "data" / self.data)

    @property
    def changed(self) -> dict[str, Any]:
        """The dotted keys that its label says were changed beside the variant, with their values."""
        return dict(self.spec.get("changed", {}))

    @cached_property
    def settings(self) -> StudySettings:
        """The settings that it was started with, at the place where it lies now."""
        return replace(build(StudySettings, self.spec["settings"], stored=True), runs_dir=str(self.folder.parents[2]))

    @cached_property
    def scores(self) -> pd.DataFrame:
        """One row a metric of a frame; with the columns of `metrics.SCORE_COLUMNS`, source, split, variant and seed."""
        return pd.read_parquet(self.scores_file)

    @property
    def pictures(self) -> dict[int, np.ndarray]:
        """Rendered frames, (H, W) uint8, by their number in the data set; none where the file is missing or damaged."""
        try:
            with np.load(self.pictures_file) as kept:
                return dict(zip(kept["frames"].tolist(), kept["images"], strict=True))
        except FileNotFoundError:
            pass
        except Exception as error:  # zip and NumPy raise many kinds
            _LOG.warning("%s is damaged: %s; others are shown", self.pictures_file, " ".join(str(error).split()))
        return {}

    # What can be done with it.

    @cached_property
    def state(self) -> State:
        """One of four; `why` says more."""
        return self._standing[0]

    @cached_property
    def why(self) -> str:
        """Why a run is not finished, or cannot be used; empty for one that is finished or missing."""
        return self._standing[1]

    @cached_property
    def _standing(self) -> tuple[State, str]:
        begun = self.checkpoint.exists()
        if not (self.folder / "spec.json").exists():
            return (State.unusable, "without a spec.json") if begun else (State.missing, "")
        parts: list[Any] = [self.spec.get(key) for key in ("changed", "settings", "semantic")]
        if not (all(isinstance(part, dict) for part in parts) and "seed" in parts[2] and digest(parts[2]) == self.hash):
            return State.unusable, "with a spec.json that is damaged, or not what its hash says"
        if not (self.folder / "result.json").exists():
            return (State.resumable if begun else State.missing), "not finished"
        if wrong := _unusable_keys(self.result):
            return State.unusable, f"without a usable {', '.join(wrong)} in result.json: start it again"
        if self.result["hash"] != self.hash or self.result["label"] != self.label:
            return State.unusable, "with a result of another configuration"
        if (version := self.result["metrics_version"]) != METRICS_VERSION:
            newer = "a newer version" if version > METRICS_VERSION else "start it again"
            state = State.unusable if version > METRICS_VERSION else State.resumable
            return state, f"scored by version {version} of the metrics, not {METRICS_VERSION}: {newer}"
        try:
            for metric in set(self.scores["metric"]):
                check_name("metric", str(metric))  # it becomes part of the name of a figure's file
            is_own = (set(self.scores["variant"]), set(self.scores["seed"])) == ({self.label}, {self.seed})
            if is_own and (self.scores["split"] == "test").any():
                return State.finished, ""
        except (OSError, ValueError, KeyError) as error:  # pyarrow's are ValueErrors
            return State.resumable, f"unreadable ({type(error).__name__}: {self.scores_file.name}): start it again"
        what = "no value on the test frames" if is_own else "values of another run"
        return State.unusable, f"with a {self.scores_file.name} that cannot be used (it holds {what}): start it again"

    def copied_state(self) -> str:
        """A digest that changes with whatever the tracking store has a copy of."""
        grown = [self.folder / "log.jsonl", self.scores_file, *sorted((self.folder / "images").glob("*"))]
        sizes = {path.name: path.stat().st_size for path in grown if path.exists()}
        texts = [self.folder / "result.json", self.folder / "spec.json", *self.provenance]
        return digest([sizes, digest_of_files(texts)])

    def compared_state(self) -> str:
        """A digest that changes with whatever a comparison reads."""
        names = "spec.json", "result.json", "per_image.parquet", "pictures.npz", "provenance/made_with.json"
        return digest_of_files(self.folder / name for name in names)

    def lock(self, timeout: float = -1) -> FileLock:
        """Held by the process that trains the run."""
        return FileLock(self.folder / ".lock", timeout=timeout)


def runs_of(study_dir: Path) -> list[Run]:
    """Every run of a study, in whatever state, by label and seed."""
    return [Run(path.parent) for path in sorted(study_dir.glob("*/seed*/spec.json"))]


def _unusable_keys(result: Mapping[str, Any]) -> list[str]:
    """The keys that are missing from a `result.json`, or hold what no run writes there."""
    wrong = [key for key, kind in _KINDS.items() if not isinstance(result.get(key), kind)]
    wrong = wrong or [key for key in ("metrics", "notes") if not all(isinstance(text, str) for text in result[key])]
    if not wrong and not all(isinstance(value, int | float) for value in result["scalars"].values()):
        wrong = ["scalars"]
    return wrong or sorted(f"scalars.{name}" for name in _PARAMETERS - result["scalars"].keys())
