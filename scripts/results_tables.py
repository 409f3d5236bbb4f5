"""The tables of docs/results.md in Markdown, made from those of `ablate.analysis`; results_page.py calls them."""

from collections.abc import Callable, Iterable, Sequence

import pandas as pd

from ablate.analysis import RESIMULATION, Answer, Verdict
from ablate.analysis.statistics.verdicts import ALPHA
from ablate.analysis.tables import NOTHING, head
from ablate.metrics import Direction, metric_of
from ablate.settings.conf import components

# What the full model is to reach, from its mean and that of re-simulation.
BARS: dict[str, tuple[str, Callable[[float, float], bool]]] = {
    "pchi2_tissue": ("at most 2 times re-simulation", lambda value, level: value <= 2 * level),
    "mae_smooth": ("at most 2.5 times re-simulation", lambda value, level: value <= 2.5 * level),
    "fd_speckle": ("below 1", lambda value, _: value < 1),
    "noise_sd": ("above half of re-simulation", lambda value, level: value > level / 2),
}
NAMES = {component.key: component.name for component in components()}


def pipe_table(head_cells: Sequence[str], rows: Iterable[Sequence[str]], words: int = 1) -> str:
    """A pipe table; the first `words` columns hold words, the others numbers."""
    under = ["---"] * words + ["---:"] * (len(head_cells) - words)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head_cells, under, *rows))


def signed(value: float | None, decimals: int) -> str:
    """A number with its sign; a dash where it is missing, and no sign where it is printed as zero."""
    if value is None or pd.isna(value):
        return NOTHING
    text = f"{value:+,.{decimals}f}"
    return text.replace("-", "−") if text.strip("+-0.,") else text[1:]


def with_interval(value: float, lower: float, upper: float, decimals: int) -> str:
    """`+1.2 [+0.8, +1.6]`, without the brackets where there is no interval."""
    if pd.isna(lower):
        return signed(value, decimals)
    return f"{signed(value, decimals)} [{signed(lower, decimals)}, {signed(upper, decimals)}]"


def probability(p: float) -> str:
    """Three decimals; what is smaller is said to be smaller."""
    return NOTHING if pd.isna(p) else "< 0.001" if p < 0.001 else f"{p:.3f}"


def verdict_rows(verdicts: pd.DataFrame, preliminary: bool) -> str:
    """What `verdict_table` gives, a row a component."""
    rows = []
    for row in verdicts.to_dict("records"):
        metric = metric_of(row["metric"])
        effects = [
            with_interval(row[part], row[f"{side}lower"], row[f"{side}upper"], metric.decimals)
            for part, side in (("effect", ""), ("full_effect", "full_"))
        ]
        word = f"**{Answer(row['verdict']).replace('_', ' ')}**" + (" (preliminary)" if preliminary else "")
        chances = (probability(row[name]) for name in ("p_holm", "p_band_holm"))
        costs = signed(row["ms_per_frame"], 1), signed(row["parameters"] / 1000, 0)
        rows.append([row["component"], head(row["metric"]), word, *effects, f"{row['band']:g}", *chances, *costs])
    titles = ("effect [95 %]", "at the full model", "band", "p (zero)", "p (band)", "ms a frame", "parameters (1000)")
    return pipe_table(("component", "metric", "verdict", *titles), rows, 3)


def claim_rows(claims: pd.DataFrame) -> str:
    """What `seed_claims` gives, a row a variant and a column a metric."""
    metrics = list(dict.fromkeys(claims["metric"]))
    rows = []
    for variant, of in claims.groupby("variant", sort=False):
        shifts = dict.fromkeys(metrics, NOTHING)
        for row in of.to_dict("records"):
            text = signed(row["shift"], metric_of(row["metric"]).decimals)
            around = {Verdict.differs: "**", Verdict.suggested: "*"}.get(row["verdict"], "")
            shifts[row["metric"]] = f"{around}{text}{around}"
        rows.append([str(variant), *shifts.values()])
    return pipe_table(("variant", *map(head, metrics)), rows)


