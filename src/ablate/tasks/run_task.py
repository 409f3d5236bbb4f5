"""What each `task=` does with the jobs of a command line. A task imports the rooms that it needs when it starts."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name

from ablate.dataset import remove_damaged
from ablate.jobs.describe import description
from ablate.jobs.launch import Launch
from ablate.jobs.preflight import check
from ablate.runs.data_set import maps_needed
from ablate.runs.job import Job
from ablate.runs.place import claim_place, finished_run, forget_scores, sources_of
from ablate.runs.prepare import offered, prepare_data
from ablate.runs.run import State, runs_of
from ablate.settings.study import ConfigurationError, SceneKind, StudySettings, Task, refusing

#: The function of each task that starts no jobs.
_LOOKING = {
    Task.describe: "ablate.tasks.run_task:describe",
    Task.compare: "ablate.tasks.run_task:compare",
    Task.plan: "ablate.tasks.plan:show_progress",
    Task.preview: "ablate.tasks.render:preview",
    Task.render: "ablate.tasks.render:render",
    Task.view: "ablate.viewer.task:view",
    Task.export: "ablate.tasks.export:export",
    Task.precision: "ablate.numerics.precision.task:precision",
    Task.stability: "ablate.numerics.stability.task:stability",
}


def run_task(jobs: Sequence[Job], launch: Launch) -> int:
    """Check every job of a command line, do its task and return the exit code."""
    task = jobs[0].settings.task
    if task is not Task.describe:
        check(jobs, elsewhere=launch.elsewhere)
    if task in (Task.study, Task.simulate):
        try:
            return study(jobs, launch) if task is Task.study else simulate(jobs, launch)
        except (OSError, MemoryError, KeyboardInterrupt) as error:
            error.add_note("the same command continues where it stopped")
            raise
    if task not in (Task.describe, Task.compare, Task.plan) and len({job.data.folder for job in jobs}) > 1:
        raise ConfigurationError(f"task={task}: a sweep over data sets; allowed is one data set")
    return int(resolve_name(_LOOKING[task])(jobs))


def study(jobs: Sequence[Job], launch: Launch) -> int:
    """Simulate what is missing, run every job that is not finished, compare.

    Jobs that run elsewhere simulate their own pairs, because a cluster's login node is not for computing. Nor is it for
    timing: `task=compare` on another node does that.
    """
    from ablate.runs.train import run_job

    forget_scores(jobs)
    if waiting := [job for job in jobs if finished_run(job) is None]:
        if not launch.elsewhere:
            _simulate_for(waiting)  # so that a mesh that cannot be used is refused before anything is tracked
        for job in {job.settings.study_dir: job for job in reversed(waiting)}.values():
            claim_place(job)  # of two commands that start a study with two configurations, the second stops here
    with _parents_of(waiting):
        if waiting:
            launch.start(waiting, run_job)
        if launch.compares:
            from ablate.comparison.compare import compare_study

            for settings in _studies([job for job in jobs if finished_run(job) is not None]):
                print(compare_study(settings, time_here=not launch.elsewhere))
    if failed := [job for job in waiting if finished_run(job) is None]:
        names = ", ".join(job.name for job in failed)
        print(f"not finished: {names}; the same command takes them up again", file=sys.stderr)
    return int(bool(failed))


@contextmanager
def _parents_of(jobs: Sequence[Job]) -> Iterator[None]:
    """Say in the store that the studies run, before any job starts, and how they have ended when all have."""
    from ablate.runs.store_copy import mark_study
    from ablate.tracking import Status

    studies = _studies(jobs)
    for settings in studies:
        mark_study(settings, Status.running)
    try:
        yield
    finally:
        for settings in studies:
            of_study = [job for job in jobs if job.settings.study_dir == settings.study_dir]
            failed = any(finished_run(job) is None for job in of_study)
            mark_study(settings, Status.failed if failed else Status.finished)


def simulate(jobs: Sequence[Job], launch: Launch) -> int:
    """Simulate the pairs that the jobs read: here, or side by side in jobs that run on a cluster.

    Pairs that exist are checked, and damaged ones are made again.
    """
    for job, maps in (sets := _data_sets(jobs)):
        for damaged in remove_damaged(job.data.pairs, maps) if job.data.exists else ():
            print(damaged, file=sys.stderr)
    if launch.elsewhere:
        launch.start(jobs, lambda job: prepare_data(job, maps_needed([job.settings.model])))
    else:
        _simulate_for(jobs)
    code = 0
    for job, maps in sets:
        data = job.data
        if data.lacks(offered(job, maps)):
            print(f"not finished: {data.folder}; the same command takes it up again", file=sys.stderr)
            code = 1
        else:
            print(f"{len(data.pairs)} frames in {data.folder}; a look at them: {data.contact_sheet.name} there")
    return code


def _data_sets(jobs: Sequence[Job]) -> list[tuple[Job, frozenset[str]]]:
    """Every data set that the jobs read, as the first job that does, with the maps that at least one of them reads."""
    sets: dict[Path, list[Job]] = {}
    for job in jobs:
        sets.setdefault(job.data.folder, []).append(job)
    return [(js[0], maps_needed(j.settings.model for j in js)) for js in sets.values()]


def _simulate_for(jobs: Sequence[Job]) -> None:
    with refusing():  # a mesh with a hole, more frames than poses, a full disk, ...
        for job, maps in _data_sets(jobs):
            prepare_data(job, maps)


def _studies(jobs: Sequence[Job]) -> list[StudySettings]:
    """The settings of the first job of every study among them."""
    first: dict[Path, StudySettings] = {}
    for job in jobs:
        first.setdefault(job.settings.study_dir, job.settings)
    return list(first.values())


def describe(jobs: Sequence[Job]) -> int:
    """Print what the variants are and how large they are, in full, whatever the width of the terminal.

    For a folder without a scene.yaml, or with the empty one that a shell makes for `> scene.yaml`, print a proposal.
    """
    folder, kind = jobs[0].settings.scene.folder, jobs[0].settings.scene.kind
    there = Path(folder or "") / "scene.yaml"
    if folder and kind is not SceneKind.pairs and not (there.exists() and there.stat().st_size):
        from ablate.anatomy import proposed_scene

        with refusing():
            print(proposed_scene(Path(folder)))
        return 0
    print(description(jobs))
    read = maps_needed(job.settings.model for job in jobs)
    print(f"maps simulated for {', '.join(dict.fromkeys(j.label for j in jobs))}: {', '.join(sorted(read))}")
    if "low" not in read:
        print("left out: low, the low-quality image; none of these variants reads it")
    return 0


def compare(jobs: Sequence[Job]) -> int:
    """Make the comparison of every study anew from what is on disk."""
    from ablate.comparison.compare import compare_study

    for settings in _studies(jobs):
        print(compare_study(settings, rebuild=True))
        asked, runs = sources_of(settings.metrics), runs_of(settings.study_dir)
        done = [run.result["sources"] for run in runs if run.state is State.finished]
        stale = [name for name, source in asked.items() if any(of.get(name) != source for of in done)]
        if settings.evaluation.again or stale:
            print(f"Note: {', '.join(stale) or 'evaluation.again'}: task=compare scores nothing, task=study does.")
    return 0
