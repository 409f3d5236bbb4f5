"""The comparison table in print: CSV, Markdown and the console."""

from enum import StrEnum
from itertools import product

import pandas as pd

from ablate.analysis.order import RESIMULATION
from ablate.metrics import Direction, Resimulation, metric_of

NOTHING = "–"  # where a variant has no value
ARROWS = {Direction.higher: "↑", Direction.lower: "↓", Direction.zero: "→0", Direction.none: ""}


def wide_table(table: pd.DataFrame) -> pd.DataFrame:
    """A `comparison_table` with one row a variant, for `table.csv`.

    Its columns are variant, seeds, `<metric>_mean`, `_sd`, `_seed_sd`, `_lower`, `_upper`; those without a value are
    left out.
    """
    rows: dict[str, dict[str, object]] = {}
    seeds = table.groupby("variant")["seeds"].max()
    for cell in table.to_dict("records"):
        variant, metric = cell["variant"], cell["metric"]
        row = rows.setdefault(variant, {"variant": variant, "seeds": int(seeds[variant])})
        row |= {f"{metric}_{part}": cell[part] for part in ("mean", "sd", "seed_sd", "lower", "upper")}
    return pd.DataFrame(list(rows.values())).dropna(axis="columns", how="all")


class Spread(StrEnum):
    """What stands behind the ± of a cell."""

    frames = "sd"  # standard deviation over test frames, as the paper prints it
    seeds = "seed_sd"  # standard deviation of the means of the seeds: how far another training would be off


def cell_texts(
    table: pd.DataFrame, spread: Spread = Spread.frames
) -> tuple[list[str], list[str], dict[tuple[str, str], tuple[str, str, bool]]]:
    """Variants, metrics, and (mean, spread, best) as text by variant and metric, in the order of a `comparison_table`.

    The spread is empty where there is none.
    """
    variants, metrics = (list(dict.fromkeys(table[name])) for name in ("variant", "metric"))
    cells = dict.fromkeys(product(variants, metrics), (NOTHING, "", False))
    for row in table.to_dict("records"):
        decimals = metric_of(row["metric"]).decimals
        sd = "" if pd.isna(row[spread.value]) else f"{row[spread.value]:.{decimals}f}"
        mean = NOTHING if pd.isna(row["mean"]) else f"{row['mean']:.{decimals}f}"
        if row["metric"] == "parameters":
            mean, sd = f"{row['mean'] / 1e6:.3g}M", ""
        cells[row["variant"], row["metric"]] = (mean, sd, bool(row["best"]))
    return variants, metrics, cells


def head(metric: str) -> str:
    """Title of a metric's column, with an arrow to what is better."""
    return f"{metric_of(metric).title} {ARROWS[metric_of(metric).better]}".strip()


def resimulation_note(metrics: list[str]) -> str:
    """One sentence on what the re-simulation row means for these metrics."""
    floor, level = (
        ", ".join(metric_of(m).label for m in metrics if metric_of(m).resimulation is kind)
        for kind in (Resimulation.floor, Resimulation.level)
    )
    parts = []
    if floor:
        parts.append(f"It is the floor for {floor}.")
    if level:
        parts.append(f"It is the level of a perfect stochastic renderer for {level}, which a network can exceed.")
    return " ".join(
        ["Re-simulation is the same frame with other scatterers and ray paths.", *(parts or ["It is not judged."])]
    )


def to_text(table: pd.DataFrame) -> str:
    """A `comparison_table` for a console: aligned lines, never truncated, and a note on the re-simulation.

    The best network of a column carries a star.
    """
    variants, metrics, cells = cell_texts(table)
    lines = [["variant", *map(head, metrics)]]
    for variant in variants:
        texts = [cells[variant, metric] for metric in metrics]
        lines.append(
            [variant, *(f"{mean}{' ± ' + sd if sd else ''}{'*' if best else ' '}" for mean, sd, best in texts)]
        )
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    text = [
        "  ".join([line[0].ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(line[1:], widths[1:], strict=True))])
        for line in lines
    ]
    text.insert(1, "-" * len(text[0]))
    if RESIMULATION in variants:
        text += ["", resimulation_note(metrics)]
    return "\n".join(text) + "\n"


def to_markdown(table: pd.DataFrame, spread: Spread = Spread.frames) -> str:
    """A `comparison_table` as a pipe table, with the number of seeds; the best network of a column is in bold."""
    variants, metrics, cells = cell_texts(table, spread)
    seeds = table.groupby("variant")["seeds"].max()
    lines = [["variant", "seeds", *map(head, metrics)]]
    lines.append(["---", *["---:"] * (len(metrics) + 1)])
    for variant in variants:
        texts = [cells[variant, metric] for metric in metrics]
        printed = [(f"**{mean}**" if best else mean) + (f" ± {sd}" if sd else "") for mean, sd, best in texts]
        lines.append([variant, NOTHING if variant == RESIMULATION else str(seeds[variant]), *printed])
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines) + "\n"
