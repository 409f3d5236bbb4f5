"""Main effects and two-way interactions of components, with intervals, from any set of two-level runs."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import linalg, stats

from ablate.analysis.statistics.component_claims import FEWEST_SEEDS

MOST_NAMED = 3  # aliases of an effect; more are summed up
EFFECT_COLUMNS = ("effect", "estimate", "lower", "upper", "p", "dof", "aliases")


def factorial_effects(
    runs: pd.DataFrame, factors: Sequence[str], value: str = "value", level: float = 0.95
) -> pd.DataFrame:
    """Least-squares effects of two-level factors (Box, Hunter and Hunter 2005, chapters 5 and 6).

    An effect is the mean at a factor's second level minus the mean at its first; a two-way interaction is half the
    difference of one factor's effect between the other's levels. Interactions that the runs cannot tell from other
    effects are taken as zero, and named as aliases of those effects. Higher interactions and seeds are the error that
    intervals are made of.

    Parameters
    ----------
    runs : DataFrame
        One row a run: a column for each factor, one for the value; seeds are further rows.
    factors : sequence of str
        Columns with two levels each, in the order of their categories or else of first appearance (the first level is
        the baseline).
    value : str
        Column of the response.
    level : float
        Coverage of the intervals.

    Returns
    -------
    DataFrame
        Columns effect (`a` or `a:b`), estimate, lower, upper, p, dof, aliases (text, empty where there are none). Where
        no degree of freedom is left for error, or an effect rests on fewer than three runs a side, lower, upper and p
        are None.

    Raises
    ------
    ValueError
        When a column is missing, a factor has not two levels, or the runs cannot tell the factors apart.
    """
    missing = [name for name in (*factors, value) if name not in runs.columns]
    if missing:
        raise ValueError(f"runs lack the columns {missing}, they have {list(runs.columns)}")
    signs = _signs(runs, factors)
    terms: list[tuple[str, ...]] = [(factor,) for factor in factors]
    if np.linalg.matrix_rank(_columns(signs, terms)) <= len(terms):
        raise ValueError(f"{len(runs)} runs cannot tell the factors {list(factors)} apart: add cells")
    terms += _separable_pairs(signs, factors)
    design = _columns(signs, terms)
    response = runs[value].to_numpy(dtype=np.float64)
    estimate = linalg.lstsq(design, response)[0]
    inverse = linalg.inv(design.T @ design)
    dof = len(runs) - design.shape[1]
    variance = np.sum((response - design @ estimate) ** 2) / dof if dof > 0 else np.nan
    aliases = _aliases(signs, factors, terms)
    rows = []
    for k, term in enumerate(terms, start=1):
        effect = float(estimate[k])
        row: dict[str, object] = {"effect": ":".join(term), "estimate": effect, "lower": None, "upper": None, "p": None}
        changed = int(np.count_nonzero(design[:, k] > 0))
        if dof > 0 and min(changed, len(runs) - changed) >= FEWEST_SEEDS:
            error = float(np.sqrt(variance * inverse[k, k]))
            reach = float(stats.t.ppf((1 + level) / 2, dof)) * error
            ratio = abs(effect) / error if error > 0 else np.inf
            p = float(2 * stats.t.sf(ratio, dof)) if effect else 1.0
            row |= {"lower": effect - reach, "upper": effect + reach, "p": p}
        rows.append(row | {"dof": dof, "aliases": aliases[term]})
    return pd.DataFrame(rows, columns=list(EFFECT_COLUMNS))


def defining_relation(runs: pd.DataFrame, factors: Sequence[str]) -> list[str]:
    """Words of a fraction, as `-a:b:c:d:e`: products of two-level factors that are the same in every run.

    Second levels count as +. A full factorial has no words. Raises ValueError when a factor has not two levels.
    """
    signs = _signs(runs, factors)
    words = []
    for word in _subsets(factors, 1):
        product = _product(signs, word)
        if (product == product[0]).all():
            words.append(("-" if product[0] < 0 else "") + ":".join(word))
    return words


def _signs(runs: pd.DataFrame, factors: Sequence[str]) -> dict[str, np.ndarray]:
    coded = {}
    for factor in factors:
        column = runs[factor]
        categorical = isinstance(column.dtype, pd.CategoricalDtype)
        levels = list(column.cat.categories if categorical else pd.unique(column))
        if len(levels) != 2 or column.nunique() != 2:
            raise ValueError(f"factor {factor} needs 2 levels, got {levels}")
        coded[factor] = np.where(runs[factor] == levels[1], 1.0, -1.0)
    return coded


def _product(signs: dict[str, np.ndarray], term: Sequence[str]) -> np.ndarray:
    return np.prod([signs[factor] for factor in term], axis=0)


def _columns(signs: dict[str, np.ndarray], terms: Sequence[tuple[str, ...]]) -> np.ndarray:
    """Design matrix whose coefficients are effects: the mean, then half a sign a term."""
    runs = len(next(iter(signs.values())))
    return np.column_stack([np.ones(runs), *(_product(signs, term) / 2 for term in terms)])


def _separable_pairs(signs: dict[str, np.ndarray], factors: Sequence[str]) -> list[tuple[str, ...]]:
    """Two-way interactions of which all four cells were run, and that no other term stands in for."""
    mains: list[tuple[str, ...]] = [(factor,) for factor in factors]
    four = [pair for pair in combinations(factors, 2) if len(np.unique([signs[f] for f in pair], axis=1).T) == 4]
    rank = np.linalg.matrix_rank(_columns(signs, [*mains, *four]))
    kept: list[tuple[str, ...]] = []
    for pair in four:
        others = [*mains, *(other for other in four if other != pair)]
        if np.linalg.matrix_rank(_columns(signs, others)) < rank:
            kept.append(pair)
    return kept


def _subsets(factors: Sequence[str], smallest: int) -> list[tuple[str, ...]]:
    return [term for size in range(smallest, len(factors) + 1) for term in combinations(factors, size)]


def _aliases(
    signs: dict[str, np.ndarray], factors: Sequence[str], terms: Sequence[tuple[str, ...]]
) -> dict[tuple[str, ...], str]:
    """What each estimate holds beside its effect: from the alias matrix (X'X)^-1 X'Z (Box and Wilson 1951)."""
    left_out = [term for term in _subsets(factors, 2) if term not in terms]
    if not left_out:
        return dict.fromkeys(terms, "")
    design = _columns(signs, terms)
    matrix = linalg.lstsq(design, _columns(signs, left_out)[:, 1:])[0][1:]
    found = {}
    for term, shares in zip(terms, matrix, strict=True):
        whole = np.isclose(np.abs(shares), 1)
        if (whole | np.isclose(shares, 0)).all() and whole.sum() <= MOST_NAMED:
            names = [
                ("-" if share < 0 else "+") + ":".join(alias)
                for alias, share, one in zip(left_out, shares, whole, strict=True)
                if one
            ]
            found[term] = " ".join(names)
        else:
            found[term] = "its interactions"
    return found
