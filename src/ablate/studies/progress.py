"""What `task=plan` prints: which jobs are finished, which are left, and how long these will take."""

import sys
from collections.abc import Sequence

import pandas as pd

from ablate.studies.comparison.results import finished_runs
from ablate.studies.identity import finished
from ablate.studies.jobs.job import Job
from ablate.studies.pairs.data import dataset_folder
from ablate.training import LAST, read_checkpoint


def show_progress(jobs: Sequence[Job]) -> int:
    """Print the table of jobs, the time that the rest is expected to take, and the folders; start nothing."""
    table = progress(jobs)
    shown = table.assign(done=table["done"].map("{:.0%}".format), expected=table["seconds"].map(duration))
    print(shown.drop(columns="seconds").to_string(index=False))
    print(f"\n{_rest(table)}")
    for study in dict.fromkeys(job.settings.study_dir for job in jobs):
        print(f"runs: {study}")
    for folder in dict.fromkeys(dataset_folder(job.settings) for job in jobs):
        print(f"data: {folder} ({'there' if (folder / 'about.json').exists() else 'to be simulated'})")
    return 0


def progress(jobs: Sequence[Job]) -> pd.DataFrame:
    """One row a job: job; state, `finished`, `resumes`, `missing` or `damaged`; done, share of the steps; seconds left.

    The time of a job is the median of the finished runs of its label in its study, or of all runs there, or else NaN.
    A run that was resumed tells no time.
    """
    told_by = [
        {"study": str(study), "label": run.label, "seconds": run.result["scalars"]["seconds"]}
        for study in {job.settings.study_dir for job in jobs}
        for run in finished_runs(study)
        if "seconds" in run.result["scalars"]
    ]
    measured = pd.DataFrame(told_by, columns=["study", "label", "seconds"])
    rows = []
    for job in jobs:
        checkpoint = job.folder / LAST
        state, done = "missing", 0.0
        if finished(job) is not None:
            state, done = "finished", 1.0
        elif checkpoint.exists():
            try:
                state, done = "resumes", read_checkpoint(checkpoint)["steps_done"] / job.settings.training.steps
            except ValueError as error:
                state = "damaged"
                print(error, file=sys.stderr)
        here = measured[measured["study"] == str(job.settings.study_dir)]
        alike = here[here["label"] == job.label]
        told = (alike if len(alike) else here)["seconds"].median()
        rows.append({"job": job.name, "state": state, "done": done, "seconds": told * (1 - done) if done < 1 else 0.0})
    return pd.DataFrame(rows)


def duration(seconds: float) -> str:
    """A time in words, such as `1 h 05 min`; `?` for NaN."""
    if seconds != seconds:
        return "?"
    minutes = round(seconds / 60)
    if minutes == 0:
        return f"{seconds:.0f} s"
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


def _rest(table: pd.DataFrame) -> str:
    left = table[table["state"] != "finished"]
    if left.empty:
        return f"all {len(table)} jobs are finished"
    text = f"{len(left)} of {len(table)} jobs are left"
    if left["seconds"].isna().any():
        return f"{text}; how long they take is not known before the first run of this study has finished"
    together = duration(left["seconds"].sum())
    return f"{text}: about {together} one after another, pairs that are to be simulated not counted"
