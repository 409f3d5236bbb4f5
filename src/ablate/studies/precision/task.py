"""`task=precision`: measure, draw, print, and put everything on an MLflow run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from ablate.analysis import RESIMULATION, order_figure, stages_figure, work_precision_figure
from ablate.config import StudySettings
from ablate.studies.precision.bench import Bench, bench_of
from ablate.studies.precision.generated import comparable_runs, measure_generators, plan_of, ways
from ablate.studies.precision.ledger import Ledger
from ablate.studies.precision.simulated import RAYS_SERIES, ladders, measure_simulator, series_name, work
from ablate.studies.precision.summary import floors, orders, tables, verdict
from ablate.studies.preflight import check
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
    planned = plan_of(runs, settings)
    _, lacking = ways(settings) if runs else ([], ())
    about = _about(settings, bench, (found, *(f"left out: {note}" for note in lacking)))
    print("\n".join(about), flush=True)
    folder = settings.runs / "precision"
    points = Ledger(folder / "precision.csv", "series setting ms metric error")
    details = Ledger(folder / "details.csv", "table series setting quantity value")
    store = open_store(settings.runs, settings.tracking.uri, settings.tracking.experiment)
    run = RunLog(store, task_run(store, "precision", settings.study))
    status = Status.failed
    try:
        steps = work(bench.simulator, len(bench.frames))
        steps += len(bench.frames) * bool(planned) + sum(len(its_ways) for _, its_ways in planned)
        with tqdm(total=steps, unit="step", desc="precision", mininterval=1.0) as bar:
            reference = measure_simulator(bench, points, details, bar.update)
            measure_generators(bench, planned, settings, reference, points, details, bar.update)
        text, figures = _shown(points.table(), details.table(), bench, folder)
        print(text)
        print(f"\n{points.path}\n{details.path}\n" + "\n".join(str(f) for f in figures if f.suffix == ".png"))
        for figure in figures:
            run.artifact(figure, "vector" if figure.suffix == ".pdf" else None)
        run.metrics({f"order/{r['metric']}": r["p"] for r in orders(points.table()).to_dict("records")})
        run.describe(f"{' '.join(about)}\n```\n{text}\n```")
        status = Status.finished
    except KeyboardInterrupt:
        status = Status.killed
        raise
    finally:
        for ledger in (points, details):
            run.artifact(ledger.path)
        run.tags({"hardware": hardware(), "scene": settings.scene_name, **_code()})
        run.end(status)
    return 0


def _code() -> dict[str, str]:
    return {k: v for k, v in git_state(Path(__file__).parent).items() if k != "git_diff"}


def _about(settings: StudySettings, bench: Bench, notes: Sequence[str]) -> list[str]:
    """What is measured on what, and what the scene does without."""
    s = bench.simulator
    triangles = sum(len(structure.mesh.faces) for structure in bench.scene.structures)
    left_out = compile_scene(bench.scene, bench.probe, s, bench.poses).left_out
    return [
        f"{hardware()}.",
        f"{settings.scene_name}, {triangles:,} triangles; {len(bench.frames)} test frames of "
        f"{s.image_shape[0]} x {s.image_shape[1]} pixels; {s.rays} rays, {s.layers} layers, {s.scanlines} scanlines, "
        f"{s.axial_samples} axial samples unless a series says otherwise.",
        *(f"{note}." for note in notes),
        *(f"left out by the plan: {note}." for note in left_out),
    ]


def _shown(points: pd.DataFrame, details: pd.DataFrame, bench: Bench, folder: Path) -> tuple[str, list[Path]]:
    """The summary as text, and the figures."""
    device = hardware()
    figures = work_precision_figure(points, folder / "precision", floors(points, bench.simulator.rays), device)
    base = {series_name(name): getattr(bench.simulator, name) for name in ladders(bench.simulator)}
    of_rays = points[points["series"] == RAYS_SERIES]
    convergence = details[details["table"] == "convergence"]
    figures += order_figure(of_rays, convergence, base, folder / "precision_order")
    figures += stages_figure(details[details["table"] == "stage"], folder / "precision_stages", device)
    level = ", ".join(f"{name} {value:.3g}" for name, value in floors(points, bench.simulator.rays).items())
    parts = [f"{heading}\n\n{table.to_string()}" for heading, table in _indexed(tables(points, details)).items()]
    return "\n\n".join([verdict(details), f"{RESIMULATION}: {level}.", *parts]), figures


def _indexed(shown: dict[str, pd.DataFrame]) -> dict[str, pd.DataFrame]:
    """Rows by their first columns, which `to_string` then prints to the left."""
    return {h: t.set_index(list(t.columns[:2])) if "setting" in t.columns else t for h, t in shown.items()}
