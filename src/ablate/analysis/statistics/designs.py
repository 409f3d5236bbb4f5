"""Which experiment the runs of a study make up: a factorial, a fraction of one, or one change at a time."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations
from numbers import Real

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.components import Component, short_keys
from ablate.analysis.scored import REFERENCE, finite_values, is_network, judged_metrics
from ablate.analysis.statistics.effects import EFFECT_COLUMNS, defining_relation, factorial_effects
from ablate.analysis.statistics.paired import holm, where_known

#: Beginnings of keys that change the images on which a run is scored.
_OF_IMAGES = ("scene.", "probe.", "simulator.", "dataset.")


@dataclass(frozen=True, eq=False)
class Design:
    """Runs that differ in two-level components and in nothing else.

    Attributes
    ----------
    cells : DataFrame
        One row a label, indexed by it: a categorical column for each factor, the reference's level first. It is named
        by its dotted configuration key; where a key has several other levels, each is a factor, `model.noise=input`,
        and the labels with another one count as the reference there.
    name : str
        What kind of experiment it is.
    reading : str
        What its effects mean, and what they cannot be told from.
    """

    cells: pd.DataFrame
    name: str
    reading: str

    @property
    def factors(self) -> list[str]:
        """What varies, by the names of the columns."""
        return list(self.cells.columns)


def find_design(
    runs: Mapping[str, Mapping[str, object]],
    factors: Sequence[str],
    reference: str = REFERENCE,
    components: Sequence[Component] = (),
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
    components : sequence of Component, optional
        A third level of a key is kept where one of these compares it with the reference's.
    """
    if not runs:
        return None
    if reference not in runs:
        reference = _with_most_neighbours(runs)
    base = runs[reference]
    fixed = set(base) - set(factors)  # keys in which nothing may differ
    comparable = {
        label: {factor: _level(run[factor]) for factor in factors if factor in run}
        for label, run in runs.items()
        if all(run[key] == base[key] for key in fixed & run.keys())
    }
    cells = _cells(comparable, reference, components)
    if cells.columns.empty:
        return None
    design = _read(cells)
    reading = design.reading
    of_images = ", ".join(key for key in design.factors if key.startswith(_OF_IMAGES))
    if of_images:
        reading += f" Levels of {of_images} were scored on different images; p does not count how these differ."
    left_out = ", ".join(label for label in runs if label not in design.cells.index)
    if left_out:
        reading += f" Left out of it: {left_out}."
    return replace(design, reading=reading)


def _cells(runs: Mapping[str, Mapping[str, object]], reference: str, components: Sequence[Component]) -> pd.DataFrame:
    """The table `Design.cells` of runs, of which those with a level that is not compared are left out."""
    here = runs[reference]
    compared = _other_levels(runs, reference, components)
    kept = [
        label
        for label, run in runs.items()
        if all(run.get(key) in (here[key], *levels) for key, levels in compared.items())
    ]
    kept.sort(key=lambda label: label != reference)
    columns = {}
    for key, levels in compared.items():
        present = [level for level in levels if any(runs[label][key] == level for label in kept)]
        for level in present:
            factor = key if len(present) == 1 else f"{key}={level}"
            has = [level if runs[label][key] == level else here[key] for label in kept]
            columns[factor] = pd.Categorical(has, [here[key], level])
    return pd.DataFrame(columns, index=kept)


def _with_most_neighbours(runs: Mapping[str, Mapping[str, object]]) -> str:
    """The label that most others are one change away from."""

    def neighbours(label: str) -> int:
        run = runs[label]
        changes = [sum(run.get(key) != other.get(key) for key in {*run, *other}) for other in runs.values()]
        return changes.count(1)

    return max(runs, key=neighbours)


def _other_levels(
    runs: Mapping[str, Mapping[str, object]], reference: str, components: Sequence[Component]
) -> dict[str, list[object]]:
    """By key that varies, the level that most runs have beside the reference's, then others that are declared."""
    levels = {}
    for key, here in runs[reference].items():
        others = [run[key] for run in runs.values() if run.get(key, here) != here]
        if others:
            declared = [component for component in components if component.key == key]
            compared = [o for o in dict.fromkeys(others) if any(c.compares(here, o) for c in declared)]
            levels[key] = list(dict.fromkeys([max(dict.fromkeys(others), key=others.count), *compared]))
    return levels


def _level(value: object) -> object:
    """A configuration value as a level of a factor: lists, mappings and null as text."""
    if value is None:
        return "null"
    return value if isinstance(value, str | Real) else str(value)


