"""A study on disk as notebooks and users read it: `ablate.open_study`."""

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from ablate.analysis import RESIMULATION, FramePictures, StudyResults
from ablate.study.comparable import ComparableRuns, comparable_runs
from ablate.study.reading import pictures, results_of, table_of_runs
from ablate.study.run import RunList, read_list

SWEEP = ("runs/quick-fetal",)  # where `make sweep` leaves its study
ANSWER = ("runs/full_model", "docs/results/full_model")  # where `make answer` leaves its study, and where it is kept


@dataclass(frozen=True, eq=False)
class Study:
    """A study on disk with at least one run that can be used; tables are made when they are first asked for.

    `listed` are the runs that it is of, and `usable` those that can be compared, and what was left aside and why.
    """

    listed: RunList
    usable: ComparableRuns

    @property
    def folder(self) -> Path:
        return self.listed.folder

    @property
    def reference(self) -> str:
        """The variant that the others are compared with."""
        return self.listed.reference

    @cached_property
    def results(self) -> StudyResults:
        """Scores and what follows from them: tables, effects, verdicts; see `analysis.StudyResults`."""
        return results_of(self.usable, self.reference, self.folder.name)

    @property
    def per_image(self) -> pd.DataFrame:
        """Columns variant, seed, frame, site, metric, value, ...: one row a metric of a test frame of a run.

        The variant `re-simulation` is the same frames simulated again.
        """
        return self.results.per_image

    @property
    def table(self) -> pd.DataFrame:
        """Mean and spread of every metric of every variant; see `analysis.comparison_table`."""
        return self.results.table

    @property
    def floor(self) -> pd.DataFrame:
        """The rows of `table` that are of the re-simulation, by metric."""
        return self.table[self.table["variant"] == RESIMULATION].set_index("metric").drop(columns="variant")

    @cached_property
    def runs(self) -> pd.DataFrame:
        """One row a run: variant, seed, data, its components, and its mean of every metric."""
        return table_of_runs(self.usable.all)

    @property
    def verdicts(self) -> pd.DataFrame:
        """One row a component: effect, interval, band and verdict; see `analysis.verdict_table`."""
        return self.results.verdicts

    @cached_property
    def pictures(self) -> list[FramePictures]:
        """Test frames as (H, W) arrays: target, maps, and what each variant rendered."""
        return pictures(self.usable.runs, self.reference)


def open_study(path: str | Path) -> Study:
    """Open a study, such as `runs/quick-fetal`, to read what it came to; see `Study`.

    A folder without a finished run that can be used is a FileNotFoundError, which says why.

    Examples
    --------
    >>> study = ablate.open_study("runs/quick-fetal")  # doctest: +SKIP
    >>> study.per_image.query("metric == 'psnr_fan'").groupby("variant")["value"].mean()  # doctest: +SKIP
    >>> study.verdicts[["component", "effect", "lower", "upper", "verdict"]]  # doctest: +SKIP
    """
    listed = read_list(Path(path).resolve())
    usable = comparable_runs(listed)
    if not usable.runs:
        raise FileNotFoundError(" ".join([f"There is no finished study at {path}.", *usable.notes]))
    return Study(listed, usable)


def found_study(places: Sequence[str] = SWEEP, made_by: str = "make sweep") -> Study:
    """Open the study named by the environment variable ABLATE_STUDY, or the first of `places`, here or one folder up.

    What was left aside is printed. Without a study a SystemExit names the command that makes it: no traceback.
    """
    named = os.environ.get("ABLATE_STUDY")
    folders = [named] if named else [f"{up}/{place}" for up in (".", "..") for place in places]
    for folder in folders:
        with suppress(FileNotFoundError):
            study = open_study(folder)
            for note in study.usable.notes:
                tqdm.write(note)
            return study
    advice = f"Run `{made_by}` first, or name another by the environment variable ABLATE_STUDY."
    raise SystemExit(f"There is no finished study at {folders[0]}. {advice}")
