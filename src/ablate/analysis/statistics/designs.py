"""Which experiment the runs of a study make up: a factorial, a fraction of one, or one change at a time."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.order import REFERENCE, RESIMULATION, judged_metrics
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS
from ablate.analysis.statistics.effects import EFFECT_COLUMNS, defining_relation, factorial_effects
from ablate.analysis.statistics.paired import holm_where_known
from ablate.analysis.values import finite_values


@dataclass(frozen=True, eq=False)
class Design:
    """Runs that differ in two-level components and in nothing else.

    Attributes
    ----------
    cells : DataFrame
        One row a label, indexed by it: a categorical column for each component that varies, the reference's level
        first.
    reading : str
        What its effects mean, and what they cannot be told from.
    left_out : tuple of str
        Labels that differ in something else, or in a third level.
    """

    cells: pd.DataFrame
    name: str
    reading: str
    left_out: tuple[str, ...]

    @property
    def factors(self) -> list[str]:
        """Components that vary."""
        return list(self.cells.columns)


def find_design(
    components: Mapping[str, Mapping[str, object]], factors: tuple[str, ...], reference: str = REFERENCE
) -> Design | None:
    """Find the design that the labels of a study make up around its reference; None if no component varies.

    Parameters
    ----------
    components : mapping of str to mapping
        By label, everything its network was made from.
    factors : tuple of str
        Keys of it that count as components. A label that differs from the reference in another key that both have is
        left out.
    reference : str
        Where it is missing, the label that most others are one change away from stands in for it.
    """
    if not components:
        return None
    if reference not in components:
        near = {
            label: sum(_changes(made, other) == 1 for other in components.values())
            for label, made in components.items()
        }
        reference = max(near, key=lambda label: near[label])
    base = components[reference]
    alike = [
        label
        for label, made in components.items()
        if all(made[key] == base[key] for key in made.keys() & base.keys() - set(factors))
    ]
    levels = {}
    for factor in factors:
        others = [components[label][factor] for label in alike if components[label][factor] != base[factor]]
        if others:
            levels[factor] = [base[factor], max(dict.fromkeys(others), key=others.count)]
    kept = [label for label in alike if all(components[label][f] in pair for f, pair in levels.items())]
    kept.sort(key=lambda label: label != reference)
    if not levels:
        return None
    cells = pd.DataFrame(
        {f: pd.Categorical([components[label][f] for label in kept], pair) for f, pair in levels.items()}, index=kept
    )
    cells, name, reading = _read(cells)
    return Design(cells, name, reading, tuple(label for label in components if label not in cells.index))


def _changes(a: Mapping[str, object], b: Mapping[str, object]) -> int:
    return sum(a.get(key) != b.get(key) for key in {*a, *b})


def _read(cells: pd.DataFrame) -> tuple[pd.DataFrame, str, str]:
    """The cells that make up a design, what it is called, and how its effects are read."""
    factors = list(cells.columns)
    full = 2 ** len(factors)
    changed = pd.DataFrame({factor: cells[factor].cat.codes for factor in cells})
    even = changed.sum(axis=1) % 2 == 0
    if len(factors) >= 5 and 2 * len(changed[even].drop_duplicates()) == full != len(changed.drop_duplicates()):
        cells, changed = cells[even], changed[even]  # runs beside a half would confound its effects
    codes = changed.to_numpy()
    count = len(np.unique(codes, axis=0))
    if count == full:
        reading = "An effect is averaged over all combinations of the other components."
        if len(factors) == 1:
            return cells, f"with and without one component ({factors[0]})", "Nothing else differs between these runs."
        return cells, f"full factorial of {_components(factors)} ({count} cells)", reading
    words = defining_relation(cells, factors)
    if len(words) == 1 and 2 * count == full:
        order = words[0].count(":") + 1
        reading = (
            f"The defining relation is I = {words[0]}, where + means that a component is changed. A main effect cannot "
            f"be separated from an interaction of {order - 1} components. An interaction of two components cannot be "
            f"separated from one of {order - 2} components."
        )
        return cells, f"half of the factorial of {_components(factors)} ({count} of {full} cells)", reading
    apart = np.abs(codes[:, None, :] - codes[None, :, :]).sum(axis=2)
    centre = int(np.argmax((apart == 1).sum(axis=1)))
    near = apart[centre] <= 1
    if set(cells.index[~near]) <= {cells.index[0]}:  # the full model beside an add-one-in study takes no part in it
        base = cells.index[centre]
        reading = (
            f"An effect is the effect of one change while everything else is as in {base}. Whether it depends on the "
            "other components (an interaction) cannot be told from these runs."
        )
        cells = cells[near]
        cells = cells[[factor for factor in cells.columns if cells[factor].nunique() == 2]]
        return cells, f"one change at a time around {base} ({len(cells)} cells)", reading
    reading = (
        "An interaction of two components is estimated if all four combinations were run. The effect of a component is "
        "averaged over these combinations. It is valid where the other components are as in most of the cells."
    )
    return cells, f"{count} of the {full} cells of {_components(factors)}", reading


def _components(factors: list[str]) -> str:
    return f"{len(factors)} component{'' if len(factors) == 1 else 's'}"


def run_means(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, design: Design | None = None
) -> pd.DataFrame:
    """Mean of every metric over the test frames of every run, or of the runs of a design.

    Arguments as for `effects_table`.

    Returns
    -------
    DataFrame
        Columns metric, variant, seed, data (empty where there is one data set), value, and the design's factors.
    """
    values = finite_values(per_image, scalars)
    values = values[values["variant"] != RESIMULATION]
    if design is not None:
        values = values[values["variant"].isin(design.cells.index)]
    if "data" not in values:
        values = values.assign(data="")
    means = values.groupby(["metric", "variant", "seed", "data"])["value"].mean().reset_index()
    return means if design is None else means.join(design.cells, on="variant")


def effects_table(
    per_image: pd.DataFrame, design: Design, scalars: pd.DataFrame | None = None, level: float = 0.95
) -> pd.DataFrame:
    """Effects of every component and two-way interaction on every metric, from one mean a run.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value, and data where the runs have several data sets; these are
        blocks.
    scalars : DataFrame, optional
        Columns variant, seed, metric, value, and data like `per_image`; costs are left out.
    level : float
        Coverage of the intervals.

    Returns
    -------
    DataFrame
        Columns metric and those of `factorial_effects`; p_holm, corrected over effects and metrics, and q, the share of
        false claims among effects with a q as small (Benjamini and Hochberg 1995). A metric that the runs do not
        suffice for is left out.
    """
    means = run_means(per_image, scalars, design)
    tables = []
    for metric in judged_metrics(list(means["metric"])):
        runs = means[means["metric"] == metric]
        try:
            found = factorial_effects(runs, design.factors, level=level, block="data")
        except ValueError:
            continue
        tables.append(found.assign(metric=metric))
    names = ["metric", *EFFECT_COLUMNS, "p_holm", "q"]
    if not tables:
        return pd.DataFrame(columns=names)
    table = pd.concat(tables, ignore_index=True)
    table["p_holm"] = holm_where_known(table["p"])
    known = table["p"].notna()
    table["q"] = pd.Series(None, table.index, dtype=object)
    if known.any():
        table.loc[known, "q"] = stats.false_discovery_control(table.loc[known, "p"].to_numpy(dtype=np.float64))
    return table[names]


def interval_note(table: pd.DataFrame) -> str:
    """Why some effects of an `effects_table` carry no interval; empty where all do."""
    if table["p"].notna().all():
        return ""
    return (
        f"An effect has no interval if it rests on fewer than {FEWEST_SEEDS} trainings on one side, or if the design "
        "leaves no degree of freedom for the error. More seeds give intervals."
    )
