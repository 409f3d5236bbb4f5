"""`task=precision`: measure, draw, print, and log everything to an MLflow run."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import torch

from ablate.analysis import RESIMULATION, observed_order
from ablate.metrics import metric_of
from ablate.metrics.metric import FORMULA
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
from ablate.publish import TaskView, published_task
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.storage import write_text
from ablate.study.job import Job
from ablate.study.provenance import hardware
from ablate.ultrasound.media import plan_scene

WELL_CONVERGED = 0.05
POINTS = ["series", "setting", "ms", "metric", "error"]  # columns of `precision.csv`, before those of intervals
OF_FRAMES = ["series", "setting", "metric", "frame", "error"]  # of `frames.csv`
DETAILS = ["table", "series", "setting", "quantity", "value"]  # and of `details.csv`
BUDGETS_MS = (10.0, 40.0, 75.0, 200.0, 1000.0)
# Kinds of renderers in the table of budgets.
_SAME = "simulator, same speckle"
_OTHER = "simulator, other speckle"
_RUN = "trained run"


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
    try:
        with published_task(settings, folder) as view:
            reference, simulated = measure_simulator(bench)
            planned = schedule_of(runs, settings, shipped_candidates(bench))
            parts = [
                simulated,
                measure_formula(bench, settings.model, reference),
                measure_generators(bench, planned, settings, reference),
            ]
            tables = {
                "precision": pd.DataFrame([row for part in parts for row in part.points], columns=POINTS),
                "details": pd.DataFrame([row for part in parts for row in part.details], columns=DETAILS),
                "frames": pd.DataFrame([row for part in parts for row in part.of_frames], columns=OF_FRAMES),
            }
            tables = {name: table.astype({"setting": str}) for name, table in tables.items()}
            worse = worse_than(tables["frames"], OTHER_SERIES, f"rays {bench.simulator.rays}").drop(columns="worse")
            tables["precision"] = tables["precision"].merge(worse, "left", ["series", "setting", "metric"])
            for path in _report(folder, bench, about, tables, view):
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
    errors, more = measured["precision"], measured["details"]
    figures, level = draw(errors, bench.simulator.rays, folder, hardware())
    shown = tables(errors, more)
    head = [verdict(more), f"{RESIMULATION}: " + ", ".join(f"{name} {value:.3g}" for name, value in level.items())]
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


def tables(points: pd.DataFrame, details: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Make every table of the summary by its heading, with cells as text; tables without rows are left out.

    `points` has the columns series, setting, ms, metric, error; `details` table, series, setting, quantity, value.
    """

    def rows_of(table: str) -> pd.DataFrame:
        return details[details["table"] == table]

    stages = rows_of("stage")
    simulated = stages["series"].str.startswith("simulator")
    halved = f"By how much halving the reference's {REFERENCE_RAYS} rays moves these errors"
    grids = "Error of a grid to a finer one, and of another draw of the speckle on that"
    limits = "Single precision, bf16 and engines: how far they move a frame"
    shown = points[points["series"] != OTHER_SERIES].rename(columns={"metric": "quantity", "error": "value"})
    errors = _spread_out(shown, _cell)
    ms = shown.groupby(["series", "setting"])["ms"].first()
    errors.insert(0, "ms", ms.reindex(errors.index).map("{:.1f}".format))
    fits = {
        "RMS error of the image" if metric == "psnr" else metric_of(metric).label: (f"{p:.2f}", f"{error:.2f}")
        for metric, (p, error) in _orders(points).items()
    }
    by_heading = {
        "Error to the reference": errors,
        halved: _spread_out(rows_of("reference"), lambda _, share: f"{share:.1%}"),
        "Observed order p, error ~ rays^-p": pd.DataFrame(fits, ["p", "standard error"]).T.rename_axis("error"),
        grids: _spread_out(rows_of("convergence"), _cell),
        limits: _spread_out(_worst(rows_of("limit")), lambda _, value: f"{value:.2g}"),
        "The best within a budget": _budgets(points),
        "Stages of a simulated frame, ms": _stages(stages[simulated]),
        "Stages of a generated frame, ms": _stages(stages[~simulated]).T,
    }
    return {heading: table for heading, table in by_heading.items() if len(table)}


