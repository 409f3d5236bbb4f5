"""Tables of the measurements and a verdict on the reference, for the screen, MLflow and the docs."""

from collections.abc import Callable

import pandas as pd

from ablate.analysis import budget_table, observed_order
from ablate.metrics import metric_of
from ablate.numerics.precision.simulated import FULL_SERIES, OTHER_SERIES, RAYS_SERIES, REFERENCE_RAYS
from ablate.ultrasound.stages import Stage

WELL_CONVERGED = 0.05
_SAME, _OTHER, _RUN = "simulator, same speckle", "simulator, other speckle", "trained run"

_RAYS = (Stage.probe_rays, Stage.tracing, Stage.surface_echoes, Stage.clutter, Stage.illumination)
_PART_OF_STAGE: dict[str, str] = {
    **dict.fromkeys((Stage.pixel_labels, "segmentation"), "S"),
    **dict.fromkeys((Stage.attenuation_labels, Stage.attenuation_sum, "attenuation", "compensated"), "A"),
    **dict.fromkeys(_RAYS, "rays"),
    "low": "L",
    "network": "network",
}


def time_of_parts(details: pd.DataFrame) -> pd.DataFrame:
    """Group the stages of a frame into parts: columns series, setting, part, ms, as `error_vs_runtime` takes them."""
    stages = details[details["table"] == "stage"]
    parts = [_PART_OF_STAGE.get(stage, "signal chain") for stage in stages["quantity"]]
    return stages[["series", "setting"]].assign(part=parts, ms=stages["value"].astype(float))


def orders(points: pd.DataFrame) -> pd.DataFrame:
    """Fit the observed order p of the simulator, error ~ rays^-p: columns metric, p, standard_error."""
    rows = []
    for metric, group in points[points["series"] == RAYS_SERIES].groupby("metric", sort=False):
        rays = group["setting"].astype(float).to_numpy()
        fit = observed_order(rays, group["error"].to_numpy(float), str(metric))
        if fit is not None:
            rows.append({"metric": str(metric), "p": fit.order, "standard_error": fit.standard_error})
    return pd.DataFrame(rows, columns=["metric", "p", "standard_error"])


def floors(points: pd.DataFrame, rays: int) -> dict[str, float]:
    """Find the re-simulation's error by metric: other scatterers, and otherwise the data set's settings."""
    resimulated = points[(points["series"] == OTHER_SERIES) & (points["setting"] == f"rays {rays}")]
    return dict(zip(resimulated["metric"], resimulated["error"].astype(float), strict=True))


def verdict(details: pd.DataFrame) -> str:
    """Say whether the reference is converged."""
    halved = details[details["table"] == "reference"].assign(value=lambda d: d["value"].astype(float))
    places = [f"{metric_of(q).label} at {s} rays" for q, s in zip(halved["quantity"], halved["setting"], strict=True)]
    shares = dict(zip(places, halved["value"], strict=True))
    worst = max(shares, key=lambda place: shares[place])
    change = f"{shares[worst]:.1%} ({worst})"
    text = f"With half of its {REFERENCE_RAYS} rays the reference changes the errors by at most {change}."
    over = [place for place, share in shares.items() if share >= WELL_CONVERGED]
    return f"{text} Not within {WELL_CONVERGED:.0%}: {', '.join(over)}." if over else f"{text} It is converged."


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
    by_heading = {
        "Error to the reference": _errors(points[points["series"] != OTHER_SERIES]),
        halved: _spread_out(rows_of("reference"), lambda _, share: f"{share:.1%}"),
        "Observed order p, error ~ rays^-p": _orders(points),
        grids: _spread_out(rows_of("convergence"), _cell),
        limits: _spread_out(_worst(rows_of("limit")), lambda _, value: f"{value:.2g}"),
        "What the plan saves": _plan(points, rows_of("plan")),
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


def _errors(points: pd.DataFrame) -> pd.DataFrame:
    wide = _spread_out(points.rename(columns={"metric": "quantity", "error": "value"}), _cell)
    times = points.drop_duplicates(["series", "setting"])["ms"].map("{:.1f}".format)
    wide.insert(0, "ms", times.to_list())
    return wide


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


def _orders(points: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for row in orders(points).to_dict("records"):
        what = "RMS error of the image" if row["metric"] == "psnr" else metric_of(row["metric"]).label
        rows.append({"error": what, "p": f"{row['p']:.2f}", "standard error": f"{row['standard_error']:.2f}"})
    return _indexed(rows, ["error"])


def _plan(points: pd.DataFrame, plan: pd.DataFrame) -> pd.DataFrame:
    ms = {(p["series"], p["setting"]): p["ms"] for p in points.to_dict("records")}
    rows = []
    for row in plan.to_dict("records"):
        full, planned = ms[FULL_SERIES, row["setting"]], ms[RAYS_SERIES, row["setting"]]
        times = {"full, ms": f"{full:.0f}", "planned, ms": f"{planned:.0f}", "saved": f"{1 - planned / full:.0%}"}
        rows.append({"rays": row["setting"], **times, row["quantity"]: f"{float(row['value']):.0f}"})
    return _indexed(rows, ["rays"])


def _budgets(points: pd.DataFrame) -> pd.DataFrame:
    """Find the best within each budget; only renderers with speckle of their own are compared with each other."""
    names = list(dict.fromkeys(points["series"]))
    same = [n for n in names if n.startswith("simulator") and n not in (OTHER_SERIES, FULL_SERIES)]
    runs = [n for n in names if not n.startswith("simulator")]
    best = budget_table(points, {_SAME: same, _OTHER: [OTHER_SERIES], _RUN: runs}, (_OTHER, _RUN))
    rows = []
    for row in best.to_dict("records"):
        cells: dict[str, str] = {}
        for group in (_SAME, _OTHER, _RUN):
            name = row[group].replace("simulator, ", "").replace("other scatterers: ", "")
            cells[group] = f"{_cell(row['metric'], row[f'{group}_error'])} ({name})" if name else ""
        unknown = "not compared" if any(cells.values()) else "none is that fast"
        better = {_OTHER: "simulator", _RUN: _RUN}.get(row["better"], unknown)
        metric = metric_of(row["metric"]).title
        rows.append({"metric": metric, "ms": f"{row['budget_ms']:g}", **cells, "better": better})
    return _indexed(rows, ["metric", "ms"])


def _indexed(rows: list[dict[str, str]], names: list[str]) -> pd.DataFrame:
    return pd.DataFrame(rows).set_index(names) if rows else pd.DataFrame()


def _stages(stages: pd.DataFrame) -> pd.DataFrame:
    """Pivot to a row for each stage, and a column for each simulator setting or network."""
    if stages.empty:
        return pd.DataFrame()
    series = stages["series"].str.replace(RAYS_SERIES, "rays", regex=False)
    named = stages.assign(renderer=series + " " + stages["setting"], value=stages["value"].astype(float))
    wide = named.pivot_table(index="quantity", columns="renderer", values="value", sort=False)
    return wide.map(lambda v: "" if pd.isna(v) else f"{v:.1f}").rename_axis("", axis=1).rename_axis("")
