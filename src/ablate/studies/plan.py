"""What would run, what is done, and how long the rest will take."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from ablate.studies.data import dataset_folder
from ablate.studies.identity import finished
from ablate.studies.preflight import check
from ablate.studies.results import finished_runs
from ablate.studies.sweep import ConfigurationError, Job
from ablate.training import LAST, read_checkpoint


def plan(jobs: Sequence[Job]) -> int:
    """Print the table of jobs, the time expected for what is missing, and the data they read; start nothing."""
    check(jobs)
    table = planned(jobs)
    shown = table.assign(
        done=table["done"].map("{:.0%}".format),
        expected=[duration(s) for s in table["seconds"]],
    )
    print(shown.drop(columns="seconds").to_string(index=False))
    print(f"\n{_rest(table)}")
    for study in dict.fromkeys(job.settings.study_dir for job in jobs):
        print(f"runs: {study}")
    for folder in dict.fromkeys(dataset_folder(job.settings) for job in jobs):
        print(f"data: {folder} ({'there' if (folder / 'about.json').exists() else 'to be simulated'})")
    return 0


def planned(jobs: Sequence[Job]) -> pd.DataFrame:
    """One row a job.

    The time of a job is the median of the finished runs of its label in its study, or of all runs there; a run that was
    resumed tells no time.

    Returns
    -------
    DataFrame
        Columns job; state, `finished`, `resumes` or `missing`; done, the share of the steps trained; seconds, expected
        of what is left, NaN where no run tells.
    """
    measured = _measured(jobs)
    rows = []
    for job in jobs:
        checkpoint = job.folder / LAST
        state, done = "missing", 0.0
        if finished(job) is not None:
            state, done = "finished", 1.0
        elif checkpoint.exists():
            state, done = "resumes", _steps_done(checkpoint) / job.settings.training.steps
        here = measured[measured["study"] == str(job.settings.study_dir)]
        alike = here[here["label"] == job.label]
        told = (alike if len(alike) else here)["seconds"].median()
        rows.append({"job": job.name, "state": state, "done": done, "seconds": told * (1 - done) if done < 1 else 0.0})
    return pd.DataFrame(rows)


def _steps_done(checkpoint: Path) -> int:
    try:
        return int(read_checkpoint(checkpoint)["steps_done"])
    except ValueError as error:
        raise ConfigurationError(str(error)) from error


def duration(seconds: float) -> str:
    """A time as people say it, `1 h 05 min`; `?` for NaN."""
    if seconds != seconds:
        return "?"
    minutes = round(seconds / 60)
    if minutes == 0:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _measured(jobs: Sequence[Job]) -> pd.DataFrame:
    """Seconds of every finished run that was not resumed, with its label, of the studies of these jobs."""
    rows = [
        {"study": str(study), "label": run.label, "seconds": run.result["scalars"]["seconds"]}
        for study in {job.settings.study_dir for job in jobs}
        for run in finished_runs(study)
        if "seconds" in run.result["scalars"]
    ]
    return pd.DataFrame(rows, columns=["study", "label", "seconds"])


def _rest(table: pd.DataFrame) -> str:
    left = table[table["state"] != "finished"]
    if left.empty:
        return f"all {len(table)} jobs are finished"
    text = f"{len(left)} of {len(table)} jobs are left"
    if left["seconds"].isna().any():
        return f"{text}; how long they take is not known before the first run of this study has finished"
    return (
        f"{text}: about {duration(left['seconds'].sum())} one after another, pairs that are to be simulated not counted"
    )
