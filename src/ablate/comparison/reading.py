"""A study on disk with its tables, as comparisons and notebooks read it."""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from ablate.analysis import FramePictures, comparison_table, paired_table
from ablate.comparison.answers import Answers, answers
from ablate.comparison.results import pictures, scored_frames
from ablate.comparison.usable_runs import UsableRuns, usable_runs
from ablate.runs.data_set import DataSet
from ablate.runs.job import COMPARISON
from ablate.runs.run import Run
from ablate.settings.study import StudySettings
from ablate.storage import read_json

SWEEP = ("runs/quick-fetal",)  # where `make sweep` leaves its study
ANSWER = ("runs/answer", "docs/results/answer")  # where `make answer` leaves its study, and where it is kept


@dataclass(frozen=True, eq=False)
class Study:
    """A study on disk with at least one run that can be used; tables are made when they are first asked for."""

    folder: Path
    usable: UsableRuns
    reference: str  # what its variants are compared with
    per_image: pd.DataFrame  # as `comparison_table` takes it, like `scalars`
    scalars: pd.DataFrame

    @property
    def runs(self) -> tuple[Run, ...]:
        return self.usable.runs

    @cached_property
    def table(self) -> pd.DataFrame:
        return comparison_table(self.per_image, self.scalars, self.reference)

    @cached_property
    def paired(self) -> pd.DataFrame:
        return paired_table(self.per_image, self.reference)

    @cached_property
    def pictures(self) -> list[FramePictures]:
        return pictures(self.runs, self.reference)

    @cached_property
    def answers(self) -> Answers:
        return answers(self.usable.all, self.table, self.reference)

    @property
    def data(self) -> DataSet:
        return self.runs[0].data_set

    @property
    def settings(self) -> StudySettings:
        """The settings of one of its runs, where they lie now; scene, probe and simulator are the same for all."""
        return self.runs[0].settings


def open_study(places: Sequence[str] = SWEEP, made_by: str = "make sweep") -> Study:
    """Open the study named by the environment variable ABLATE_STUDY, or the first of `places`, here or one folder up.

    Without one a SystemExit names the command that makes it, so that a notebook stops without a traceback.
    """
    named = os.environ.get("ABLATE_STUDY")
    folders = [Path(named)] if named else [Path(up) / place for up in (".", "..") for place in places]
    for folder in folders:
        reference = StudySettings.reference
        with suppress(OSError, ValueError, KeyError):  # not compared yet, or a damaged file
            reference = str(read_json(folder / COMPARISON / "made_from.json")["reference"])
        usable = usable_runs(folder.resolve(), reference)
        if usable.runs:
            return Study(folder.resolve(), usable, reference, *scored_frames(usable.runs))
    advice = f"Run `{made_by}` first, or name another by the environment variable ABLATE_STUDY."
    raise SystemExit(f"There is no finished study at {folders[0]}. {advice}")
