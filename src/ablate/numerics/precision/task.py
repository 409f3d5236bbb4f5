"""`task=precision`: measure, draw, print, and log everything to an MLflow run."""

import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from tqdm import tqdm

from ablate.analysis import RESIMULATION, error_vs_runtime, order_figure
from ablate.numerics.precision.bench import Bench, CsvTable, bench_of
from ablate.numerics.precision.generated import comparable_runs, executions, measure_generators, schedule_of
from ablate.numerics.precision.simulated import RAYS_SERIES, ladders, measure_simulator, series_name, work
from ablate.numerics.precision.summary import as_text, floors, orders, tables, time_of_parts, verdict
from ablate.runs.job import Job
from ablate.runs.run import Run
from ablate.runs.store_copy import open_store
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.storage import write_text
from ablate.tracking import TaskRecord, git_state, hardware, recorded_task
from ablate.ultrasound.media import plan_scene


def precision(jobs: Sequence[Job]) -> int:
    """Error against run time of the simulator and of the trained runs on disk, for the first job's data set."""
    settings = jobs[0].settings
    try:
        runs, counts = comparable_runs(jobs[0])
        bench = bench_of(jobs[0])
    except (ValueError, FileNotFoundError) as error:  # a mesh with a hole, no usable pose, ...
        raise ConfigurationError(str(error)) from error
    about = _about(settings, bench, counts, executions(settings)[1] if runs else ())
    print("\n".join(about), flush=True)
    folder = settings.results / "precision"
    points = CsvTable(folder / "precision.csv", "series setting ms metric error")
    details = CsvTable(folder / "details.csv", "table series setting quantity value")
    code = {k: v for k, v in git_state().items() if k != "git_diff"}
    try:
        with recorded_task(folder, settings.study, lambda: open_store(settings)) as record:
            record.files += [points.path, details.path]
            record.tags |= {"hardware": hardware(), "scene": settings.scene_name, **code}
            _measure(settings, bench, runs, points, details)
            for path in _report(bench, about, points, details, record):
                print(path)
    except KeyboardInterrupt:
        sys.exit(f"ablate: interrupted; what was measured is in {folder}, the same command measures it again")
    return 0


def _about(settings: StudySettings, bench: Bench, counts: str, lacking: Sequence[str]) -> list[str]:
    """Say what is measured, on what hardware, and what is left out."""
    s = bench.simulator
    triangles = sum(len(structure.mesh.faces) for structure in bench.scene.structures)
    left_out = plan_scene(bench.scene, bench.probe, s, bench.poses).left_out
    return [
        f"{hardware()}, {torch.get_num_threads()} threads.",
        f"{settings.scene_name}, {triangles:,} triangles; {len(bench.frames)} test frames of "
        f"{s.image_shape[0]} x {s.image_shape[1]} pixels; {s.rays} rays, {s.layers} layers, {s.scanlines} scanlines, "
        f"{s.axial_samples} axial samples unless a series says otherwise.",
        f"{counts}.",
        *(f"left out, {note}." for note in lacking),
        *(f"left out by the plan: {note}." for note in left_out),
    ]


def _measure(settings: StudySettings, bench: Bench, runs: list[Run], points: CsvTable, details: CsvTable) -> None:
    planned = schedule_of(runs, settings)
    steps = work(bench.simulator, len(bench.frames))
    steps += len(bench.frames) * bool(planned) + sum(len(its_executions) for _, its_executions in planned)
    with tqdm(total=steps, unit="step", desc="precision", mininterval=1.0) as bar:
        reference = measure_simulator(bench, points, details, bar.update)
        measure_generators(bench, planned, settings, reference, points, details, bar.update)


def _report(bench: Bench, about: list[str], points: CsvTable, details: CsvTable, record: TaskRecord) -> list[Path]:
    """Print the tables, draw the figures, record both, and return the paths of the files except PDFs."""
    folder, errors, more = points.path.parent, points.table(), details.table()
    level = floors(errors, bench.simulator.rays)
    figures = error_vs_runtime(errors, folder / "precision", level, hardware(), time_of_parts(more))
    base = {series_name(name): getattr(bench.simulator, name) for name in ladders(bench.simulator)}
    of_rays, grids = errors[errors["series"] == RAYS_SERIES], more[more["table"] == "convergence"]
    figures += order_figure(of_rays, grids, base, folder / "precision_order")
    shown = tables(errors, more)
    head = [verdict(more), f"{RESIMULATION}: " + ", ".join(f"{name} {value:.3g}" for name, value in level.items())]
    print("\n".join([*head, "", as_text(shown), ""]))
    summary = folder / "summary.txt"
    write_text(summary, "\n".join([*about, *head, "", as_text(shown), ""]))
    record.files += [summary, *figures]
    record.scores |= {f"order/{row['metric']}": row["p"] for row in orders(errors).to_dict("records")}
    first = as_text(dict(list(shown.items())[:1]))  # the run's first page has room for one table
    record.description = "\n\n".join([*about, *head, f"```\n{first}\n```", "The rest: Artifacts, `summary.txt`."])
    return [points.path, details.path, summary, *(f for f in figures if f.suffix == ".png")]
