"""The comparison table: mean and spread of every metric of every variant; in print, and as the paper's Table II."""

import re
from collections.abc import Collection
from itertools import product
from typing import Any

import numpy as np
import pandas as pd

from ablate.analysis.scored import (
    REFERENCE,
    RESIMULATION,
    every_frame,
    ordered_metrics,
    ordered_variants,
    variant_group,
)
from ablate.metrics import Direction, Resimulation, metric_of
from ablate.metrics.metric import BOUNDS, FRAME_TIME, SCALAR_COLUMNS

NOTHING = "–"  # where a variant has no value
ARROWS = {Direction.higher: "↑", Direction.lower: "↓", Direction.zero: "→0", Direction.none: ""}
_SPECIAL = {
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
    **{sign: rf"\{sign}" for sign in "_%&#${}"},
}


def comparison_table(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, reference: str = REFERENCE
) -> pd.DataFrame:
    """Mean and spread of every metric for every variant.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value: one row a metric of a frame of a run.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value and perhaps lower, upper: one row a metric of a run, as fd_speckle or
        parameters.
    reference : str
        Variant shown first after the re-simulation.

    Returns
    -------
    DataFrame
        One row a variant and metric: columns variant, metric, mean (NaN without one finite value), sd (over frames, as
        the paper has it; over seeds for scalars; half of upper minus lower for times), seed_sd (of the seeds' means;
        None with one seed, and for times), seeds, n, dropped (frames without a finite value), lower, upper (where runs
        carry an interval of their own: the mean of its bounds), best (of the networks, by the mean; where 0 is best, by
        the mean size of the seeds' means; the re-simulation does not compete; all times that the fastest one's spread
        reaches are best).
    """
    parts = [every_frame(per_image)[[*SCALAR_COLUMNS]]]
    if scalars is not None and len(scalars):
        parts.append(scalars[[c for c in (*SCALAR_COLUMNS, *BOUNDS) if c in scalars]])
    values = pd.concat(parts, ignore_index=True)
    rows = []
    for (variant, metric), cell in values.groupby(["variant", "metric"], sort=False):
        finite = cell[np.isfinite(cell["value"])]
        seed_means = finite.groupby("seed")["value"].mean()
        judge, mean = metric_of(str(metric)), float(finite["value"].mean())
        badness = judge.badness(float(seed_means.abs().mean()) if judge.better is Direction.zero else mean)
        sd, seed_sd = (float(v.std()) if len(v) > 1 else None for v in (finite["value"], seed_means))
        # The mean over runs of the bounds of their intervals, where runs carry some.
        lower, upper = (float(cell[b].mean()) if b in cell and cell[b].notna().any() else None for b in BOUNDS)
        if metric == FRAME_TIME and lower is not None and upper is not None:
            sd, seed_sd = (upper - lower) / 2, None
        counts = (int(cell["seed"].nunique()), len(finite), len(cell) - len(finite))
        rows.append((variant, metric, mean, sd, seed_sd, *counts, lower, upper, badness))
    columns = ["variant", "metric", "mean", "sd", "seed_sd", "seeds", "n", "dropped", *BOUNDS, "badness"]
    table = pd.DataFrame(rows, columns=columns)
    every_badness, table["best"] = table.pop("badness"), False
    for metric, group in table[table["variant"] != RESIMULATION].groupby("metric"):
        scores = every_badness[group.index]
        if scores.notna().any() and len(group) > 1:
            best = scores == scores.min()
            if metric == FRAME_TIME:
                best |= group["lower"].astype(float) <= group.loc[best, "upper"].astype(float).max()
            table.loc[scores.index[best], "best"] = True
    order = [*ordered_variants(list(table["variant"]), reference), *ordered_metrics(list(table["metric"]))]
    return table.sort_values(["variant", "metric"], key=lambda names: names.map(order.index), ignore_index=True)


