"""Which experiment the runs of a study make up: a factorial, a fraction of one, or one change at a time."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from numbers import Real

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.components import short_keys
from ablate.analysis.scored import REFERENCE, RESIMULATION, finite_values, judged_metrics
from ablate.analysis.statistics.effects import EFFECT_COLUMNS, defining_relation, factorial_effects
from ablate.analysis.statistics.paired import holm, where_known

#: Beginnings of keys that change the images on which a run is scored.
_OF_IMAGES = ("scene.", "probe.", "simulator.", "dataset.")


@dataclass(frozen=True, eq=False)
class Design:
    """Runs that differ in two-level components and in nothing else.

    `cells` has a row for each label, indexed by it, and a categorical column for each component that varies, named by
    its dotted configuration key, the reference's level first. `reading` says what the effects of the design mean, and
    what they cannot be told from.
    """

    cells: pd.DataFrame
    name: str
    reading: str

    @property
    def factors(self) -> list[str]:
        """Dotted keys of the components that vary."""
        return list(self.cells.columns)


def find_design(
    runs: Mapping[str, Mapping[str, object]], factors: Sequence[str], reference: str = REFERENCE
) -> Design | None:
    """Find the design that the labels of a study make up around its reference; None if no component varies.

    Parameters
    ----------
    runs : mapping of str to mapping
        By label, everything that a run was made from, by dotted configuration key.
    factors : sequence of str
        Keys of it that count as components. A label that differs from the reference in another key that both have, or
        in a third level of one, is left out.
    reference : str
        Where it is missing, the label that most others are one change away from stands in for it.
    """
    if not runs:
        return None
    if reference not in runs:
        near = {
            label: [sum(run.get(key) != other.get(key) for key in {*run, *other}) for other in runs.values()].count(1)
            for label, run in runs.items()
        }
        reference = max(near, key=lambda label: near[label])
    base = runs[reference]
    alike = {
        label: {factor: _level(run[factor]) for factor in factors if factor in run}
        for label, run in runs.items()
        if all(run[key] == base[key] for key in run.keys() & base.keys() - set(factors))
    }
    levels = {}
    for factor, level in alike[reference].items():
        others = [run[factor] for run in alike.values() if run.get(factor, level) != level]
        if others:
            levels[factor] = [level, max(dict.fromkeys(others), key=others.count)]
    kept = [label for label, run in alike.items() if all(run.get(f) in pair for f, pair in levels.items())]
    kept.sort(key=lambda label: label != reference)
    levels = {f: pair for f, pair in levels.items() if len({alike[label][f] for label in kept}) == 2}
    if not levels:
        return None
    cells = {f: pd.Categorical([alike[label][f] for label in kept], pair) for f, pair in levels.items()}
    design = _read(pd.DataFrame(cells, index=kept))
    reading = design.reading
    if of_images := [key for key in design.factors if key.startswith(_OF_IMAGES)]:
        reading += (
            f" Levels of {', '.join(of_images)} were scored on different images; p does not count how these differ."
        )
    if apart := ", ".join(label for label in runs if label not in design.cells.index):
        reading += f" Left out of it: {apart}."
    return replace(design, reading=reading)


def _level(value: object) -> object:
    """A configuration value as a level of a factor: lists, mappings and null as text."""
    return value if isinstance(value, str | Real) else "null" if value is None else str(value)


def _read(cells: pd.DataFrame) -> Design:
    """The design that cells make up, perhaps without some of them."""
    factors = list(cells.columns)
    short = short_keys(factors)
    full = 2 ** len(factors)
    components = f"{len(factors)} component{'' if len(factors) == 1 else 's'}"
    changed = pd.DataFrame({factor: cells[factor].cat.codes for factor in cells})
    even = changed.sum(axis=1) % 2 == 0
    if len(factors) >= 5 and 2 * len(changed[even].drop_duplicates()) == full != len(changed.drop_duplicates()):
        cells, changed = cells[even], changed[even]  # runs beside a half would confound its effects
    codes = changed.to_numpy()
    count = len(changed.drop_duplicates())
    if count == full:
        if len(factors) == 1:
            name = f"with and without one component ({short[factors[0]]})"
            change = "An effect is the change from {} to {}. ".format(*cells[factors[0]].cat.categories)
            return Design(cells, name, f"{change}Nothing else differs between these runs.")
        reading = "An effect is averaged over all combinations of the other components."
        return Design(cells, f"full factorial of {components} ({count} cells)", reading)
    words = defining_relation(cells.rename(columns=short), list(short.values()))
    if len(words) == 1 and 2 * count == full:
        order = words[0].count(":") + 1
        mixed = (
            f"A main effect cannot be separated from an interaction of {order - 1} components. An interaction of two "
            f"components cannot be separated from one of {order - 2} components."
            if order == len(factors)
            else "The column aliases of effects.csv says what an effect cannot be separated from."
        )
        reading = f"The defining relation is I = {words[0]}, where + means that a component is changed. {mixed}"
        return Design(cells, f"half of the factorial of {components} ({count} of {full} cells)", reading)
    apart = np.abs(codes[:, None, :] - codes[None, :, :]).sum(axis=2)
    neighbours, first = (apart == 1).sum(axis=1), cells.index[0]
    centre = 0 if neighbours[0] else int(np.argmax(neighbours))
    near = apart[centre] <= 1
    pairs = [(1 - 2 * codes[:, pair]).prod(axis=1) for pair in map(list, combinations(range(len(factors)), 2))]
    terms = np.column_stack([np.ones(len(codes)), codes, *pairs])
    if neighbours[centre] and np.linalg.matrix_rank(terms) < terms.shape[1]:
        kept = apart[centre] <= 2  # more changes at once hold interactions that these cells cannot tell apart
        cells, near, count = cells[kept], near[kept], len(changed[kept].drop_duplicates())
    if set(cells.index[~near]) <= {first}:  # the full model beside an add-one-in study takes no part in it
        base = changed.index[centre]
        reading = (
            f"An effect is the effect of one change while everything else is as in {base}. Whether it depends on the "
            "other components (an interaction) cannot be told from these runs."
        )
        cells = cells[near]
        cells = cells.loc[:, cells.nunique() == 2]
        return Design(cells, f"one change at a time around {base} ({len(cells.drop_duplicates())} cells)", reading)
    reading = (
        "An interaction of two components is estimated if all four combinations were run, and the effects of both are "
        "averaged over these. All other interactions are taken as zero: if they are not, these effects can be wrong."
    )
    cells = cells.loc[:, cells.nunique() == 2]
    varied = len(cells.columns)
    return Design(cells, f"{count} of the {2**varied} cells of {varied} components", reading)


def run_means(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, design: Design | None = None
) -> pd.DataFrame:
    """Mean of every metric of every run, or of the runs of a design, over the test frames of which all have a value.

    `per_image` and `scalars` are as for `comparison_table`, with a column data where the runs have several data sets.
    Columns are metric, variant, seed, data (empty where there is one data set), value, and the design's factors.
    """
    values = finite_values(per_image, scalars)
    values = values[values["variant"] != RESIMULATION]
    if design is not None:
        values = values[values["variant"].isin(design.cells.index)]
    if "data" not in values:
        values = values.assign(data="")
    means = values.groupby(["metric", "variant", "seed", "data"])["value"].mean().reset_index()
    return means if design is None else means.join(design.cells, on="variant")


def effects_table(means: pd.DataFrame, design: Design) -> pd.DataFrame:
    """Effects of every component and two-way interaction on every metric but costs, from what `run_means` gives.

    Columns are metric and those of `factorial_effects`; p_holm, corrected over effects and metrics, and q, the share of
    false claims among effects with a q as small (Benjamini and Hochberg 1995); the levels `from` and `to` of a
    component's effect. A metric that the runs do not suffice for is left out.
    """
    tables = []
    for metric in judged_metrics(list(means["metric"])):
        with suppress(ValueError):
            effects = factorial_effects(means[means["metric"] == metric], design.factors)
            tables.append(effects.assign(metric=metric))
    names = ["metric", *EFFECT_COLUMNS, "p_holm", "q", "from", "to"]
    if not tables:
        return pd.DataFrame(columns=names)
    table = pd.concat(tables, ignore_index=True)
    table["p_holm"] = where_known(holm, table["p"])
    table["q"] = where_known(stats.false_discovery_control, table["p"])
    levels = {factor: list(design.cells[factor].cat.categories) for factor in design.factors}
    table[["from", "to"]] = [levels.get(effect, ["", ""]) for effect in table["effect"]]
    return table[names]
