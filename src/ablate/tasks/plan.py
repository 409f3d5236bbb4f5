"""What `task=plan` prints: which jobs are finished, which are left, and how long these will take."""

import sys
from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path

import pandas as pd

from ablate.command.compose import without_repetitions
from ablate.settings.study import refusing
from ablate.sources.source import source_of
from ablate.study.job import Job
from ablate.study.training import State, trainings_in
from ablate.tasks.study import data_sets
from ablate.training import read_checkpoint

_FINISHED = "finished"


def show_progress(jobs: Sequence[Job]) -> int:
    """Print the table of jobs, the time that the rest is expected to take, and the folders; start nothing."""
    table = progress(jobs)
    shown = table.assign(done=table["done"].map("{:.0%}".format), expected=table["seconds"].map(duration))
    print(shown.drop(columns="seconds").to_string(index=False))
    print(f"\n{_rest(table)}")
    for study in dict.fromkeys(job.settings.study_dir for job in jobs):
        print(f"runs: {study}")
    with refusing():  # a data set that is damaged
        for job, maps in data_sets(jobs):
            is_there = not job.data.lacks(source_of(job.settings).offered(maps))
            print(f"data: {job.data.folder} ({'there' if is_there else 'to be simulated'})")
    return 0


def progress(jobs: Sequence[Job]) -> pd.DataFrame:
    """One row a job: job; state, one of `State` or `finished`; done, share of the steps; seconds left.

    The time of a step is the median of the trainings of its label in its study, or of all trainings there, or else NaN.
    A training that was resumed tells no time.
    """
    times: dict[Path, pd.DataFrame] = {}
    rows = []
    for job in without_repetitions(jobs):
        study_dir = job.settings.study_dir
        if study_dir not in times:
            times[study_dir] = _times_in(study_dir)
        known = times[study_dir]
        alike = known["seconds"][known["label"] == job.label]
        seconds = (alike if len(alike) else known["seconds"]).median() * job.settings.training.steps
        state, done = _state_of(job)
        rows.append({"job": job.name, "state": state, "done": done, "seconds": seconds * (1 - done) if done < 1 else 0})
    return pd.DataFrame(rows)


def _times_in(study_dir: Path) -> pd.DataFrame:
    """How long a step of the trainings of a study took: label and seconds."""
    finished = [training for training in trainings_in(study_dir) if training.is_trained]
    rows = [
        (one.label, one.result["scalars"]["train/seconds"] / one.identity["training"]["steps"])
        for one in finished
        if "train/seconds" in one.result["scalars"]
    ]
    return pd.DataFrame(rows, columns=["label", "seconds"]).astype({"seconds": float})


def _state_of(job: Job) -> tuple[str, float]:
    """The state of a job and the share of its steps that are done."""
    if job.finished:
        return _FINISHED, 1.0
    training = job.training
    if training.state is not State.resumable:
        return training.state, float(training.is_trained)
    try:
        return State.resumable, read_checkpoint(training.checkpoint)["steps_done"] / job.settings.training.steps
    except ValueError as error:
        print(error, file=sys.stderr)
        return State.unusable, 0.0


def duration(seconds: float) -> str:
    """Hours, minutes and seconds, such as `1:05:00`; `?` for NaN."""
    return "?" if seconds != seconds else str(timedelta(seconds=round(seconds)))


def _rest(table: pd.DataFrame) -> str:
    left = table[table["state"] != _FINISHED]
    if left.empty:
        return f"all {len(table)} jobs are finished" if len(table) > 1 else "1 job, which is finished"
    text = f"{len(left)} of {len(table)} jobs are left" if len(table) > 1 else "1 job is left"
    if left["seconds"].isna().any():
        return f"{text}; how long they take is not known before the first run of this study has finished"
    together = duration(left["seconds"].sum())
    return f"{text}: about {together} one after another, pairs that are to be simulated not counted"
