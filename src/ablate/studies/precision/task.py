"""`task=precision`: measure, draw, print, and put everything on an MLflow run."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import torch
from tqdm import tqdm

from ablate.analysis import RESIMULATION, order_figure, work_precision_figure
from ablate.config import StudySettings
from ablate.studies.precision.bench import Bench, bench_of
from ablate.studies.precision.generated import comparable_runs, measure_generators, plan_of, ways
from ablate.studies.precision.ledger import Ledger
from ablate.studies.precision.simulated import RAYS_SERIES, ladders, measure_simulator, series_name, work
from ablate.studies.precision.summary import as_text, floors, orders, tables, verdict
from ablate.studies.preflight import check
from ablate.studies.results import Finished
from ablate.studies.sweep import ConfigurationError, Job
from ablate.tracking import RunLog, Status, git_state, hardware, open_store, task_run
from ablate.ultrasound.plan import compile_scene


def precision(jobs: Sequence[Job]) -> int:
    """Error against run time of the simulator and of the trained runs on disk, for the first job's data set."""
    check(jobs)
    settings = jobs[0].settings
    try:
        runs, found = comparable_runs(settings)
        bench = bench_of(settings)
    except (ValueError, FileNotFoundError) as error:  # a mesh with a hole, no usable pose, ...
        raise ConfigurationError(str(error)) from error
    about = _about(settings, bench, found, ways(settings)[1] if runs else ())
    print("\n".join(about), flush=True)
    folder = settings.runs / "precision"
    points = Ledger(folder / "precision.csv", "series setting ms metric error")
    details = Ledger(folder / "details.csv", "table series setting quantity value")
    store = open_store(settings.runs, settings.tracking.uri, settings.tracking.experiment)
    run = RunLog(store, task_run(store, "precision", settings.study))
    status = Status.failed
    try:
        _measure(settings, bench, runs, points, details)
        for path in _report(bench, about, points, details, run):
            print(path)
        status = Status.finished
    except KeyboardInterrupt:
        status = Status.killed
        sys.exit(f"ablate: interrupted; what was measured is in {folder}, the same command measures it again")
    finally:
        for ledger in (points, details):
            run.artifact(ledger.path)
        code = {k: v for k, v in git_state(Path(__file__).parent).items() if k != "git_diff"}
        run.tags({"hardware": hardware(), "scene": settings.scene_name, **code})
        run.end(status)
    return 0


def _about(settings: StudySettings, bench: Bench, found: str, lacking: Sequence[str]) -> list[str]:
    """What is measured on what, and what is left out."""
    s = bench.simulator
    triangles = sum(len(structure.mesh.faces) for structure in bench.scene.structures)
    left_out = compile_scene(bench.scene, bench.probe, s, bench.poses).left_out
    return [
        f"{hardware()}, {torch.get_num_threads()} threads.",
        f"{settings.scene_name}, {triangles:,} triangles; {len(bench.frames)} test frames of "
        f"{s.image_shape[0]} x {s.image_shape[1]} pixels; {s.rays} rays, {s.layers} layers, {s.scanlines} scanlines, "
        f"{s.axial_samples} axial samples unless a series says otherwise.",
        f"{found}.",
        *(f"left out, {note}." for note in lacking),
        *(f"left out by the plan: {note}." for note in left_out),
    ]


def _measure(settings: StudySettings, bench: Bench, runs: list[Finished], points: Ledger, details: Ledger) -> None:
    planned = plan_of(runs, settings)
    steps = work(bench.simulator, len(bench.frames))
    steps += len(bench.frames) * bool(planned) + sum(len(its_ways) for _, its_ways in planned)
    with tqdm(total=steps, unit="step", desc="precision", mininterval=1.0) as bar:
        reference = measure_simulator(bench, points, details, bar.update)
        measure_generators(bench, planned, settings, reference, points, details, bar.update)


def _report(bench: Bench, about: list[str], points: Ledger, details: Ledger, run: RunLog) -> list[Path]:
    """Print the tables, draw the figures, put both on the run; returns what lies where, but for the PDFs."""
    folder, errors, more = points.path.parent, points.table(), details.table()
    level = floors(errors, bench.simulator.rays)
    stem = folder / "precision"
    figures = work_precision_figure(errors, more[more["table"] == "stage"], stem, level, hardware())
    base = {series_name(name): getattr(bench.simulator, name) for name in ladders(bench.simulator)}
    of_rays, grids = errors[errors["series"] == RAYS_SERIES], more[more["table"] == "convergence"]
    figures += order_figure(of_rays, grids, base, stem.with_name("precision_order"))
    shown = tables(errors, more)
    head = [verdict(more), f"{RESIMULATION}: " + ", ".join(f"{name} {value:.3g}" for name, value in level.items())]
    print("\n".join([*head, "", as_text(shown), ""]))
    summary = folder / "summary.txt"
    summary.write_text("\n".join([*about, *head, "", as_text(shown), ""]))
    run.artifact(summary)
    for figure in figures:
        run.artifact(figure, "vector" if figure.suffix == ".pdf" else None)
    run.metrics({f"order/{row['metric']}": row["p"] for row in orders(errors).to_dict("records")})
    first = as_text(dict(list(shown.items())[:1]))  # the run's first page has room for one table
    run.describe("\n\n".join([*about, *head, f"```\n{first}\n```", "The rest: Artifacts, `summary.txt`."]))
    return [points.path, details.path, summary, *(f for f in figures if f.suffix == ".png")]
