"""The comparison table as the paper's Table II, in LaTeX."""

from __future__ import annotations

from itertools import pairwise

import pandas as pd

from ablate.analysis.metric_facts import REFERENCE, RESIMULATION, Better, facts_of
from ablate.analysis.order import variant_group
from ablate.analysis.table_formats import NOTHING, cell_texts, resimulation_note

_ARROWS = {Better.larger: r" $\uparrow$", Better.smaller: r" $\downarrow$", Better.nearest_zero: r" $\to 0$"}
_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "χ²": r"$\chi^2$",
    "±": r"$\pm$",
    "µ": r"$\mu$",
    NOTHING: "--",
    **{sign: rf"\{sign}" for sign in "_%&#${}"},
}


def latex_text(text: str) -> str:
    """Text that LaTeX prints as it stands.

    Parameters
    ----------
    text : str

    Returns
    -------
    str
    """
    text = text.replace("χ²", "\0")
    return "".join(_SPECIAL.get(sign, sign) for sign in text).replace("\0", _SPECIAL["χ²"])


def to_latex(table: pd.DataFrame, reference: str = REFERENCE, label: str = "tab:comparison") -> str:
    """The table for a paper: mean and standard deviation, the best network in bold, the re-simulation above all.

    Metrics with one value a frame take two columns, those with one value a run one.

    Parameters
    ----------
    table : DataFrame
        What `comparison_table` gives.
    reference : str
        Variant that has a block of rows to itself.
    label : str
        What `\ref` calls it.

    Returns
    -------
    str
        A `table*` float that needs the package booktabs, caption included.
    """
    variants, metrics, cells = cell_texts(table)
    per_frame = table[(table["n"] > table["seeds"]) & table["sd"].notna()]
    double = [m for m in metrics if m in set(per_frame["metric"])]
    heads, rules, below, column = [""], [], [""], 2
    for metric in metrics:
        title = latex_text(facts_of(metric).title) + _ARROWS.get(facts_of(metric).better, "")
        wide = 2 if metric in double else 1
        heads.append(rf"\multicolumn{{{wide}}}{{c}}{{{title}}}")
        below += ["mean", "sd"] if wide == 2 else [""]
        if wide == 2:
            rules.append(rf"\cmidrule(lr){{{column}-{column + 1}}}")
        column += wide
    rows = []
    for variant in variants:
        line = [latex_text(variant)]
        for metric in metrics:
            mean, sd, best = cells.get((variant, metric), (NOTHING, "", False))
            line.append(rf"\textbf{{{mean}}}" if best else latex_text(mean))
            if metric in double:
                line.append(sd)
        rows.append(" & ".join(line) + r" \\")
    body = [rows[0]] if rows else []
    for row, (above, variant) in zip(rows[1:], pairwise(variants), strict=True):
        if variant_group(above, reference) != variant_group(variant, reference):
            body.append(r"\midrule")
        body.append(row)
    lines = [
        r"% needs \usepackage{booktabs}",
        r"\begin{table*}",
        rf"\caption{{{latex_text(_caption(table, per_frame, metrics))}}}",
        rf"\label{{{label}}}",
        r"\centering\footnotesize",
        rf"\begin{{tabular}}{{l{'r' * (len(metrics) + len(double))}}}",
        r"\toprule",
        " & ".join(heads) + r" \\",
        *([" ".join(rules), " & ".join(below) + r" \\"] if double else []),
        r"\midrule",
        *body,
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table*}",
    ]
    return "\n".join(lines) + "\n"


def _caption(table: pd.DataFrame, per_frame: pd.DataFrame, metrics: list[str]) -> str:
    networks = table[table["variant"] != RESIMULATION]
    few, many = (int(f(networks["seeds"])) if len(networks) else 0 for f in (min, max))
    seeds = f"{many} seed{'' if many == 1 else 's'}" if few == many else f"{few} to {many} seeds"
    frames = int((per_frame["n"] / per_frame["seeds"]).max()) if len(per_frame) else 0
    said = f"Mean and standard deviation over {frames} test frames of unseen probe sites, {seeds} a network. "
    said += "Bold is the best network."
    return f"{said} {resimulation_note(metrics)}" if RESIMULATION in set(table["variant"]) else said
