"""The comparison table in print: CSV, Markdown, HTML and the console."""

from __future__ import annotations

from enum import StrEnum
from html import escape

import pandas as pd

from ablate.analysis.metric_facts import RESIMULATION, Better, Resimulation, facts_of

NOTHING = "–"  # where a variant has no value
ARROWS = {Better.larger: "↑", Better.smaller: "↓", Better.nearest_zero: "→0", Better.unjudged: ""}


def wide_table(table: pd.DataFrame) -> pd.DataFrame:
    """One row a variant; columns seeds, `<metric>_mean`, `_sd`, `_seed_sd`, `_low`, `_high`: for `table.csv`.

    Parameters
    ----------
    table : DataFrame
        What `comparison_table` gives.

    Returns
    -------
    DataFrame
    """
    rows: dict[str, dict[str, object]] = {}
    seeds = table.groupby("variant")["seeds"].max()
    for cell in table.to_dict("records"):
        variant, metric = cell["variant"], cell["metric"]
        row = rows.setdefault(variant, {"variant": variant, "seeds": int(seeds[variant])})
        row |= {f"{metric}_{part}": cell[part] for part in ("mean", "sd", "seed_sd", "low", "high")}
    return pd.DataFrame(list(rows.values())).dropna(axis="columns", how="all")


class Spread(StrEnum):
    """What stands behind the ± of a cell."""

    frames = "sd"  # standard deviation over test frames, as the paper prints it
    seeds = "seed_sd"  # standard deviation of the means of the seeds: how far another training would be off


def cell_texts(
    table: pd.DataFrame, spread: Spread = Spread.frames
) -> tuple[list[str], list[str], dict[tuple[str, str], tuple[str, str, bool]]]:
    """Variants, metrics, and (mean, spread, best) as text by variant and metric.

    Parameters
    ----------
    table : DataFrame
        What `comparison_table` gives.
    spread : Spread

    Returns
    -------
    variants, metrics : list of str
        In the order of the table.
    cells : dict of (variant, metric) to (str, str, bool)
        The spread is empty where there is none.
    """
    cells = {}
    for row in table.to_dict("records"):
        decimals = facts_of(row["metric"]).decimals
        sd = "" if pd.isna(row[spread.value]) else f"{row[spread.value]:.{decimals}f}"
        mean = NOTHING if pd.isna(row["mean"]) else f"{row['mean']:.{decimals}f}"
        if row["metric"] == "parameters":
            mean, sd = f"{row['mean'] / 1e6:.3g}M", ""
        cells[row["variant"], row["metric"]] = (mean, sd, bool(row["best"]))
    return list(dict.fromkeys(table["variant"])), list(dict.fromkeys(table["metric"])), cells


def resimulation_note(metrics: list[str]) -> str:
    """One sentence on what the re-simulation row means for these metrics.

    Parameters
    ----------
    metrics : list of str

    Returns
    -------
    str
    """
    floor, level = (
        ", ".join(facts_of(m).label for m in metrics if facts_of(m).resimulation is kind)
        for kind in (Resimulation.floor, Resimulation.level)
    )
    parts = []
    if floor:
        parts.append(f"it is the floor for {floor}")
    if level:
        parts.append(f"it is the level of a perfect stochastic renderer for {level}, not a bound")
    meaning = "; ".join(parts) or "it is not judged"
    return f"Re-simulation is the same frame with other scatterers: {meaning}."


def to_text(table: pd.DataFrame) -> str:
    """The table for a console; the best network of a column carries a star.

    Parameters
    ----------
    table : DataFrame
        What `comparison_table` gives.

    Returns
    -------
    str
        Aligned lines, never truncated, and a note on the re-simulation.
    """
    variants, metrics, cells = cell_texts(table)
    lines = [["variant", *(f"{facts_of(m).title} {ARROWS[facts_of(m).better]}".strip() for m in metrics)]]
    for variant in variants:
        line = [variant]
        for metric in metrics:
            mean, sd, best = cells.get((variant, metric), (NOTHING, "", False))
            line.append(f"{mean}{' ± ' + sd if sd else ''}{'*' if best else ' '}")
        lines.append(line)
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    text = [
        "  ".join(cell.rjust(w) if k else cell.ljust(w) for k, (cell, w) in enumerate(zip(line, widths, strict=True)))
        for line in lines
    ]
    text.insert(1, "-" * len(text[0]))
    if RESIMULATION in variants:
        text += ["", resimulation_note(metrics)]
    return "\n".join(text) + "\n"


def to_markdown(table: pd.DataFrame, spread: Spread = Spread.frames) -> str:
    """The table in Markdown, the best network of a column in bold.

    Parameters
    ----------
    table : DataFrame
        What `comparison_table` gives.
    spread : Spread
        What the ± of a cell is.

    Returns
    -------
    str
        A pipe table, with the number of seeds.
    """
    variants, metrics, cells = cell_texts(table, spread)
    seeds = table.groupby("variant")["seeds"].max()
    lines = [["variant", "seeds", *(f"{facts_of(m).title} {ARROWS[facts_of(m).better]}".strip() for m in metrics)]]
    lines.append(["---", *["---:"] * (len(metrics) + 1)])
    for variant in variants:
        line = [variant, NOTHING if variant == RESIMULATION else str(seeds[variant])]
        for metric in metrics:
            mean, sd, best = cells.get((variant, metric), (NOTHING, "", False))
            line.append((f"**{mean}**" if best else mean) + (f" ± {sd}" if sd else ""))
        lines.append(line)
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines) + "\n"


def to_html(table: pd.DataFrame) -> str:
    """The table as an HTML element.

    Parameters
    ----------
    table : DataFrame
        What `comparison_table` gives.

    Returns
    -------
    str
    """
    variants, metrics, cells = cell_texts(table)
    heads = "".join(f"<th>{escape(facts_of(m).title)} {ARROWS[facts_of(m).better]}</th>" for m in metrics)
    rows = []
    for variant in variants:
        row = [f"<th>{escape(variant)}</th>"]
        for metric in metrics:
            mean, sd, best = cells.get((variant, metric), (NOTHING, "", False))
            shown = f"<b>{mean}</b>" if best else mean
            row.append(f"<td>{shown}{f' <small>± {sd}</small>' if sd else ''}</td>")
        style = ' class="resimulation"' if variant == RESIMULATION else ""
        rows.append(f"<tr{style}>{''.join(row)}</tr>")
    return f"<table><thead><tr><th>variant</th>{heads}</tr></thead><tbody>{''.join(rows)}</tbody></table>"
