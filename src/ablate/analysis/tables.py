"""The comparison table in print: in Markdown, and as the paper's Table II."""

import re
from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

import pandas as pd

from ablate.analysis.scored import BASELINE_NAMES, REFERENCE, RESIMULATION, is_network, variant_group
from ablate.metrics import Direction, Resimulation, metric_of

NOTHING = "–"  # where a variant has no value
ARROWS = {Direction.higher: "↑", Direction.lower: "↓", Direction.zero: "→0", Direction.none: ""}
_LATEX = {
    **{sign: rf"\{sign}" for sign in "_%&#${}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "χ²": r"$\chi^2$",
    "±": r"$\pm$",
    "µ": r"$\mu$",
    "↑": r"$\uparrow$",
    "↓": r"$\downarrow$",
    "→": r"$\to$",
    NOTHING: "--",
}


@dataclass(frozen=True)
class Cell:
    """What is printed of a metric of a variant."""

    mean: str = NOTHING
    sd: str = ""  # over test frames, which the paper prints; empty where there is none
    best: bool = False


def cell_texts(table: pd.DataFrame) -> tuple[list[str], list[str], dict[tuple[str, str], Cell]]:
    """Variants, metrics, and what is printed by variant and metric, in the order of a `comparison_table`."""
    variants = list(dict.fromkeys(table["variant"]))
    metrics = list(dict.fromkeys(table["metric"]))
    cells = dict.fromkeys(product(variants, metrics), Cell())
    for row in table.to_dict("records"):
        cells[row["variant"], row["metric"]] = _cell(row)
    return variants, metrics, cells


def _cell(row: Mapping[Hashable, Any]) -> Cell:
    """What is printed of a row of a comparison table."""
    best = bool(row["best"])
    if row["metric"] == "parameters":
        return Cell(mean=_count_text(row["mean"]), best=best)
    decimals = metric_of(row["metric"]).decimals
    return Cell(
        mean=NOTHING if pd.isna(row["mean"]) else f"{row['mean']:.{decimals}f}",
        sd="" if pd.isna(row["sd"]) else f"{row['sd']:.{decimals}f}",
        best=best,
    )


def _count_text(count: float) -> str:
    """A number of parameters, in millions or thousands of millions where it is large."""
    if count < 1e4:
        return f"{count:.0f}"
    if count < 9.995e8:
        return f"{count / 1e6:.3g}M"
    return f"{count / 1e9:.3g}G"


def head(metric: str) -> str:
    """Title of a metric's column, with an arrow to what is better."""
    entry = metric_of(metric)
    return f"{entry.title} {ARROWS[entry.better]}".strip()


def resimulation_note(metrics: list[str]) -> str:
    """One sentence on what the re-simulation row means for these metrics."""
    floors = _labels_where(Resimulation.floor, metrics)
    levels = _labels_where(Resimulation.level, metrics)
    sentences = ["Re-simulation is the same frame with other scatterers and ray paths."]
    if floors:
        sentences.append(f"It is the floor for {floors}.")
    if levels:
        exceeded = "which a network exceeds that smooths speckle away, or that knows the scatterers (noise=body)"
        sentences.append(f"It is the level of a perfect stochastic renderer for {levels}, {exceeded}.")
    if not floors and not levels:
        sentences.append("It is not judged.")
    return " ".join(sentences)


def _labels_where(resimulation: Resimulation, metrics: list[str]) -> str:
    """Labels of the metrics that re-simulation tells this of."""
    return ", ".join(metric_of(name).label for name in metrics if metric_of(name).resimulation is resimulation)


def to_markdown(table: pd.DataFrame) -> str:
    """A `comparison_table` as a pipe table, with the number of seeds; the best network of a column is in bold."""
    variants, metrics, cells = cell_texts(table)
    seeds = table.groupby("variant")["seeds"].max()
    lines = [
        ["variant", "seeds", *(head(metric) for metric in metrics)],
        ["---", "---:", *("---:" for _ in metrics)],
    ]
    for variant in variants:
        trained = NOTHING if variant in BASELINE_NAMES else str(seeds[variant])
        lines.append([variant, trained, *(_emphasised(cells[variant, metric]) for metric in metrics)])
    rows = [" | ".join(text.replace("|", r"\|") for text in line) for line in lines]
    return "".join(f"| {row} |\n" for row in rows)


def _emphasised(cell: Cell) -> str:
    mean = f"**{cell.mean}**" if cell.best else cell.mean
    return f"{mean} ± {cell.sd}" if cell.sd else mean


def latex_text(text: str) -> str:
    """Text that LaTeX prints as it stands."""
    return re.sub("|".join(map(re.escape, _LATEX)), lambda sign: _LATEX[sign[0]], text)


def to_latex(table: pd.DataFrame, reference: str = REFERENCE, label: str = "tab:comparison") -> str:
    r"""A `comparison_table` as a `table*` float that needs the package booktabs, caption included.

    `\ref` calls it `label`. Cells hold mean and standard deviation; the best network is bold, and the re-simulation
    stands above all. Metrics with one value a frame take two columns, those with one value a run take one.
    """
    variants, metrics, cells = cell_texts(table)
    per_frame = table[(table["n"] > table["seeds"]) & table["sd"].notna()]
    with_sd = set(per_frame["metric"])
    columns: dict[tuple[str, str], list[str]] = {}
    for metric in metrics:
        title = latex_text(head(metric))
        means = [_bold_or_plain(cells[variant, metric]) for variant in variants]
        if metric in with_sd:
            columns[title, "mean"] = means
            columns[title, "sd"] = [cells[variant, metric].sd for variant in variants]
        else:
            columns[rf"\multicolumn{{1}}{{c}}{{{title}}}", ""] = means
    shown = pd.DataFrame(columns, [latex_text(variant) for variant in variants])
    if not with_sd:
        shown = shown.droplevel(1, axis="columns")
    layout: dict[str, Any] = {"environment": "table*", "position_float": "centering", "multicol_align": "c"}
    styler = shown.style.set_table_styles([{"selector": "footnotesize", "props": ":;"}])
    latex = styler.to_latex(
        column_format="l" + "r" * len(columns),
        caption=latex_text(_caption(table, metrics)),
        label=label,
        hrules=True,
        **layout,
    )
    lines = latex.splitlines()
    # Styler has no rules below titles that span columns, and none between blocks of rows.
    first = lines.index(r"\midrule") + 1
    groups = [variant_group(variant, reference) for variant in variants]
    for k in range(len(groups) - 1, 0, -1):
        if groups[k] != groups[k - 1]:
            lines.insert(first + k, r"\midrule")
    if with_sd:
        spans = [k for k, (_, below) in enumerate(columns, start=2) if below == "mean"]
        lines.insert(first - 2, " ".join(rf"\cmidrule(lr){{{k}-{k + 1}}}" for k in spans))
    return "\n".join([r"% needs \usepackage{booktabs}", *lines]) + "\n"


def _bold_or_plain(cell: Cell) -> str:
    return rf"\textbf{{{cell.mean}}}" if cell.best else latex_text(cell.mean)


def _caption(table: pd.DataFrame, metrics: list[str]) -> str:
    networks = table[is_network(table["variant"])]
    frames = int(((table["n"] + table["dropped"]) / table["seeds"]).max())  # 1 of metrics with a value a run
    text = f"Mean and standard deviation over {frames} test frames" if frames > 1 else "Mean"
    note = f" {resimulation_note(metrics)}" if RESIMULATION in set(table["variant"]) else ""
    seeds = least_to_most(networks["seeds"])
    return f"{text}, {seeds} seed{'' if seeds == '1' else 's'} a network. Bold is the best network.{note}"


def least_to_most(counts: pd.Series) -> str:
    """Counts in words: `2 to 4`, `3` where all are equal, and `0` where there is none."""
    few, many = (counts.min(), counts.max()) if len(counts) else (0, 0)
    return f"{few} to {many}" if few < many else str(many)
