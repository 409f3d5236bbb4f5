"""Which network is best, by how much, and the comparison as lines for a terminal."""

import math
import re
from collections.abc import Mapping
from textwrap import wrap

import numpy as np
import pandas as pd

from ablate.analysis.scored import BASELINE_NAMES, judged_metrics
from ablate.analysis.tables import ARROWS, Cell, cell_texts, head, resimulation_note
from ablate.metrics import Direction, is_own, metric_of

#: The metric that networks are ordered by: no network can do better than re-simulation, and blur does not help.
RANKED_BY = "pchi2"
SCREEN_COLUMNS = 100
_NAME_COLUMNS = 40  # a longer name of a variant takes several lines
_GAP = 2  # between columns
_UNITS = {"grey levels": "grey"}  # in titles of columns


def ranked_by(table: pd.DataFrame) -> str | None:
    """The metric that the networks of a `comparison_table` are ordered by: `RANKED_BY`, or the first that judges."""
    networks = table[~table["variant"].isin(BASELINE_NAMES) & table["mean"].notna()]
    metrics = judged_metrics(list(networks["metric"]))
    judging = [name for name in metrics if metric_of(name).better is not Direction.none]
    return RANKED_BY if RANKED_BY in judging else next(iter(judging), None)


def best_first(table: pd.DataFrame) -> list[str]:
    """The networks of a `comparison_table`, best first, those without a value last; then the baselines."""
    variants = list(dict.fromkeys(table["variant"]))
    networks = [name for name in variants if name not in BASELINE_NAMES]
    metric = ranked_by(table)
    if metric is not None:
        rows = table[table["metric"] == metric].set_index("variant")
        best = {name: bool(rows["best"].get(name, False)) for name in networks}
        badness = {name: metric_of(metric).badness(float(rows["mean"].get(name, math.nan))) for name in networks}
        networks.sort(key=lambda name: (not best[name], math.isnan(badness[name]), badness[name]))
    return [*networks, *(name for name in BASELINE_NAMES if name in variants)]


def best_in_words(table: pd.DataFrame, claims: pd.DataFrame, reference: str) -> str:
    """Which network is best, and by how much: against the reference, or where that is best against the next.

    `claims` is a table of `seed_claims`, with differences to the reference over seeds.
    """
    metric = ranked_by(table)
    if metric is None:
        return "no metric of this comparison says which network is better"
    rows = table[(table["metric"] == metric) & table["mean"].notna()].set_index("variant")
    order = [name for name in best_first(table) if name in rows.index]
    networks = [name for name in order if name not in BASELINE_NAMES]
    cells = cell_texts(table)[2]
    best, others = networks[0], networks[1:]
    found = f"{best} by {head(metric)}: {cells[best, metric].mean}"
    parts = [f"{name} {cells[name, metric].mean}" for name in order if name in BASELINE_NAMES]
    if not others:
        alone = "the only network" if set(rows.index) >= set(table["variant"]) else "the only network with this score"
        return f"{found}, {alone}" + (f" ({', '.join(parts)})" if parts else "")
    other = reference if reference in others else others[0]
    parts.insert(0, f"{other} {cells[other, metric].mean}")
    return f"{found} ({', '.join(parts)}); {_difference(claims, metric, best, other, reference)}"


def _difference(claims: pd.DataFrame, metric: str, best: str, other: str, reference: str) -> str:
    """The difference of two networks with its interval over seeds, as far as there are seeds to tell."""
    rows = claims[(claims["metric"] == metric) & (claims["variant"] == (other if best == reference else best))]
    if reference not in (best, other) or rows.empty:
        return f"compare them with reference={other}"
    row = rows.iloc[0]
    if pd.isna(row["shift"]) or pd.isna(row["lower"]):
        return "too few seeds to say more than that of these trained networks"
    sign = -1 if best == reference else 1  # the table has what the other one adds to the reference
    values = sorted([sign * row["lower"], sign * row["upper"]])
    shift, lower, upper = (f"{value:+.{metric_of(metric).decimals}f}" for value in (sign * row["shift"], *values))
    verdict = {"differs": "more than seeds explain"}.get(row["verdict"], row["verdict"])
    return f"a difference of {shift} [{lower}, {upper}] over {row['seeds']} seeds: {verdict}"


def to_text(table: pd.DataFrame, columns: int = SCREEN_COLUMNS) -> str:
    """A `comparison_table` for a terminal of so many columns: best first, baselines below a rule, and a note on them.

    A star is on the best network of a column. The metric that orders the networks is the first column, those of the
    user follow, and others are left out, from the end, where they do not fit; the last line names them.
    """
    cells = cell_texts(table)[2]
    order, by = best_first(table), ranked_by(table)
    metrics = sorted(dict.fromkeys(table["metric"]), key=lambda name: (name != by, not is_own(metric_of(name))))
    titles = {metric: _title(metric, [cells[variant, metric] for variant in order]) for metric in metrics}
    printed = {metric: [_value(cells[variant, metric]) for variant in order] for metric in metrics}
    widths = {metric: max(map(len, [*titles[metric], *printed[metric]])) for metric in metrics}
    names = {variant: _filled(re.split(r"(?=\.)", variant), "", _NAME_COLUMNS) for variant in order}
    width = max((len(line) for lines in names.values() for line in lines), default=0)
    ends = np.cumsum([width, *(_GAP + widths[metric] for metric in metrics)])
    shown = metrics[: int((ends[1:] <= columns).sum())]
    depth = max((len(titles[metric]) for metric in shown), default=1)
    rule = "-" * ends[len(shown)]

    def line(name: str, values: Mapping[str, str]) -> str:
        return name.ljust(width) + "".join(" " * _GAP + values[metric].rjust(widths[metric]) for metric in shown)

    padded = {metric: [""] * (depth - len(titles[metric])) + titles[metric] for metric in shown}
    lines = [line("", {metric: padded[metric][k] for metric in shown}) for k in range(depth)]
    above = None
    for variant in order:
        if above is None or (variant in BASELINE_NAMES and above not in BASELINE_NAMES):
            lines.append(rule)
        *begun, last = names[variant]
        lines += [*begun, line(last, {metric: _value(cells[variant, metric]) for metric in shown})]
        above = variant
    notes = [resimulation_note(shown)] if set(order) & set(BASELINE_NAMES) else []
    if len(shown) < len(metrics):
        notes.append(f"Not shown: {', '.join(metric_of(name).label for name in metrics[len(shown) :])}.")
    words = [text for note in notes for text in ("", *wrap(note, columns))]
    return "\n".join(text.rstrip() for text in [*lines, *words]) + "\n"


def _title(metric: str, column: list[Cell]) -> list[str]:
    """The lines of a column's title, none wider than its widest word or value: its words, then unit and arrow."""
    entry = metric_of(metric)
    arrow = ARROWS[entry.better]
    unit = _UNITS.get(entry.unit, entry.unit)
    words = [*entry.label.split(), *([f"({unit})"] if unit else [])]
    words[-1] += f" {arrow}" if arrow else ""
    width = max(len(text) for text in (*words, *(_value(cell) for cell in column)))
    return _filled(words, " ", width)


def _filled(words: list[str], space: str, width: int) -> list[str]:
    """Lines of as many words as fit; a longer word has its own line."""
    lines = words[:1]
    for word in words[1:]:
        longer = f"{lines[-1]}{space}{word}"
        lines[-1:] = [longer] if len(longer) <= width else [lines[-1], word]
    return lines


def _value(cell: Cell) -> str:
    return f"{cell.mean}{'*' if cell.best else ' '}"
