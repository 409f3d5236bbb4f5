"""The comparison table as the paper's Table II, in LaTeX."""

from typing import Any

import pandas as pd

from ablate.analysis.order import REFERENCE, RESIMULATION, variant_group
from ablate.analysis.tables.formats import NOTHING, cell_texts, head, resimulation_note

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


def latex_text(text: str) -> str:
    """Text that LaTeX prints as it stands."""
    text = text.replace("χ²", "\0")
    return "".join(_SPECIAL.get(sign, sign) for sign in text).replace("\0", _SPECIAL["χ²"])


def to_latex(table: pd.DataFrame, reference: str = REFERENCE, label: str = "tab:comparison") -> str:
    r"""A `comparison_table` as a `table*` float that needs the package booktabs, caption included.

    `\ref` calls it `label`. Cells hold mean and standard deviation; the best network is bold, and the re-simulation
    stands above all. Metrics with one value a frame take two columns, those with one value a run take one.
    """
    variants, metrics, cells = cell_texts(table)
    per_frame = table[(table["n"] > table["seeds"]) & table["sd"].notna()]
    double = set(per_frame["metric"])
    titles: dict[str, str] = {}
    columns: dict[tuple[str, str], list[str]] = {}
    for metric in metrics:
        texts, title = [cells[variant, metric] for variant in variants], latex_text(head(metric))
        means = [rf"\textbf{{{mean}}}" if best else latex_text(mean) for mean, _, best in texts]
        if metric in double:
            titles[metric] = title
            columns |= {(metric, "mean"): means, (metric, "sd"): [sd for _, sd, _ in texts]}
        else:
            titles[metric] = rf"\multicolumn{{1}}{{c}}{{{title}}}"
            columns[metric, ""] = means
    shown = pd.DataFrame(columns, [latex_text(variant) for variant in variants]).rename(columns=titles, level=0)
    if not double:
        shown = shown.droplevel(1, axis="columns")
    styler = shown.style.set_table_styles([{"selector": "footnotesize", "props": ":;"}])
    caption, form = latex_text(_caption(table, per_frame, metrics)), "l" + "r" * len(columns)
    layout: dict[str, Any] = {"environment": "table*", "position_float": "centering", "multicol_align": "c"}
    lines = styler.to_latex(column_format=form, caption=caption, label=label, hrules=True, **layout).splitlines()
    # Styler has no rules below titles that span columns, and none between blocks of rows.
    first = lines.index(r"\midrule") + 1
    groups = [variant_group(variant, reference) for variant in variants]
    for k in range(len(groups) - 1, 0, -1):
        if groups[k] != groups[k - 1]:
            lines.insert(first + k, r"\midrule")
    spans = [k for k, (_, below) in enumerate(columns, start=2) if below == "mean"]
    if spans:
        lines.insert(first - 2, " ".join(rf"\cmidrule(lr){{{k}-{k + 1}}}" for k in spans))
    return "\n".join([r"% needs \usepackage{booktabs}", *lines]) + "\n"


def _caption(table: pd.DataFrame, per_frame: pd.DataFrame, metrics: list[str]) -> str:
    networks = table[table["variant"] != RESIMULATION]
    few, many = (int(f(networks["seeds"])) if len(networks) else 0 for f in (min, max))
    seeds = f"{many} seed{'' if many == 1 else 's'}" if few == many else f"{few} to {many} seeds"
    frames = int((per_frame["n"] / per_frame["seeds"]).max()) if len(per_frame) else 0
    said = f"Mean and standard deviation over {frames} test frames of unseen probe sites, {seeds} a network. "
    said += "Bold is the best network."
    return f"{said} {resimulation_note(metrics)}" if RESIMULATION in set(table["variant"]) else said
