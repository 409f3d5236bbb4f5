"""What `task=plan` prints: which jobs are finished, which are left, and how long these will take."""

import sys
from collections.abc import Sequence
from datetime import timedelta

import pandas as pd

from ablate.comparison.usable_runs import check_alike
from ablate.runs.job import Job
from ablate.runs.place import finished_run
from ablate.runs.run import State, runs_of
from ablate.training import read_checkpoint


def show_progress(jobs: Sequence[Job]) -> int:
    """Print the table of jobs, the time that the rest is expected to take, and the folders; start nothing."""
    table = progress(jobs)
    shown = table.assign(done=table["done"].map("{:.0%}".format), expected=table["seconds"].map(duration))
    print(shown.drop(columns="seconds").to_string(index=False))
    print(f"\n{_rest(table)}")
    for study in dict.fromkeys(job.settings.study_dir for job in jobs):
        print(f"runs: {study}")
    for data in dict.fromkeys(job.data for job in jobs):
        print(f"data: {data.folder} ({'there' if data.exists else 'to be simulated'})")
    return 0


def progress(jobs: Sequence[Job]) -> pd.DataFrame:
    """One row a job: job; state, one of `State`; done, share of the steps; seconds left.

    The time of a job is the median of the finished runs of its label in its study, or of all runs there, or else NaN.
    A run that was resumed tells no time.
    """
    studies = dict.fromkeys(job.settings.study_dir for job in jobs)
    finished = {study: [run for run in runs_of(study) if run.state is State.finished] for study in studies}
    for runs in finished.values():
        check_alike(runs)
    rows = []
    for job in jobs:
        state, done = _state_of(job)
        here = finished[job.settings.study_dir]
        alike = [run for run in here if run.label == job.label and "seconds" in run.result["scalars"]]
        told = pd.Series([run.result["scalars"].get("seconds") for run in alike or here], dtype=float).median()
        rows.append({"job": job.name, "state": state, "done": done, "seconds": told * (1 - done) if done < 1 else 0.0})
    return pd.DataFrame(rows)


def _state_of(job: Job) -> tuple[str, float]:
    """The state of a job's run and the share of its steps that are done."""
    if finished_run(job) is not None:
        return State.finished, 1.0
    run = job.run
    if not run.checkpoint.exists():
        return State.missing, 0.0
    try:
        return State.resumable, read_checkpoint(run.checkpoint)["steps_done"] / job.settings.training.steps
    except ValueError as error:
        print(error, file=sys.stderr)
        return State.unusable, 0.0


def duration(seconds: float) -> str:
    """Hours, minutes and seconds, such as `1:05:00`; `?` for NaN."""
    return "?" if seconds != seconds else str(timedelta(seconds=round(seconds)))


def _rest(table: pd.DataFrame) -> str:
    left = table[table["state"] != "finished"]
    if left.empty:
        return f"all {len(table)} jobs are finished" if len(table) > 1 else "1 job, which is finished"
    text = f"{len(left)} of {len(table)} jobs are left" if len(table) > 1 else "1 job is left"
    if left["seconds"].isna().any():
        return f"{text}; how long they take is not known before the first run of this study has finished"
    together = duration(left["seconds"].sum())
    return f"{text}: about {together} one after another, pairs that are to be simulated not counted"