def shortfalls(table: pd.DataFrame, labels: Sequence[str]) -> str:
    """How far networks are from re-simulation, against the bars; a row a metric of a `comparison_table`."""
    means = table.pivot(index="metric", columns="variant", values="mean")
    labels = [label for label in labels if label in means]
    if RESIMULATION not in means or not labels:
        return ""
    rows = []
    for name, (bar, reached) in BARS.items():
        if name in means.index:
            level, decimals = float(means.at[name, RESIMULATION]), metric_of(name).decimals
            values = {label: float(means.at[name, label]) for label in labels}
            is_relative = RESIMULATION in bar
            ratios = {label: f"{value / level:.2f}" if is_relative else NOTHING for label, value in values.items()}
            cells = [cell for label, v in values.items() for cell in (f"{v:.{decimals}f}", ratios[label])]
            met = [label for label, value in values.items() if reached(value, level)]
            rows.append([head(name), bar, ", ".join(met) or "none", f"{level:.{decimals}f}", *cells])
    titles = [title for label in labels for title in (label, "ratio")]
    return pipe_table(("metric", "bar", "reached by", RESIMULATION, *titles), rows, 3)


def paper_rows(paper: pd.DataFrame) -> str:
    """What `paper_effects` gives: the paper's differences beside ours; a row a component and metric."""
    rows = []
    for _, row in paper.iterrows():
        ours = [row[["averaged", "averaged_lower", "averaged_upper"]], row[["effect", "lower", "upper"]]]
        metric = metric_of(row["metric"])
        cells = [with_interval(*effect, metric.decimals) for effect in ours]
        said = _excluded(row["paper"], metric.better, *ours)
        rows.append([row["component"], head(metric.name), said, signed(row["paper"], metric.decimals), *cells])
    titles = ("paper", "here, averaged [95 %]", "here, at the full model [95 %]")
    return pipe_table(("component", "metric", "excluded", *titles), rows, 3) if rows else ""


def _excluded(paper: float, better: Direction, averaged: Sequence[float], full: Sequence[float]) -> str:
    """Whether effects, each with the ends of its interval, exclude a difference of the paper's size."""
    sign = 1 if better is Direction.higher else -1
    said = []
    for estimate, lower, upper in (averaged, full):
        less = sign * estimate < sign * paper
        said.append("no" if lower <= paper <= upper else "less here" if less else "more here")
    return said[0] if len(set(said)) == 1 else f"averaged: {said[0]}; full model: {said[1]}"


def interaction_rows(pairs: pd.DataFrame, verdicts: pd.DataFrame) -> str:
    """What `interactions` gives, a row a component and a column the other one."""
    if pairs.empty:
        return ""
    metrics = dict(zip(verdicts["component"], verdicts["metric"], strict=True))
    names = [c.name for c in components() if c.name in {*pairs["component"], *pairs["other"]}]
    cells = {(row["component"], row["other"]): row for row in pairs.to_dict("records")}

    def cell(name: str, other: str) -> str:
        if (name, other) not in cells:
            return NOTHING
        row = cells[name, other]
        text = signed(row["improvement"], metric_of(metrics[name]).decimals)
        return f"**{text}**" if row["q"] < ALPHA else text

    rows = [[name, metric_of(metrics[name]).title, *(cell(name, other) for other in names)] for name in names]
    return pipe_table(("component", "its metric", *names), rows, 2)


def effect_rows(effects: pd.DataFrame, factors: Sequence[str]) -> str:
    """What `effects_table` gives, with the component minus without it; a row a metric and a column a component."""
    rows = []
    for metric, of in effects.groupby("metric", sort=False):
        decimals, found = metric_of(str(metric)).decimals, of.set_index("effect")

        def cell(factor: str, found: pd.DataFrame = found, decimals: int = decimals) -> str:
            if factor not in found.index:
                return NOTHING
            text = signed(-found.at[factor, "estimate"], decimals)
            return f"**{text}**" if _claimed(found.at[factor, "q"]) else text

        pairs = [name for name, q in found["q"].items() if ":" in str(name) and _claimed(q)]
        named = [":".join(NAMES.get(part, part) for part in str(pair).split(":")) for pair in pairs]
        rows.append([head(str(metric)), *map(cell, factors), ", ".join(named) or NOTHING])
    columns = [NAMES.get(factor, factor) for factor in factors]
    return pipe_table(("metric", *columns, "interactions"), rows)


def _claimed(q: float | None) -> bool:
    return q is not None and bool(q < ALPHA)
