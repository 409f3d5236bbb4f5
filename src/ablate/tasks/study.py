"""`task=study`, `simulate` and `compare`: from checked jobs to pairs, trainings, and the comparison of a study."""

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from ablate.command.compose import without_repetitions
from ablate.command.launch import Launch
from ablate.dataset import remove_damaged
from ablate.settings.study import ConfigurationError, StudySettings, refusing
from ablate.sources.data_set import maps_needed
from ablate.sources.prepare import prepare_data
from ablate.sources.source import source_of
from ablate.study.comparable import kept_list, untold_differences
from ablate.study.job import Job, refuse_lost_network, trainings_of
from ablate.study.log import Status
from ablate.study.run import RunList, listed_runs, trained_runs
from ablate.study.training import trainings_in


def study(jobs: Sequence[Job], launch: Launch) -> int:
    """Simulate what is missing, do every job that is not finished, compare.

    Jobs that run elsewhere simulate their own pairs, because a cluster's login node is not for computing. Nor is it for
    timing: `task=compare` on another node does that.
    """
    asked = without_repetitions(jobs)
    for line in (*_said_of_repetitions(jobs), *_said_of_differences(asked)):
        print(line)
    waiting = [job for job in asked if not job.finished]
    for job in waiting:
        refuse_lost_network(job)
    if waiting and not launch.elsewhere:
        _simulate_for(waiting)  # so that a mesh that cannot be used is refused before anything is published
    with _marked(waiting):
        if waiting:
            launch.start(waiting, run_job)
        if launch.compares:
            for group in _by_study(asked):
                if any(job.finished for job in group):
                    _compare(listed_runs(trainings_of(group)), group, time_here=not launch.elsewhere)
    failed = [job.name for job in waiting if not job.finished]
    if failed:
        print(f"not finished: {', '.join(failed)}; the same command takes them up again", file=sys.stderr)
    return int(bool(failed))


def run_job(job: Job) -> None:
    """Train and score one job, and publish it meanwhile."""
    from ablate.publish import following
    from ablate.study.work import do

    if not job.finished:
        with following(job):
            do(job)


def _said_of_repetitions(jobs: Sequence[Job]) -> list[str]:
    """A line for each training that several jobs ask for."""
    names: dict[tuple[Path, str], list[str]] = {}
    for job in jobs:
        names.setdefault((job.settings.study_dir, job.hash), []).append(job.name)
    return [
        f"{' and '.join(dict.fromkeys(several))}: {len(several)} jobs of one training, which counts once"
        for several in names.values()
        if len(several) > 1
    ]


def _said_of_differences(jobs: Sequence[Job]) -> list[str]:
    """A line for each key in which networks of one study differ though their labels do not tell it."""
    groups = [trainings_of(group) for group in _by_study(jobs)]
    notes = [note for group in groups for note in untold_differences(group, group[0].settings.reference)]
    return [f"Note: {note}" for note in notes]


@contextmanager
def _marked(jobs: Sequence[Job]) -> Iterator[None]:
    """Say in the store that the studies of jobs run, before any job starts, and how they have ended."""
    if not jobs:
        yield
        return
    from ablate.publish import mark_study, published_end

    groups = _by_study(jobs)
    for group in groups:
        mark_study(group[0].settings, Status.running)
    try:
        yield
    finally:
        for job in jobs:
            if not job.finished:
                published_end(job)
        for group in groups:
            all_finished = all(job.finished for job in group)
            mark_study(group[0].settings, Status.finished if all_finished else Status.failed)


def simulate(jobs: Sequence[Job], launch: Launch) -> int:
    """Simulate the pairs that the jobs read: here, or side by side in jobs that run on a cluster.

    Pairs that exist are checked, and damaged ones are made again.
    """
    sets = data_sets(jobs)
    for job, maps in sets:
        for pairs in job.data.all_pairs:
            for damaged in remove_damaged(pairs, maps):
                print(damaged, file=sys.stderr)
    if launch.elsewhere:
        launch.start(jobs, simulate_for_job)
    else:
        _simulate_for(jobs)
    code = 0
    for job, maps in sets:
        data = job.data
        if data.lacks(source_of(job.settings).offered(maps)):
            print(f"not finished: {data.folder}; the same command takes it up again", file=sys.stderr)
            code = 1
        else:
            print(f"{len(data.pairs)} frames in {data.folder}; a look at them: {data.contact_sheet.name} there")
    return code


def simulate_for_job(job: Job) -> None:
    """Make the pairs that one job reads."""
    prepare_data(job.settings, job.data, job.identity["data"], maps_needed([job.settings.model]))


def data_sets(jobs: Sequence[Job]) -> list[tuple[Job, frozenset[str]]]:
    """Every data set that the jobs read, as the first job that does, with the maps that at least one of them reads."""
    sets: dict[Path, list[Job]] = {}
    for job in jobs:
        sets.setdefault(job.data.folder, []).append(job)
    return [(readers[0], maps_needed(job.settings.model for job in readers)) for readers in sets.values()]


def _simulate_for(jobs: Sequence[Job]) -> None:
    with refusing():  # a mesh with a hole, more frames than poses, a full disk, ...
        for job, maps in data_sets(jobs):
            prepare_data(job.settings, job.data, job.identity["data"], maps)


def _by_study(jobs: Sequence[Job]) -> list[list[Job]]:
    """The jobs of each study among them."""
    groups: dict[Path, list[Job]] = {}
    for job in jobs:
        groups.setdefault(job.settings.study_dir, []).append(job)
    return list(groups.values())


def compare(jobs: Sequence[Job]) -> int:
    """Make the comparison of every study anew from what is on disk.

    A sweep compares its own jobs. One job alone asks for the comparison that the study has, whatever it is of, and
    where there is none, for all that is trained.
    """
    for group in _by_study(without_repetitions(jobs)):
        settings = group[0].settings
        asked = listed_runs(trainings_of(group))
        if len(jobs) == 1:
            kept = kept_list(settings.study_dir, settings.reference)
            known = kept if kept.runs else replace(asked, runs=trained_runs(settings.study_dir), unfinished=())
            asked = known if known.runs else asked
        if not asked.runs:
            raise ConfigurationError(_nothing_finished(settings, asked))
        _compare(asked, group, rebuild=True)
    return 0


def _nothing_finished(settings: StudySettings, asked: RunList) -> str:
    """That there is nothing to compare, and what lies there instead."""
    words = [f"{settings.study_dir} holds no finished run of this command ({', '.join(asked.unfinished)})."]
    trained = [training.name for training in trainings_in(settings.study_dir) if training.is_trained]
    if trained:
        words.append(f"It holds {', '.join(trained)}: name them, as -m variant=... seed=...")
    return " ".join(words)


def _compare(asked: RunList, jobs: Sequence[Job], rebuild: bool = False, time_here: bool = True) -> None:
    """Compare, publish and print, as jobs of the command ask for it."""
    from ablate.publish import publish_study
    from ablate.study.compare import compare_study, on_screen

    settings = jobs[0].settings
    named = [job.settings.model.target for job in jobs if job.settings.model.target]
    compared = compare_study(asked, settings.study, rebuild, time_here, named)
    print(on_screen(compared, publish_study(settings, compared.study, compared.notes)))
    shown = {run.training.folder for run in compared.study.listed.runs}
    others = [one.folder.name for one in trainings_in(asked.folder) if one.is_trained and one.folder not in shown]
    if others:
        print(f"Note: not in this comparison, as one command compares what it names: {', '.join(others)}.")