def partly_scored(runs: pd.DataFrame, metrics: Collection[str]) -> list[str]:
    """One sentence on the metrics that only some runs of a variant have, of a table with a row a run; or none."""
    of_variant = runs.groupby("variant")
    rows = [
        f"{metric_of(metric).label} of {variant} ({n} of {trained})"
        for metric in sorted({*metrics} & {*runs})
        for (variant, n), trained in zip(of_variant[metric].count().items(), of_variant.size(), strict=True)
        if 0 < n < trained
    ]
    again = "means and tests are over the runs that have it; the command of the others scores them, if they can be"
    return [f"Not all runs have each metric: {', '.join(rows)}; {again}."] if rows else []


def wide_table(table: pd.DataFrame) -> pd.DataFrame:
    """A `comparison_table` with one row a variant, for `table.csv`.

    Its columns are variant, seeds, `<metric>_mean`, `_sd`, `_seed_sd`, `_lower`, `_upper`; those without a value are
    left out.
    """
    parts = ["mean", "sd", "seed_sd", *BOUNDS]
    wide = table.pivot(index="variant", columns="metric", values=parts).swaplevel(axis="columns")
    metrics, variants = (table[name].unique() for name in ("metric", "variant"))
    wide = wide.reindex(variants).reindex(columns=[(metric, part) for metric in metrics for part in parts])
    wide.columns = pd.Index(["_".join(pair) for pair in wide.columns])
    wide.insert(0, "seeds", table.groupby("variant")["seeds"].max())
    return wide.rename_axis("variant").reset_index().dropna(axis="columns", how="all")


def cell_texts(table: pd.DataFrame) -> tuple[list[str], list[str], dict[tuple[str, str], tuple[str, str, bool]]]:
    """Variants, metrics, and (mean, sd, best) as text by variant and metric, in the order of a `comparison_table`.

    The standard deviation over test frames, which the paper prints, is empty where there is none.
    """
    variants, metrics = (list(dict.fromkeys(table[name])) for name in ("variant", "metric"))
    cells = dict.fromkeys(product(variants, metrics), (NOTHING, "", False))
    for row in table.to_dict("records"):
        decimals = metric_of(row["metric"]).decimals
        sd = "" if pd.isna(row["sd"]) else f"{row['sd']:.{decimals}f}"
        mean = NOTHING if pd.isna(row["mean"]) else f"{row['mean']:.{decimals}f}"
        if row["metric"] == "parameters":
            count, sd = row["mean"], ""
            mean = (
                f"{count:.0f}" if count < 1e4 else f"{count / 1e6:.3g}M" if count < 9.995e8 else f"{count / 1e9:.3g}G"
            )
        cells[row["variant"], row["metric"]] = (mean, sd, bool(row["best"]))
    return variants, metrics, cells


def head(metric: str) -> str:
    """Title of a metric's column, with an arrow to what is better."""
    return f"{metric_of(metric).title} {ARROWS[metric_of(metric).better]}".strip()


def resimulation_note(metrics: list[str]) -> str:
    """One sentence on what the re-simulation row means for these metrics."""
    of_kind = {kind: [m for m in map(metric_of, metrics) if m.resimulation is kind] for kind in Resimulation}
    labels = {kind: ", ".join(metric.label for metric in chosen) for kind, chosen in of_kind.items()}
    sentences = ["Re-simulation is the same frame with other scatterers and ray paths."]
    if floor := labels[Resimulation.floor]:
        sentences.append(f"It is the floor for {floor}.")
    if level := labels[Resimulation.level]:
        sentences.append(f"It is the level of a perfect stochastic renderer for {level}, which a network can exceed.")
    return " ".join(sentences if len(sentences) > 1 else [*sentences, "It is not judged."])


def to_text(table: pd.DataFrame) -> str:
    """A `comparison_table` for a console: aligned lines, never truncated, and a note on the re-simulation.

    The best network of a column carries a star.
    """
    variants, metrics, cells = cell_texts(table)
    columns = {
        head(metric): [
            f"{mean}{' ± ' + sd if sd else ''}{'*' if best else ' '}"
            for mean, sd, best in (cells[variant, metric] for variant in variants)
        ]
        for metric in metrics
    }
    lines = pd.DataFrame(columns, variants).rename_axis(columns="variant").to_string().splitlines()
    note = ["", resimulation_note(metrics)] if RESIMULATION in variants else []
    return "\n".join([lines[0], "-" * len(lines[0]), *lines[1:], *note]) + "\n"


