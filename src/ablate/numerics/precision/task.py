"""`task=precision`: measure, draw, print, and log everything to an MLflow run."""

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pandas as pd
import torch

from ablate.analysis import RESIMULATION, observed_order
from ablate.metrics import metric_of
from ablate.numerics.precision.bench import (
    OTHER_SERIES,
    RAYS_SERIES,
    REFERENCE_RAYS,
    Bench,
    bench_of,
    measure_simulator,
)
from ablate.numerics.precision.errors import worse_than
from ablate.numerics.precision.figures import draw
from ablate.numerics.precision.generated import (
    comparable_runs,
    executions,
    measure_formula,
    measure_generators,
    schedule_of,
    shipped_candidates,
)
from ablate.numerics.precision.own_simulator import measure_own_simulator
from ablate.numerics.precision.worth import worth
from ablate.publish import TaskView, published_task
from ablate.settings.study import ConfigurationError, StudySettings, refusing
from ablate.storage import write_text
from ablate.study.job import Job
from ablate.study.provenance import hardware
from ablate.ultrasound.media import plan_scene

WELL_CONVERGED = 0.05
POINTS = ["series", "setting", "ms", "metric", "error"]  # columns of `precision.csv`, before those of intervals
_OF_OWN = (
    "The reference is {}; settings of rays and layers are those of ablate's own simulator. "
    "Its grey levels, and those of the formula, are matched to the histogram of the reference."
)
OF_FRAMES = ["series", "setting", "metric", "frame", "error"]  # of `frames.csv`
DETAILS = ["table", "series", "setting", "quantity", "value"]  # and of `details.csv`


def precision(jobs: Sequence[Job]) -> int:
    """Error against run time of the simulator and of the trained runs on disk, for the first job's data set."""
    settings = jobs[0].settings
    try:
        bench = bench_of(jobs[0])
        shipped = shipped_candidates(bench)
        runs, counts = comparable_runs(jobs[0], shipped)
    except (ValueError, FileNotFoundError) as error:  # a mesh with a hole, no usable pose, ...
        raise ConfigurationError(str(error)) from error
    planned = schedule_of(runs, settings, shipped)
    about = _about(settings, bench, counts, executions(settings)[1] if planned else ())
    print("\n".join(about), flush=True)
    folder = settings.results / "precision"
    try:
        with published_task(settings, folder) as view:
            if bench.target is None:
                reference, simulated = measure_simulator(bench)
            else:
                with refusing():
                    reference, simulated = measure_own_simulator(bench, bench.target)
            parts = [
                simulated,
                measure_formula(bench, settings.model, reference),
                measure_generators(bench, planned, settings, reference),
            ]
            measured = {
                "precision": pd.DataFrame([row for part in parts for row in part.points], columns=POINTS),
                "details": pd.DataFrame([row for part in parts for row in part.details], columns=DETAILS),
                "frames": pd.DataFrame([row for part in parts for row in part.of_frames], columns=OF_FRAMES),
            }
            measured = {name: table.astype({"setting": str}) for name, table in measured.items()}
            worse = worse_than(measured["frames"], OTHER_SERIES, bench.usual).drop(columns="worse")
            measured["precision"] = measured["precision"].merge(worse, "left", ["series", "setting", "metric"])
            for path in _report(folder, bench, about, measured, view):
                print(path)
    except KeyboardInterrupt:
        sys.exit("ablate: interrupted; the same command measures everything again")
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


def _report(
    folder: Path, bench: Bench, about: list[str], measured: Mapping[str, pd.DataFrame], view: TaskView
) -> list[Path]:
    """Write and print the tables, draw the figures, publish both, and return the paths of the files except PDFs."""
    for name, table in measured.items():
        write_text(folder / f"{name}.csv", table.to_csv(index=False))
    errors = measured["precision"]
    figures, level = draw(errors, bench.usual, folder, hardware())
    shown = tables(errors, bench.usual)
    head = [
        verdict(measured["details"]) if bench.target is None else _OF_OWN.format(bench.target),
        f"{RESIMULATION}: " + ", ".join(f"{name} {value:.3g}" for name, value in level.items()),
    ]
    print("\n".join([*head, "", as_text(shown), ""]))
    summary = folder / "summary.txt"
    write_text(summary, "\n".join([*about, *head, "", as_text(shown), ""]))
    written = [*(folder / f"{name}.csv" for name in measured), summary]
    view.scores |= {f"order/{metric}": p for metric, (p, _) in _orders(errors).items()}
    first = as_text(dict(list(shown.items())[:1]))  # the run's first page has room for one table
    view.description = "\n\n".join([*about, *head, f"```\n{first}\n```", "The rest: Artifacts, `summary.txt`."])
    return [*written, *(f for f in figures if f.suffix == ".png")]


def _orders(points: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """By metric the observed order p of the simulator, error ~ rays^-p, and its standard error."""
    orders = {}
    for metric, group in points[points["series"] == RAYS_SERIES].groupby("metric", sort=False):
        rays = group["setting"].astype(float).to_numpy()
        fit = observed_order(rays, group["error"].to_numpy(float), str(metric))
        if fit:
            orders[str(metric)] = fit
    return orders


def verdict(details: pd.DataFrame) -> str:
    """Say whether the reference is converged."""
    halved = details[details["table"] == "reference"]
    labels = halved["quantity"].map(lambda name: metric_of(name).label)
    places = [f"{label} at {rays} rays" for label, rays in zip(labels, halved["setting"], strict=True)]
    shares = pd.Series(halved["value"].astype(float).to_numpy(), places)
    over = list(shares.index[~(shares < WELL_CONVERGED)])
    converged = f"Not within {WELL_CONVERGED:.0%}: {', '.join(over)}." if over else "It is converged."
    return (
        f"With half of its {REFERENCE_RAYS} rays the reference changes the errors by at most "
        f"{shares.max():.1%} ({shares.idxmax()}). {converged}"
    )


def tables(points: pd.DataFrame, usual: str) -> dict[str, pd.DataFrame]:
    """Make the tables of the summary by their headings, with cells as text; one without rows is left out.

    `points` has the columns series, setting, ms, metric, error; `usual` is the setting of the re-simulation. The rest
    is in `details.csv`.
    """
    shown = points[points["series"] != OTHER_SERIES]
    named = shown.assign(
        title=shown["metric"].map(lambda name: metric_of(name).title),
        cell=[f"{e:.{metric_of(m).decimals}f}" for m, e in zip(shown["metric"], shown["error"], strict=True)],
    )
    errors = named.pivot_table("cell", ["series", "setting"], "title", "first", fill_value="", sort=False)
    errors = errors.rename_axis(columns=None)
    ms = shown.groupby(["series", "setting"])["ms"].first()
    errors.insert(0, "ms", ms.reindex(errors.index).map("{:.1f}".format))
    fits = {
        "RMS error of the image" if metric == "psnr" else metric_of(metric).label: (f"{p:.2f}", f"{error:.2f}")
        for metric, (p, error) in _orders(points).items()
    }
    orders = pd.DataFrame(fits, ["p", "standard error"]).T.rename_axis("error")
    by_heading = {
        "Error to the reference": errors,
        "Observed order p, error ~ rays^-p": orders,
        "What the simulator reaches in the time of a renderer, and when it is as near": worth(points, usual),
    }
    return {heading: table for heading, table in by_heading.items() if len(table)}


def as_text(tables: dict[str, pd.DataFrame]) -> str:
    """Print tables for a console, each under its heading, never truncated."""
    return "\n\n".join(f"{heading}\n\n{table.to_string()}" for heading, table in tables.items())
