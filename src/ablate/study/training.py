"""One training as it lies on disk: `<study>/<label>-seed<k>-<hash8>/`, everything in it, and its state.

All that is known of the layout of such a folder stands here.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np
from filelock import FileLock

from ablate.settings.conf import build
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.sources.data_set import DataSet
from ablate.storage import MOST_UNPACKED, check_archive, digest, digest_of_files, known_json, write_json
from ablate.study.scores import ScoreKey, is_whole
from ablate.training.settings import LAST

_LOG = logging.getLogger(__name__)
ABOUT = "training.json"  # what it is: hash, label, seed, changed, identity, settings, data
RESULT = "trained.json"  # what it came to; written when the last step is done
_PARAMETERS = ("parameters_generator", "parameters_discriminator")  # scalars that every training has
_KINDS: Mapping[str, type] = {"pixels": str, "scalars": dict, "notes": list, "started": str, "ended": str}
# They lead to no other folder. The name of a data set begins with that of a folder of a scene, which may be hidden.
_NAMES = {"label": r"\w[\w.+ -]*", "data": r"[\w.+ -]*\w"}


class State(StrEnum):
    """What can be done with the folder of a training."""

    missing = "missing"
    resumable = "resumable"
    trained = "trained"
    unusable = "unusable"


@dataclass(frozen=True)
class Training:
    """The folder of a training. Values are read when they are asked for, and once."""

    folder: Path

    @property
    def checkpoint(self) -> Path:
        """The checkpoint that a training goes on from, and whose generator is evaluated; it may be missing."""
        return self.folder / LAST

    @property
    def provenance(self) -> Path:
        """The folder of what it was made with: settings, code, environment."""
        return self.folder / "provenance"

    @property
    def scores(self) -> Path:
        """The folder of its scores, a file each."""
        return self.folder / "scores"

    @property
    def pictures_file(self) -> Path:
        """Rendered frames and their numbers, for figures."""
        return self.folder / "pictures.npz"

    @cached_property
    def about(self) -> dict[str, Any]:
        """What it is; empty where the file is missing or damaged."""
        return known_json(self.folder / ABOUT)

    @cached_property
    def result(self) -> dict[str, Any]:
        """What it came to: pixels, scalars, notes, started, ended; empty until the last step is done."""
        return known_json(self.folder / RESULT)

    @cached_property
    def made_with(self) -> dict[str, Any]:
        """Code, packages and hardware in short; empty where missing or damaged."""
        return known_json(self.provenance / "made_with.json")

    @property
    def starts(self) -> list[dict[str, Any]]:
        """What each process that began to train it was started with; empty where that is not known."""
        starts = known_json(self.provenance / "starts.json").get("starts")
        return [start for start in starts if isinstance(start, dict)] if isinstance(starts, list) else []

    @property
    def pictures(self) -> dict[int, np.ndarray]:
        """Rendered frames, (H, W) uint8, by their number in the data set; none where the file is missing or damaged."""
        try:
            check_archive(self.pictures_file, MOST_UNPACKED)
            with np.load(self.pictures_file) as kept:
                return dict(zip(kept["frames"].tolist(), kept["images"], strict=True))
        except FileNotFoundError:
            pass
        except Exception as error:  # zip and NumPy raise many kinds
            _LOG.warning("%s is damaged: %s; others are shown", self.pictures_file, " ".join(str(error).split()))
        return {}

    @property
    def hash(self) -> str:
        return str(self.about.get("hash", ""))

    @property
    def identity(self) -> dict[str, Any]:
        """The settings that decide its weights; see `Job.identity`."""
        return dict(self.about["identity"])

    @property
    def label(self) -> str:
        """The label of the job that began it; another job of the same training may have another."""
        return str(self.about["label"])

    @property
    def seed(self) -> int:
        return int(self.about["seed"])

    @property
    def name(self) -> str:
        return f"{self.label}/seed{self.seed}"

    @property
    def changed(self) -> dict[str, Any]:
        """The dotted keys that its label says were changed beside the variant, with their values."""
        return dict(self.about["changed"])

    @cached_property
    def settings(self) -> StudySettings:
        """The settings that it was started with, at the place where it lies now."""
        results = str(self.folder.parents[1])
        return replace(build(StudySettings, self.about["settings"], stored=True), runs_dir=results)

    @property
    def data_set(self) -> DataSet:
        """The pairs that it was trained on; they may have been deleted."""
        return DataSet(self.folder.parents[1] / "data" / Path(str(self.about["data"])).name)

    @property
    def pixels(self) -> str:
        """The digest of the test frames of its data set when it was trained; empty before that."""
        return str(self.result.get("pixels", ""))

    @property
    def is_trained(self) -> bool:
        """Whether the last step is done."""
        return self.state is State.trained

    @property
    def state(self) -> State:
        """One of four; `why` says more."""
        return self._standing[0]

    @property
    def why(self) -> str:
        """Why it is not trained, or cannot be used; empty for one that is trained or missing."""
        return self._standing[1]

    @cached_property
    def _standing(self) -> tuple[State, str]:
        has_checkpoint = self.checkpoint.exists()
        if not (self.folder / ABOUT).exists():
            return (State.unusable, f"without a {ABOUT}") if has_checkpoint else (State.missing, "")
        if not _is_described(self.about):
            return State.unusable, f"with a {ABOUT} that is damaged, or not what its hash says"
        if not self.folder.name.endswith(_address("", self.about.get("seed"), self.hash)):
            return State.unusable, "in a folder that was renamed"
        if not (self.folder / RESULT).exists():
            return (State.resumable if has_checkpoint else State.missing), "not finished"
        wrong = _unusable_keys(self.result)
        if wrong:
            return State.unusable, f"without a usable {', '.join(wrong)} in {RESULT}: start it again"
        return State.trained, ""

    def lacking(self, wanted: Iterable[ScoreKey]) -> list[ScoreKey]:
        """Those of the scores that are not there, or damaged."""
        return [key for key in wanted if not is_whole(self.scores / key.file_name)]

    @property
    def lock_file(self) -> Path:
        """Held by the process that trains or scores it."""
        return self.folder / ".lock"

    def begin_again(self) -> None:
        """Forget what a training came to whose checkpoint is gone: pictures and scores are those of other weights."""
        (self.folder / RESULT).unlink(missing_ok=True)
        self.pictures_file.unlink(missing_ok=True)
        rmtree(self.scores, ignore_errors=True)

    def write_result(self, result: Mapping[str, Any]) -> None:
        """Keep what it came to; from now on it is trained."""
        write_json(self.folder / RESULT, result)

    def published_state(self) -> str:
        """A digest that changes with whatever a tracker shows of it."""
        shown = [self.folder / "log.jsonl", *sorted((self.folder / "images").glob("*")), *self.score_files()]
        sizes = {path.name: path.stat().st_size for path in shown if path.exists()}
        return digest([sizes, digest_of_files([self.folder / RESULT, *self.provenance_files()])])

    def compared_state(self, scores: Sequence[str]) -> str:
        """A digest that changes with whatever a comparison that reads these scores reads."""
        files = [self.folder / name for name in (ABOUT, RESULT)]
        files += [self.pictures_file, self.provenance / "made_with.json"]
        return digest_of_files([*files, *(self.scores / name for name in sorted(scores))])

    def score_files(self) -> list[Path]:
        """Every score that it has."""
        return sorted(path for path in self.scores.glob("*@*.parquet") if ".partial" not in path.suffixes)

    def provenance_files(self) -> list[Path]:
        """The files that say what it was made with."""
        return sorted(path for path in self.provenance.glob("*") if ".partial" not in path.suffixes)


def _address(label: str, seed: object, hash_: str) -> str:
    return f"{label}-seed{seed}-{hash_[:8]}"


def training_at(study_dir: Path, label: str, seed: int, hash_: str) -> Training:
    """The folder of a training: where another label has made it, or else the one that it will have.

    Parameters
    ----------
    study_dir : Path
        Folder of the study.
    label, seed : str, int
        Of the job that asks for it.
    hash_ : str
        The digest of its identity.
    """
    for path in sorted(study_dir.glob(f"*{_address('', seed, hash_)}")):
        if Training(path).hash == hash_:
            return Training(path)
    return Training(study_dir / _address(label, seed, hash_))


def begin_folder(study_dir: Path, about: Mapping[str, Any]) -> Training:
    """Make the folder of a training, and say in it what it is; see `Training.about`.

    A checkpoint beside a file that is damaged may be of anything: a ConfigurationError.
    """
    refuse_link(study_dir)
    study_dir.mkdir(parents=True, exist_ok=True)
    with FileLock(study_dir / ".claim.lock"):  # two labels of one training have one folder
        training = training_at(study_dir, about["label"], about["seed"], about["hash"])
        for path in (training.folder, *training.folder.glob("*")):
            refuse_link(path)
        if training.hash == about["hash"]:
            return training
        if training.checkpoint.exists():
            damaged = f"{training.folder / ABOUT} is missing or damaged"
            raise ConfigurationError(f"{damaged}: what was trained is not known; remove {training.folder}")
        training.folder.mkdir(exist_ok=True)
        write_json(training.folder / ABOUT, about)
        return Training(training.folder)


def refuse_link(path: Path) -> None:
    """Refuse to write through a link in a study: whoever made the study would choose where to."""
    if path.is_symlink():
        kinds = "allowed are files and folders; runs_dir may be elsewhere"
        raise ConfigurationError(f"{path} is a link to {path.readlink()}: {kinds}")


def trainings_in(study_dir: Path) -> list[Training]:
    """Every training in the folder of a study, in whatever state, by the name of its folder."""
    return [Training(path.parent) for path in sorted(study_dir.glob(f"*/{ABOUT}"))]


def _is_described(about: Mapping[str, Any]) -> bool:
    """Whether this says what a training is; it may come from anybody."""
    dicts = [about.get(key) for key in ("changed", "settings", "identity")]
    return (
        all(isinstance(value, dict) for value in dicts)
        and all(isinstance(about.get(key), str) and re.fullmatch(name, about[key]) for key, name in _NAMES.items())
        and isinstance(about.get("seed"), int)
        and digest(about["identity"]) == about.get("hash")
    )


def _unusable_keys(result: Mapping[str, Any]) -> list[str]:
    """The keys that are missing from what a training came to, or hold what no training writes there."""
    wrong = [key for key, kind in _KINDS.items() if not isinstance(result.get(key), kind)]
    if wrong:
        return wrong
    if not re.fullmatch(r"[0-9a-f]{16}", result["pixels"]):
        return ["pixels"]
    if not all(isinstance(note, str) for note in result["notes"]):
        return ["notes"]
    if not all(isinstance(value, int | float) for value in result["scalars"].values()):
        return ["scalars"]
    return [f"scalars.{name}" for name in _PARAMETERS if name not in result["scalars"]]
