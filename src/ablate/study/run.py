"""A training with the scores that a study shows of it, and the list of them that a comparison is a view of."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd

from ablate.metrics.metric import SCORE_COLUMNS
from ablate.setting import check_name
from ablate.settings.study import StudySettings
from ablate.storage import known_json, write_json
from ablate.study.job import Job
from ablate.study.scores import Score, is_whole, read_score
from ablate.study.training import Training, trainings_in

_LOG = logging.getLogger(__name__)
COMPARISON = "comparison"  # folder of a study beside its trainings
LIST = "jobs.json"  # in it


@dataclass(frozen=True, eq=False)
class Run:
    """A finished training and some of its scores, under the label that the study has for it."""

    training: Training
    label: str
    changed: dict[str, Any]  # the dotted keys that the label says were changed beside the variant, with their values
    score_names: tuple[str, ...]  # of files

    @property
    def seed(self) -> int:
        return self.training.seed

    @property
    def name(self) -> str:
        return f"{self.label}/seed{self.seed}"

    @property
    def identity(self) -> dict[str, Any]:
        return self.training.identity

    @property
    def data(self) -> str:
        """The name of its pairs."""
        return self.training.data_set.name

    @property
    def pixels(self) -> str:
        """The digest of the frames that it was scored on, as far as the names of its scores tell it."""
        return self.score_names[0].removesuffix(".parquet").rpartition("-")[2]

    @cached_property
    def _scores(self) -> list[Score]:
        return [read_score(self.training.scores / name) for name in self.score_names]

    @cached_property
    def scores(self) -> pd.DataFrame:
        """One row a metric of a frame; with the columns of `metrics.SCORE_COLUMNS`, source, split, variant and seed."""
        tables = [score.values for score in self._scores if len(score.values)]
        empty = pd.DataFrame(columns=[*SCORE_COLUMNS, "source", "split"])
        table = pd.concat(tables, ignore_index=True) if tables else empty
        return table.assign(variant=self.label, seed=self.seed)

    @cached_property
    def scalars(self) -> dict[str, float]:
        """What its training cost, and every score over all frames, by name: `test/psnr`, `train/seconds`, ..."""
        scalars = dict(self.training.result["scalars"])
        for score in self._scores:
            scalars |= score.scalars
        return scalars

    @property
    def first_scored(self) -> str:
        """When the first of its scores was computed, as ISO 8601."""
        return min(score.scored for score in self._scores)

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out, or is wrong with its images, a sentence each."""
        told = [*(note for score in self._scores for note in score.notes), *self.training.result["notes"]]
        return tuple(dict.fromkeys(told))


@dataclass(frozen=True)
class RunList:
    """The runs that a comparison is a view of."""

    folder: Path  # of the study
    runs: tuple[Run, ...]
    unfinished: tuple[str, ...]  # names of jobs that are not, and why
    reference: str
    unread: tuple[dict[str, Any], ...] = ()  # entries of the list on disk whose files are missing or damaged; they stay


def run_of(job: Job) -> Run:
    """The run of a finished job."""
    return Run(job.training, job.label, dict(job.changed), tuple(key.file_name for key in job.wanted))


def listed_runs(jobs: Sequence[Job]) -> RunList:
    """The runs of the jobs of one study, which train something else each."""
    runs, unfinished = [], []
    for job in jobs:
        if job.finished:
            runs.append(run_of(job))
        else:
            unfinished.append(_unfinished(job))
    settings = jobs[0].settings
    return RunList(settings.study_dir, tuple(runs), tuple(unfinished), settings.reference)


def trained_runs(study_dir: Path) -> tuple[Run, ...]:
    """Everything in the folder of a study that is trained, with what it was scored on its own frames."""
    runs = []
    for training in trainings_in(study_dir):
        if training.is_trained and not training.folder.is_symlink():
            own = f"-{training.pixels[:8]}.parquet"
            names = tuple(path.name for path in training.score_files() if path.name.endswith(own) and is_whole(path))
            if names:
                runs.append(Run(training, training.label, training.changed, names))
    return tuple(runs)


def _unfinished(job: Job) -> str:
    training = job.training
    if training.is_trained:
        lacking = ", ".join(key.metric for key in training.lacking(job.wanted))
        return f"{job.name} (not scored: {lacking})"
    return f"{job.name} ({training.why})" if training.why not in ("", "not finished") else job.name


def write_list(folder: Path, listed: RunList) -> None:
    """Keep in the folder of a comparison which runs it is of."""
    jobs = [
        {"training": run.training.folder.name, "label": run.label, "changed": run.changed, "scores": run.score_names}
        for run in listed.runs
    ]
    write_json(folder / LIST, {"reference": listed.reference, "jobs": [*jobs, *listed.unread]})


def read_list(study_dir: Path) -> RunList:
    """The runs that the comparison on disk is of, those of them that can still be read; empty where there is none.

    The file may come from anybody: names of folders and files lead nowhere else.
    """
    content = known_json(study_dir / COMPARISON / LIST)
    jobs = content.get("jobs")
    runs, unfinished, unread = [], [], []
    for entry in jobs if isinstance(jobs, list) else []:
        try:
            run = _listed_run(study_dir, entry)
        except (KeyError, TypeError, ValueError) as error:
            _LOG.warning("%s: a job cannot be read: %s", study_dir / COMPARISON / LIST, error)
            continue
        if run.training.is_trained and all(is_whole(run.training.scores / name) for name in run.score_names):
            runs.append(run)
        else:
            unread.append(entry)
            unfinished.append(f"{run.training.folder.name} ({run.training.why or 'without all of its scores'})")
    reference = content.get("reference", StudySettings.reference)
    return RunList(study_dir, tuple(runs), tuple(unfinished), str(reference), tuple(unread))


def _listed_run(study_dir: Path, entry: Mapping[str, Any]) -> Run:
    folder, label = str(entry["training"]), str(entry["label"])
    names = tuple(str(name) for name in entry["scores"])
    check_name("variant", label)
    for name in (folder, *names):
        if not names or Path(name).name != name:
            raise ValueError(f"{name} is no name of a file")
    if (study_dir / folder).is_symlink():
        raise ValueError(f"{folder} is a link")
    return Run(Training(study_dir / folder), label, dict(entry["changed"]), names)