def to_markdown(table: pd.DataFrame) -> str:
    """A `comparison_table` as a pipe table, with the number of seeds; the best network of a column is in bold."""
    variants, metrics, cells = cell_texts(table)
    seeds = table.groupby("variant")["seeds"].max()
    lines = [["variant", "seeds", *map(head, metrics)]]
    lines.append(["---", *["---:"] * (len(metrics) + 1)])
    for variant in variants:
        texts = [cells[variant, metric] for metric in metrics]
        printed = [(f"**{mean}**" if best else mean) + (f" ± {sd}" if sd else "") for mean, sd, best in texts]
        lines.append([variant, NOTHING if variant == RESIMULATION else str(seeds[variant]), *printed])
    return "\n".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |" for line in lines) + "\n"


def latex_text(text: str) -> str:
    """Text that LaTeX prints as it stands."""
    return re.sub("|".join(map(re.escape, _SPECIAL)), lambda sign: _SPECIAL[sign[0]], text)


def to_latex(table: pd.DataFrame, reference: str = REFERENCE, label: str = "tab:comparison") -> str:
    r"""A `comparison_table` as a `table*` float that needs the package booktabs, caption included.

    `\ref` calls it `label`. Cells hold mean and standard deviation; the best network is bold, and the re-simulation
    stands above all. Metrics with one value a frame take two columns, those with one value a run take one.
    """
    variants, metrics, cells = cell_texts(table)
    per_frame = table[(table["n"] > table["seeds"]) & table["sd"].notna()]
    double = set(per_frame["metric"])
    columns: dict[tuple[str, str], list[str]] = {}
    for metric in metrics:
        texts, title = [cells[variant, metric] for variant in variants], latex_text(head(metric))
        means = [rf"\textbf{{{mean}}}" if best else latex_text(mean) for mean, _, best in texts]
        if metric in double:
            columns |= {(title, "mean"): means, (title, "sd"): [sd for _, sd, _ in texts]}
        else:
            columns[rf"\multicolumn{{1}}{{c}}{{{title}}}", ""] = means
    shown = pd.DataFrame(columns, [latex_text(variant) for variant in variants])
    if not double:
        shown = shown.droplevel(1, axis="columns")
    styler = shown.style.set_table_styles([{"selector": "footnotesize", "props": ":;"}])
    caption, form = latex_text(_caption(table, metrics)), "l" + "r" * len(columns)
    layout: dict[str, Any] = {"environment": "table*", "position_float": "centering", "multicol_align": "c"}
    lines = styler.to_latex(column_format=form, caption=caption, label=label, hrules=True, **layout).splitlines()
    # Styler has no rules below titles that span columns, and none between blocks of rows.
    first = lines.index(r"\midrule") + 1
    groups = [variant_group(variant, reference) for variant in variants]
    for k in range(len(groups) - 1, 0, -1):
        if groups[k] != groups[k - 1]:
            lines.insert(first + k, r"\midrule")
    if double:
        spans = [k for k, (_, below) in enumerate(columns, start=2) if below == "mean"]
        lines.insert(first - 2, " ".join(rf"\cmidrule(lr){{{k}-{k + 1}}}" for k in spans))
    return "\n".join([r"% needs \usepackage{booktabs}", *lines]) + "\n"


def _caption(table: pd.DataFrame, metrics: list[str]) -> str:
    networks = table[table["variant"] != RESIMULATION]
    few, many = (int(f(networks["seeds"])) if len(networks) else 0 for f in (min, max))
    seeds = f"{many} seed{'' if many == 1 else 's'}" if few == many else f"{few} to {many} seeds"
    frames = int(((table["n"] + table["dropped"]) / table["seeds"]).max())  # 1 of metrics with a value a run
    note = f" {resimulation_note(metrics)}" if RESIMULATION in set(table["variant"]) else ""
    text = f"Mean and standard deviation over {frames} test frames" if frames > 1 else "Mean"
    return f"{text}, {seeds} a network. Bold is the best network.{note}"
