"""What each `task=` does with the jobs of a command line. A task imports the rooms that it needs when it starts."""

from collections.abc import Sequence
from pathlib import Path
from pkgutil import resolve_name

from ablate.command.checks import check
from ablate.command.describe import description
from ablate.command.launch import Launch
from ablate.settings.components import said_of_components
from ablate.settings.study import ConfigurationError, Task, refusing
from ablate.sources.data_set import maps_needed
from ablate.sources.source import source_of
from ablate.study.job import Job
from ablate.tasks.study import simulate, study

#: The functions of the tasks that start no jobs; their modules are imported when they are needed.
_LOOKING = {
    Task.describe: "ablate.tasks.run_task:describe",
    Task.compare: "ablate.tasks.study:compare",
    Task.plan: "ablate.tasks.plan:show_progress",
    Task.preview: "ablate.tasks.render:preview",
    Task.render: "ablate.tasks.render:render",
    Task.view: "ablate.viewer.task:view",
    Task.export: "ablate.tasks.export:export",
    Task.precision: "ablate.numerics.precision.task:precision",
    Task.stability: "ablate.numerics.stability.task:stability",
}
_OF_SEVERAL_DATA_SETS = (Task.describe, Task.compare, Task.plan)  # tasks that a sweep over data sets can do


def run_task(jobs: Sequence[Job], launch: Launch) -> int:
    """Check every job of a command line, do its task and return the exit code."""
    task = jobs[0].settings.task
    if task is not Task.describe:
        check(jobs, elsewhere=launch.elsewhere)
    if task in (Task.study, Task.plan, Task.compare):
        for line in said_of_components():
            print(f"Note: {line}")
    if task in (Task.study, Task.simulate):
        try:
            return study(jobs, launch) if task is Task.study else simulate(jobs, launch)
        except (OSError, MemoryError, KeyboardInterrupt) as error:
            error.add_note("the same command continues where it stopped")
            raise
    if task not in _OF_SEVERAL_DATA_SETS and len({job.data.folder for job in jobs}) > 1:
        raise ConfigurationError(f"task={task}: a sweep over data sets; allowed is one data set")
    return int(resolve_name(_LOOKING[task])(jobs))


def describe(jobs: Sequence[Job]) -> int:
    """Print what the variants are and how large they are, in full, whatever the width of the terminal.

    For a folder without a scene.yaml, or with the empty one that a shell makes for `> scene.yaml`, print a proposal.
    """
    settings = jobs[0].settings
    folder = settings.scene.folder
    scene_file = Path(folder or "") / "scene.yaml"
    is_empty = not scene_file.exists() or scene_file.stat().st_size == 0
    if folder and source_of(settings).has_scene and is_empty:
        from ablate.anatomy import proposed_scene

        with refusing():
            print(proposed_scene(Path(folder)))
        return 0
    print(description(jobs))
    read = maps_needed(job.settings.model for job in jobs)
    print(f"maps simulated for {', '.join(dict.fromkeys(j.label for j in jobs))}: {', '.join(sorted(read))}")
    if "low" not in read:
        print("left out: low, the low-quality image; none of these variants reads it")
    if folder and source_of(settings).has_scene:
        from ablate.anatomy import said_of_unnamed, validate_scene_folder

        with refusing():
            unnamed = said_of_unnamed(Path(folder), validate_scene_folder(folder))
        if unnamed:
            print(unnamed)
    return 0
