"""What each `task=` does."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

import pandas as pd

from ablate.config import Task
from ablate.studies.compare import compare_study
from ablate.studies.data import dataset_folder, maps_needed, prepare_data
from ablate.studies.identity import finished
from ablate.studies.preflight import check
from ablate.studies.sweep import Job
from ablate.studies.tracked import open_tracking
from ablate.studies.variants import describe as describe_variants


def study(jobs: Sequence[Job], launch: Callable[[], None]) -> int:
    """Simulate what is missing, run every job through Hydra's launcher, compare."""
    check(jobs)
    first = jobs[0].settings
    waiting = [job for job in jobs if finished(job) is None]
    code = 0
    if waiting:
        prepare_data(first, maps_needed(job.settings.model for job in jobs))
        open_tracking(first)  # the database, the experiment and the parent run exist before any job starts
        try:
            launch()
        except SystemExit as end:
            code = int(end.code) if isinstance(end.code, int) else 1
    comparison = compare_study(first, changed=bool(waiting))
    print(comparison)
    failed = [job.name for job in jobs if finished(job) is None]
    if failed:
        print(f"not finished: {', '.join(failed)}; the same command takes them up again", file=sys.stderr)
    return code or int(bool(failed))


def simulate(jobs: Sequence[Job]) -> int:
    """Only the pairs that the jobs read."""
    check(jobs)
    settings = jobs[0].settings
    data = prepare_data(settings, maps_needed(job.settings.model for job in jobs))
    print(f"{len(data.pairs)} frames in {data.pairs.folder}; a look at them: contact_sheet.png there")
    return 0


def describe(jobs: Sequence[Job]) -> int:
    """The table of variants, whole whatever the width of the terminal."""
    table = describe_variants(jobs)
    yes_no = {True: "yes", False: "no"}
    for column in ("att", "concat", "conv"):
        table[column] = table[column].map(yes_no)
    numbers = [c for c in table.columns if c in ("generator", "discriminator") or c.startswith("total")]
    print(table.to_string(index=False, formatters=dict.fromkeys(numbers, "{:,}".format)))
    print("\ngenerator, discriminator, total: parameters at the paper's width (model.width=1).")
    return 0


def plan(jobs: Sequence[Job]) -> int:
    """What would run and what is done."""
    check(jobs)
    rows = []
    for job in jobs:
        done = finished(job)
        state = "finished" if done else "resumes" if (job.folder / "last.ckpt").exists() else "missing"
        seconds = f"{done['seconds']:.0f}" if done else ""
        rows.append({"job": job.name, "state": state, "seconds": seconds, "folder": str(job.folder)})
    print(pd.DataFrame(rows).to_string(index=False))
    first = jobs[0].settings
    folder = dataset_folder(first)
    state = "there" if (folder / "about.json").exists() else "to be simulated"
    print(f"\ndata: {folder} ({state})")
    return 0


def compare(jobs: Sequence[Job]) -> int:
    """Tables, figures and statistics of the study, rebuilt from what is on disk."""
    check(jobs)
    print(compare_study(jobs[0].settings, changed=True))
    return 0


TASKS: dict[Task, Callable[[Sequence[Job]], int]] = {
    Task.simulate: simulate,
    Task.describe: describe,
    Task.plan: plan,
    Task.compare: compare,
}
