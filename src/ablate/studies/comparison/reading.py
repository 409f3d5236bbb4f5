"""Open a finished study for reading; the notebooks use this."""

import json
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd

from ablate.analysis import FramePictures, comparison_table
from ablate.config import StudySettings, build
from ablate.studies.comparison.results import Finished, data_of, pictures, scored_frames
from ablate.studies.comparison.usable_runs import usable_runs
from ablate.studies.pairs.data import Data

DEFAULT_STUDY = "runs/quick-fetal"  # where `make sweep` leaves its study


@dataclass(frozen=True, eq=False)
class Study:
    """A study on disk with at least one run that can be used."""

    folder: Path
    runs: tuple[Finished, ...]
    reference: str  # what it was last compared with
    per_image: pd.DataFrame  # as `comparison_table` takes it, like `scalars`
    scalars: pd.DataFrame

    @cached_property
    def table(self) -> pd.DataFrame:
        return comparison_table(self.per_image, self.scalars, self.reference)

    @cached_property
    def pictures(self) -> list[FramePictures]:
        return pictures(self.runs, self.reference)

    @property
    def data(self) -> Data:
        return data_of(self.runs)

    @property
    def settings(self) -> StudySettings:
        """The settings of one of its runs; scene, probe and simulator are the same for all."""
        return build(StudySettings, self.runs[0].spec["settings"])


def open_study() -> Study:
    """Open the study named by the environment variable ABLATE_STUDY, or that of `make sweep`, here or one folder up.

    Without one a SystemExit names the command that makes it, so that a notebook stops without a traceback.
    """
    named = os.environ.get("ABLATE_STUDY")
    places = [Path(named)] if named else [Path(DEFAULT_STUDY), Path("..") / DEFAULT_STUDY]
    for folder in places:
        marker = folder / "comparison" / "made_from.json"
        reference = json.loads(marker.read_text())["reference"] if marker.exists() else StudySettings.reference
        runs = usable_runs(folder.resolve(), reference).runs
        if runs:
            return Study(folder.resolve(), runs, reference, *scored_frames(runs))
    advice = "Run `make sweep` first, or name another by the environment variable ABLATE_STUDY."
    raise SystemExit(f"There is no finished study at {places[0]}. {advice}")