def as_text(tables: dict[str, pd.DataFrame]) -> str:
    """Print tables for a console, each under its heading, never truncated."""
    return "\n\n".join(f"{heading}\n\n{table.to_string()}" for heading, table in tables.items())


def _cell(metric: str, value: float) -> str:
    return f"{value:.{metric_of(metric).decimals}f}"


def _spread_out(rows: pd.DataFrame, show: Callable[[str, float], str]) -> pd.DataFrame:
    """Pivot to a row for each series and setting, and a column for each metric."""
    titles = rows["quantity"].map(lambda q: metric_of(q).title)
    cells = [show(q, float(v)) for q, v in zip(rows["quantity"], rows["value"], strict=True)]
    named = rows.assign(title=titles, cell=cells)
    wide = named.pivot_table("cell", ["series", "setting"], "title", "first", fill_value="", sort=False)
    return wide.rename_axis(columns=None)


def _worst(limits: pd.DataFrame) -> pd.DataFrame:
    """Keep, for each precision and engine, the largest error over the trained runs; the simulator's rows stay."""
    runs = limits[~limits["series"].str.startswith("simulator")]
    if runs.empty:
        return limits
    way = runs["setting"].str.extract(r"(\w+, \w+), seed", expand=False)
    badness_of = [metric_of(m).badness(v) for m, v in zip(runs["quantity"], runs["value"].astype(float), strict=True)]
    ranked = runs.assign(way=way, badness=badness_of).sort_values("badness", ascending=False, kind="stable")
    worst = ranked.drop_duplicates(["way", "quantity"]).sort_index()
    count = way[runs["quantity"] == runs["quantity"].iloc[0]].value_counts()
    series = [f"trained runs against fp32 eager, worst of {count[w]}" for w in worst["way"]]
    rows = worst.assign(series=series, setting=worst["way"]).sort_values("way", kind="stable")
    return pd.concat([limits.drop(runs.index), rows[limits.columns]])


def _budgets(points: pd.DataFrame) -> pd.DataFrame:
    """Find the best within each budget; only renderers with speckle of their own are compared with each other."""
    finite = points[np.isfinite(points["error"]) & (points["series"] != FORMULA)]
    badness_of = [metric_of(m).badness(e) for m, e in zip(finite["metric"], finite["error"], strict=True)]
    kinds = finite["series"].where(finite["series"].str.startswith("simulator"), _RUN)
    kinds = kinds.mask(kinds == OTHER_SERIES, _OTHER).where(kinds.isin((_RUN, OTHER_SERIES)), _SAME)
    ranked = finite.assign(badness=badness_of, kind=kinds)
    ranked = ranked.sort_values(["badness", "ms"], kind="stable")  # of equal ones the fastest
    rows = []
    for metric in dict.fromkeys(points["metric"]):
        of_metric = ranked[ranked["metric"] == metric]
        comparable = {_OTHER, _RUN} <= set(of_metric["kind"])  # a trained run has no envelope
        for budget in BUDGETS_MS:
            best = of_metric[of_metric["ms"] <= budget].drop_duplicates("kind").set_index("kind")
            cells = dict.fromkeys((_SAME, _OTHER, _RUN), "")
            for kind, row in best.iterrows():
                name = f"{row['series']}: {row['setting']}".replace("simulator, ", "").replace("other scatterers: ", "")
                cells[str(kind)] = f"{_cell(metric, row['error'])} ({name})"
            rivals = best.index.intersection([_OTHER, _RUN]) if comparable else []
            better = "not compared" if len(best) else "none is that fast"
            if len(rivals):
                better = str(best.loc[rivals, "badness"].idxmin()).removesuffix(", other speckle")
            rows.append({"metric": metric_of(metric).title, "ms": f"{budget:g}", **cells, "better": better})
    return pd.DataFrame(rows).set_index(["metric", "ms"])


def _stages(stages: pd.DataFrame) -> pd.DataFrame:
    """Pivot to a row for each stage, and a column for each simulator setting or network."""
    if stages.empty:
        return pd.DataFrame()
    series = stages["series"].str.replace(RAYS_SERIES, "rays", regex=False)
    named = stages.assign(renderer=series + " " + stages["setting"], value=stages["value"].astype(float))
    wide = named.pivot_table(index="quantity", columns="renderer", values="value", sort=False)
    return wide.map(lambda v: "" if pd.isna(v) else f"{v:.1f}").rename_axis("", axis=1).rename_axis("")
