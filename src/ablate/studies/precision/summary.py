"""What was measured, in tables and a verdict: for the screen, for the run's first page and for the docs."""

from __future__ import annotations

from collections.abc import Callable

import pandas as pd

from ablate.analysis import badness, budget_table, facts_of, observed_order
from ablate.studies.precision.simulated import FULL_SERIES, OTHER_SERIES, RAYS_SERIES, REFERENCE_RAYS

WELL_CONVERGED = 0.05
_SAME, _OTHER, _RUN = "simulator, same speckle", "simulator, other speckle", "trained run"


def orders(points: pd.DataFrame) -> pd.DataFrame:
    """Observed order of the simulator, error ~ rays^-p.

    Returns
    -------
    DataFrame
        Columns metric, p, standard_error.
    """
    rows = []
    for metric, of in points[points["series"] == RAYS_SERIES].groupby("metric", sort=False):
        fit = observed_order(of["setting"].astype(float).to_numpy(), of["error"].to_numpy(float), str(metric))
        if fit is not None:
            rows.append({"metric": str(metric), "p": fit.order, "standard_error": fit.standard_error})
    return pd.DataFrame(rows, columns=["metric", "p", "standard_error"])


def floors(points: pd.DataFrame, rays: int) -> dict[str, float]:
    """Re-simulation by metric: other scatterers, all else as the data set."""
    of = points[(points["series"] == OTHER_SERIES) & (points["setting"] == f"rays {rays}")]
    return dict(zip(of["metric"], of["error"].astype(float), strict=True))


def verdict(details: pd.DataFrame) -> str:
    """Whether the reference is converged, in one line."""
    of = details[details["table"] == "reference"].assign(value=lambda d: d["value"].astype(float))
    places = [f"{facts_of(q).label} at {s} rays" for q, s in zip(of["quantity"], of["setting"], strict=True)]
    shares = dict(zip(places, of["value"], strict=True))
    worst = max(shares, key=lambda place: shares[place])
    text = f"Halving the reference's {REFERENCE_RAYS} rays moves the errors by at most {shares[worst]:.1%} ({worst})"
    over = [place for place, share in shares.items() if share >= WELL_CONVERGED]
    return f"{text}; not within {WELL_CONVERGED:.0%}: {', '.join(over)}." if over else f"{text}: it is converged."


def tables(points: pd.DataFrame, details: pd.DataFrame) -> dict[str, pd.DataFrame]:
    """Every table of the summary, its cells as text, by its heading; those without rows are left out.

    Parameters
    ----------
    points : DataFrame
        Columns series, setting, ms, metric, error.
    details : DataFrame
        Columns table, series, setting, quantity, value.
    """

    def of(table: str) -> pd.DataFrame:
        return details[details["table"] == table]

    stages = of("stage")
    simulated = stages["series"].str.startswith("simulator")
    made = {
        "Error to the reference": _errors(points[points["series"] != OTHER_SERIES]),
        f"By how much halving the reference's {REFERENCE_RAYS} rays moves these errors": _spread_out(
            of("reference"), lambda _, share: f"{share:.1%}"
        ),
        "Observed order p, error ~ rays^-p": _orders(points),
        "Error of a grid to a finer one, and of another draw of the speckle on that": _spread_out(
            of("convergence"), _cell
        ),
        "Single precision, bf16 and engines: how far they move a frame": _spread_out(
            _worst(of("limit")), lambda _, value: f"{value:.2g}"
        ),
        "What the plan saves": _plan(points, of("plan")),
        "The best within a budget": _budgets(points),
        "Stages of a simulated frame, ms": _stages(stages[simulated]),
        "Stages of a generated frame, ms": _stages(stages[~simulated]).T,
    }
    return {heading: table for heading, table in made.items() if len(table)}


def as_text(tables: dict[str, pd.DataFrame]) -> str:
    """Tables for a console, each under its heading, never truncated."""
    return "\n\n".join(f"{heading}\n\n{table.to_string()}" for heading, table in tables.items())


def _cell(metric: str, value: float) -> str:
    return f"{value:.{facts_of(metric).decimals}f}"


