"""What each `task=` does."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from ablate.config import StudySettings, Task
from ablate.studies.compare import compare_study
from ablate.studies.data import dataset_folder, dataset_hash, drop_damaged, made_data, maps_needed, prepare_data
from ablate.studies.identity import finished
from ablate.studies.plan import plan
from ablate.studies.precision import precision
from ablate.studies.preflight import check
from ablate.studies.preview import preview
from ablate.studies.stability import stability
from ablate.studies.sweep import ConfigurationError, Job
from ablate.studies.tracked import open_tracking
from ablate.studies.variants import describe as describe_variants
from ablate.tracking import RunLog, Status


def study(jobs: Sequence[Job], launch: Callable[[], None], elsewhere: bool = False) -> int:
    """Simulate what is missing, run every job through Hydra's launcher, compare.

    Jobs that run elsewhere simulate too: the login node of a cluster is no place to compute.
    """
    check(jobs)
    waiting = [job for job in jobs if finished(job) is None]
    if waiting:
        if not elsewhere:
            _simulate_for(waiting)  # what is wrong with a mesh shows here, before anything is tracked
        for settings in _studies(waiting):
            open_tracking(settings)  # database, experiment and parent run exist before any job starts
        _started(launch)
    for settings in _studies([job for job in jobs if finished(job) is not None]):
        print(compare_study(settings))
    failed = [job for job in jobs if finished(job) is None]
    for settings in _studies(failed):
        RunLog(*open_tracking(settings)).end(Status.failed)
    if failed:
        names = ", ".join(job.name for job in failed)
        print(f"not finished: {names}; the same command takes them up again", file=sys.stderr)
    return int(bool(failed))


def simulate(jobs: Sequence[Job], launch: Callable[[], None] | None = None) -> int:
    """Only the pairs that the jobs read, made here or, side by side, by the jobs that a launcher starts elsewhere.

    Those that are there are checked, and made again where they are damaged.
    """
    check(jobs)
    sets = _data_sets(jobs)
    for settings, maps in sets:
        for damaged in drop_damaged(settings, maps):
            print(damaged, file=sys.stderr)
    if launch is None:
        _simulate_for(jobs)
    else:
        _started(launch)
    code = 0
    for settings, maps in sets:
        folder = dataset_folder(settings)
        if made := made_data(settings, maps):
            print(f"{len(made.pairs)} frames in {folder}; a look at them: contact_sheet.png there")
        else:
            print(f"not finished: {folder}; the same command takes it up again", file=sys.stderr)
            code = 1
    return code


def _started(launch: Callable[[], None]) -> None:
    """Hydra exits where it gave a job up; what is on disk tells whether a cluster has not taken it up again."""
    with suppress(SystemExit):
        launch()


def _data_sets(jobs: Sequence[Job]) -> list[tuple[StudySettings, frozenset[str]]]:
    """Every data set that the jobs read, with the maps that at least one of them does."""
    sets: dict[str, list[Job]] = {}
    for job in jobs:
        sets.setdefault(dataset_hash(job.settings), []).append(job)
    return [(js[0].settings, maps_needed(j.settings.model for j in js)) for js in sets.values()]


def _simulate_for(jobs: Sequence[Job]) -> None:
    try:
        for settings, maps in _data_sets(jobs):
            prepare_data(settings, maps)
    except (ValueError, OSError) as error:  # a mesh with a hole, more frames than poses, a full disk, ...
        raise ConfigurationError(str(error)) from error


def _studies(jobs: Sequence[Job]) -> list[StudySettings]:
    """The settings of the first job of every study among them."""
    first: dict[Path, StudySettings] = {}
    for job in jobs:
        first.setdefault(job.settings.study_dir, job.settings)
    return list(first.values())


def describe(jobs: Sequence[Job]) -> int:
    """The table of variants, whole whatever the width of the terminal."""
    table = describe_variants(jobs)
    yes_no = {True: "yes", False: "no"}
    for column in ("att", "concat", "conv"):
        table[column] = table[column].map(yes_no)
    numbers = [c for c in table.columns if c in ("generator", "discriminator") or c.startswith("total")]
    print(table.to_string(index=False, formatters=dict.fromkeys(numbers, "{:,}".format)))
    print("\ngenerator, discriminator, total: parameters at the paper's width (model.width=1).")
    read = maps_needed(job.settings.model for job in jobs)
    print(f"maps simulated for {', '.join(dict.fromkeys(j.label for j in jobs))}: {', '.join(sorted(read))}")
    if "low" not in read:
        print("left out: low, the low-quality image; none of these variants reads it")
    return 0


def compare(jobs: Sequence[Job]) -> int:
    """Tables, figures and statistics of the study, rebuilt from what is on disk."""
    check(jobs)
    for settings in _studies(jobs):
        print(compare_study(settings, rebuild=True))
    return 0


TASKS: dict[Task, Callable[[Sequence[Job]], int]] = {
    Task.simulate: simulate,
    Task.describe: describe,
    Task.plan: plan,
    Task.compare: compare,
    Task.preview: preview,
    Task.precision: precision,
    Task.stability: stability,
}
