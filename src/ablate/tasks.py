"""What each `task=` does. A task imports the rooms that it needs when it starts."""

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from ablate.config import SceneKind, StudySettings, Task, refusing
from ablate.studies.identity import claim_place, finished
from ablate.studies.jobs.compose import CommandLine
from ablate.studies.jobs.describe import description
from ablate.studies.jobs.job import Job
from ablate.studies.jobs.launch import Work
from ablate.studies.jobs.preflight import check
from ablate.studies.pairs.data import dataset_folder, dataset_hash, drop_damaged, made_data, maps_needed, prepare_data


def run_task(command: CommandLine) -> int:
    """Check every job of a command line, do its task and return the exit code."""
    jobs, launch, task = command.jobs, command.launch, command.jobs[0].settings.task
    if task is not Task.describe:
        check(jobs, elsewhere=launch.cluster is not None)
    if task is Task.study:
        return study(jobs, launch, elsewhere=launch.cluster is not None)
    if task is Task.simulate:
        return simulate(jobs, launch if launch.cluster else None)
    return _look(task, jobs)


def study(jobs: Sequence[Job], launch: Callable[[Sequence[Job], Work], None], elsewhere: bool = False) -> int:
    """Simulate what is missing, run every job that is not finished, compare.

    Jobs that run elsewhere simulate their own pairs, because a cluster's login node is not for computing. Nor is it for
    timing: `task=compare` on another node does that.
    """
    from ablate.studies.comparison.compare import compare_study
    from ablate.studies.run import run_job

    if waiting := [job for job in jobs if finished(job) is None]:
        if not elsewhere:
            _simulate_for(waiting)  # so that a mesh that cannot be used is refused before anything is tracked
        for job in {job.settings.study_dir: job for job in reversed(waiting)}.values():
            claim_place(job)  # of two commands that start a study with two configurations, the second stops here
    with _parents_of(waiting):
        if waiting:
            launch(waiting, run_job)
        for settings in _studies([job for job in jobs if finished(job) is not None]):
            print(compare_study(settings, time_here=not elsewhere))
    if failed := [job for job in jobs if finished(job) is None]:
        names = ", ".join(job.name for job in failed)
        print(f"not finished: {names}; the same command takes them up again", file=sys.stderr)
    return int(bool(failed))


@contextmanager
def _parents_of(jobs: Sequence[Job]) -> Iterator[None]:
    """Say in the store that the studies run, before any job starts, and how they have ended when all have."""
    from ablate.studies.copied import mark_study
    from ablate.tracking import Status

    studies = _studies(jobs)
    for settings in studies:
        mark_study(settings, Status.running)
    try:
        yield
    finally:
        for settings in studies:
            of_study = [job for job in jobs if job.settings.study_dir == settings.study_dir]
            mark_study(settings, Status.failed if any(finished(job) is None for job in of_study) else Status.finished)


def simulate(jobs: Sequence[Job], launch: Callable[[Sequence[Job], Work], None] | None = None) -> int:
    """Simulate the pairs that the jobs read: here, or side by side in jobs that a launcher starts elsewhere.

    Pairs that exist are checked, and damaged ones are made again.
    """
    for settings, maps in (sets := _data_sets(jobs)):
        for damaged in drop_damaged(settings, maps):
            print(damaged, file=sys.stderr)
    if launch is None:
        _simulate_for(jobs)
    else:
        launch(jobs, _simulate_own)
    code = 0
    for settings, maps in sets:
        folder = dataset_folder(settings)
        if made := made_data(settings, maps):
            print(f"{len(made.pairs)} frames in {folder}; a look at them: contact_sheet.png there")
        else:
            print(f"not finished: {folder}; the same command takes it up again", file=sys.stderr)
            code = 1
    return code


def _simulate_own(job: Job) -> None:
    """Simulate the pairs that one job reads."""
    prepare_data(job.settings, maps_needed([job.settings.model]))


def _data_sets(jobs: Sequence[Job]) -> list[tuple[StudySettings, frozenset[str]]]:
    """Every data set that the jobs read, with the maps that at least one of them does."""
    sets: dict[str, list[Job]] = {}
    for job in jobs:
        sets.setdefault(dataset_hash(job.settings), []).append(job)
    return [(js[0].settings, maps_needed(j.settings.model for j in js)) for js in sets.values()]


def _simulate_for(jobs: Sequence[Job]) -> None:
    with refusing():  # a mesh with a hole, more frames than poses, a full disk, ...
        for settings, maps in _data_sets(jobs):
            prepare_data(settings, maps)


def _studies(jobs: Sequence[Job]) -> list[StudySettings]:
    """The settings of the first job of every study among them."""
    first: dict[Path, StudySettings] = {}
    for job in jobs:
        first.setdefault(job.settings.study_dir, job.settings)
    return list(first.values())


def describe(jobs: Sequence[Job]) -> int:
    """Print what the variants are and how large they are, in full, whatever the width of the terminal.

    For a folder of meshes without a scene.yaml, print a proposal of one instead.
    """
    folder = jobs[0].settings.scene.folder
    if folder and jobs[0].settings.scene.kind is not SceneKind.pairs and not (Path(folder) / "scene.yaml").exists():
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


def _look(task: Task, jobs: Sequence[Job]) -> int:
    """Do a task that starts no jobs."""
    if task is Task.describe:
        return describe(jobs)
    if task is Task.compare:
        from ablate.studies.comparison.compare import compare_study

        for settings in _studies(jobs):
            print(compare_study(settings, rebuild=True))
        return 0
    if task is Task.plan:
        from ablate.studies.progress import show_progress

        return show_progress(jobs)
    if task is Task.preview:
        from ablate.studies.preview import preview

        return preview(jobs)
    if task is Task.render:
        from ablate.studies.render import render

        return render(jobs)
    if task is Task.view:
        from ablate.viewer.task import view

        return view(jobs)
    if task is Task.export:
        from ablate.studies.export import export

        return export(jobs)
    if task is Task.precision:
        from ablate.numerics.precision import precision

        return precision(jobs)
    from ablate.numerics.stability import stability

    return stability(jobs)