def _errors(points: pd.DataFrame) -> pd.DataFrame:
    named = points.rename(columns={"metric": "quantity", "error": "value"})
    wide = _spread_out(named, _cell)
    times = points.drop_duplicates(["series", "setting"])["ms"].map("{:.1f}".format)
    wide.insert(0, "ms", times.to_list())
    return wide


def _spread_out(rows: pd.DataFrame, show: Callable[[str, float], str]) -> pd.DataFrame:
    """A row a series and setting, a column a metric."""
    wide: dict[tuple[str, str], dict[str, str]] = {}
    for row in rows.to_dict("records"):
        cells = wide.setdefault((row["series"], row["setting"]), {})
        cells[facts_of(row["quantity"]).title] = show(row["quantity"], float(row["value"]))
    if not wide:
        return pd.DataFrame()
    index = pd.MultiIndex.from_tuples(wide, names=["series", "setting"])
    return pd.DataFrame(list(wide.values()), index).fillna("")


def _worst(limits: pd.DataFrame) -> pd.DataFrame:
    """The largest error of every way over the trained runs; of the simulator as it is."""
    runs = limits[~limits["series"].str.startswith("simulator")]
    if runs.empty:
        return limits
    way = runs["setting"].str.extract(r"(\w+, \w+), seed", expand=False)
    badness_of = [badness(m, v) for m, v in zip(runs["quantity"], runs["value"].astype(float), strict=True)]
    ranked = runs.assign(way=way, badness=badness_of).sort_values("badness", ascending=False, kind="stable")
    worst = ranked.drop_duplicates(["way", "quantity"]).sort_index()
    count = way[runs["quantity"] == runs["quantity"].iloc[0]].value_counts()
    series = [f"trained runs against fp32 eager, worst of {count[w]}" for w in worst["way"]]
    rows = worst.assign(series=series, setting=worst["way"]).sort_values("way", kind="stable")
    return pd.concat([limits.drop(runs.index), rows[limits.columns]])


def _orders(points: pd.DataFrame) -> pd.DataFrame:
    rows = []
    for row in orders(points).to_dict("records"):
        what = "RMS error of the image" if row["metric"] == "psnr" else facts_of(row["metric"]).label
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
    """What is best within each budget; the judgement is between renderers that draw speckle of their own."""
    names = list(dict.fromkeys(points["series"]))
    same = [n for n in names if n.startswith("simulator") and n not in (OTHER_SERIES, FULL_SERIES)]
    runs = [n for n in names if not n.startswith("simulator")]
    found = budget_table(points, {_SAME: same, _OTHER: [OTHER_SERIES], _RUN: runs}, (_OTHER, _RUN))
    rows = []
    for row in found.to_dict("records"):
        cells: dict[str, str] = {}
        for group in (_SAME, _OTHER, _RUN):
            name = row[group].replace("simulator, ", "").replace("other scatterers: ", "")
            cells[group] = f"{_cell(row['metric'], row[f'{group}_error'])} ({name})" if name else ""
        unknown = "not compared" if any(cells.values()) else "none is that fast"
        better = {_OTHER: "simulator", _RUN: _RUN}.get(row["better"], unknown)
        rows.append({"metric": facts_of(row["metric"]).title, "ms": f"{row['budget_ms']:g}", **cells, "better": better})
    return _indexed(rows, ["metric", "ms"])


def _indexed(rows: list[dict[str, str]], names: list[str]) -> pd.DataFrame:
    return pd.DataFrame(rows).set_index(names) if rows else pd.DataFrame()


def _stages(stages: pd.DataFrame) -> pd.DataFrame:
    """A row a stage, a column a renderer."""
    if stages.empty:
        return pd.DataFrame()
    series = stages["series"].str.replace(RAYS_SERIES, "rays", regex=False)
    named = stages.assign(renderer=series + " " + stages["setting"], value=stages["value"].astype(float))
    wide = named.pivot_table(index="quantity", columns="renderer", values="value", sort=False)
    return wide.map(lambda v: "" if pd.isna(v) else f"{v:.1f}").rename_axis("", axis=1).rename_axis("")