def _read(cells: pd.DataFrame) -> Design:
    """The design that cells make up, perhaps without some of them."""
    cells = _half_alone(cells)
    factors = list(cells.columns)
    count = len(cells.drop_duplicates())
    if count == 2 ** len(factors):
        return _full_factorial(cells)
    short = short_keys(factors)
    words = defining_relation(cells.rename(columns=short), list(short.values()))
    if len(words) == 1 and 2 * count == 2 ** len(factors):
        return _half_of_factorial(cells, words[0])
    changed = _changed(cells).to_numpy()
    apart = np.abs(changed[:, None, :] - changed[None, :, :]).sum(axis=2)
    changes = pd.DataFrame(apart, cells.index, cells.index)  # from one cell to another
    neighbours = (changes == 1).sum()
    reference = cells.index[0]
    centre = str(reference if neighbours[reference] else neighbours.idxmax())
    away = changes[centre]
    if neighbours[centre] and not _tell_interactions(changed):
        away = away[away <= 2]  # more changes at once hold interactions that these cells cannot tell apart
    if set(away.index[away > 1]) <= {reference}:  # the full model beside an add-one-in study takes no part in it
        return _one_at_a_time(cells.loc[away.index[away <= 1]], centre)
    return _some_cells(cells.loc[away.index])


def _changed(cells: pd.DataFrame) -> pd.DataFrame:
    """A column a factor: 0 where a cell has the reference's level, and 1 where it has the other one."""
    return pd.DataFrame({factor: cells[factor].cat.codes for factor in cells})


def _half_alone(cells: pd.DataFrame) -> pd.DataFrame:
    """The cells with an even number of changes, where these are a half of five factors or more; else all cells.

    Runs beside a half would confound its effects.
    """
    full = 2 ** len(cells.columns)
    even = cells[_changed(cells).sum(axis=1) % 2 == 0]
    is_half = 2 * len(even.drop_duplicates()) == full
    whole = len(cells.drop_duplicates()) == full
    return even if len(cells.columns) >= 5 and is_half and not whole else cells


def _tell_interactions(changed: np.ndarray) -> bool:
    """Whether cells, (cells, factors) int, can tell the main effects and all two-way interactions apart."""
    pairs = [(1 - 2 * changed[:, [i, j]]).prod(axis=1) for i, j in combinations(range(changed.shape[1]), 2)]
    terms = np.column_stack([np.ones(len(changed)), changed, *pairs])
    return bool(np.linalg.matrix_rank(terms) == terms.shape[1])


def _full_factorial(cells: pd.DataFrame) -> Design:
    factors = list(cells.columns)
    if len(factors) == 1:
        before, after = cells[factors[0]].cat.categories
        reading = f"An effect is the change from {before} to {after}. Nothing else differs between these runs."
        return Design(cells, f"with and without one component ({short_keys(factors)[factors[0]]})", reading)
    name = f"full factorial of {len(factors)} components ({2 ** len(factors)} cells)"
    return Design(cells, name, "An effect is averaged over all combinations of the other components.")


def _half_of_factorial(cells: pd.DataFrame, word: str) -> Design:
    """The half of a factorial in which the product of `word` is the same in all cells."""
    components = len(cells.columns)
    order = word.count(":") + 1
    if order < components:
        mixed = "The column aliases of effects.csv says what an effect cannot be separated from."
    elif order == 2:
        mixed = "The effects of the two components cannot be told apart."
    elif order == 3:
        mixed = "A main effect cannot be separated from the interaction of the other two components."
    else:
        mixed = (
            f"A main effect cannot be separated from an interaction of {order - 1} components. An interaction of two "
            f"components cannot be separated from one of {order - 2} components."
        )
    reading = f"The defining relation is I = {word}, where + means that a component is changed. {mixed}"
    full = 2**components
    return Design(cells, f"half of the factorial of {components} components ({full // 2} of {full} cells)", reading)


def _one_at_a_time(cells: pd.DataFrame, base: str) -> Design:
    cells = cells.loc[:, cells.nunique() == 2]
    reading = (
        f"An effect is the effect of one change while everything else is as in {base}. Whether it depends on the "
        "other components (an interaction) cannot be told from these runs."
    )
    return Design(cells, f"one change at a time around {base} ({len(cells.drop_duplicates())} cells)", reading)


def _some_cells(cells: pd.DataFrame) -> Design:
    cells = cells.loc[:, cells.nunique() == 2]
    components = len(cells.columns)
    reading = (
        "An interaction of two components is estimated if all four combinations were run, and the effects of both are "
        "averaged over these. All other interactions are taken as zero: if they are not, these effects can be wrong."
    )
    count = len(cells.drop_duplicates())
    return Design(cells, f"{count} of the {2**components} cells of {components} components", reading)


def run_means(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, design: Design | None = None
) -> pd.DataFrame:
    """Mean of every metric of every run, or of the runs of a design, over the test frames of which all have a value.

    `per_image` and `scalars` are as for `comparison_table`, with a column data where the runs have several data sets.
    Columns are metric, variant, seed, data (empty where there is one data set), value, and the design's factors.
    """
    values = finite_values(per_image, scalars)
    values = values[is_network(values["variant"])]
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
