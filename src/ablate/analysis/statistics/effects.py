"""Main effects and two-way interactions of components, with intervals, from any set of two-level runs."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import linalg, stats

from ablate.analysis.scored import LEVEL
from ablate.analysis.statistics.component_claims import FEWEST_SEEDS

MOST_NAMED = 3  # aliases of an effect; more are summed up
EFFECT_COLUMNS = ("effect", "estimate", "lower", "upper", "p", "dof", "aliases")


@dataclass(frozen=True, eq=False)
class LinearModel:
    """Least squares of one value a run on the effects of two-level factors, with blocks.

    An effect is the mean at a factor's second level minus the mean at its first; of an interaction it is half the
    difference of one factor's effect between the other's levels.
    """

    terms: tuple[tuple[str, ...], ...]  # main effects `(a,)`, and interactions `(a, b)` that the runs can tell apart
    effects: np.ndarray  # (terms,)
    covariance: np.ndarray  # (terms, terms), from the residuals of all runs together; NaN where `dof` is 0
    dof: int  # of the error
    runs: np.ndarray  # (terms, 2), on the first and on the second side of each effect
    aliases: dict[tuple[str, ...], str]  # what the runs cannot tell from a term; empty where there is nothing
    residuals: np.ndarray  # (runs,)
    spread: np.ndarray  # (terms, 2) bool, whether runs of a cell differ on the first and the second side of each effect
    influence: np.ndarray  # (terms, runs), what an effect changes by, by what a run changes by
    freedom: np.ndarray  # (runs,), the share of each run's error that its residual keeps; their sum is `dof`
    second: np.ndarray  # (terms, runs) bool, whether a run is on the second side of each effect

    def is_tested(self, term: int) -> bool:
        """Whether an effect has an interval: there are enough runs on both sides, and they tell the error.

        Runs that are equal whatever the seed are no sample: their number says nothing of how sure an effect is.
        """
        return self.dof > 0 and self.runs[term].min() >= FEWEST_SEEDS and bool(self.spread[term].all())

    def contrast(self, weights: np.ndarray) -> tuple[float, float]:
        """A weighted sum of the effects and its standard error; `weights` is (len(terms),) float."""
        return float(weights @ self.effects), float(np.sqrt(weights @ self.covariance @ weights))

    def own_error(self, weights: np.ndarray, term: int) -> tuple[float, float, float]:
        """The standard error of a weighted sum where the two sides of an effect vary differently.

        Each side has the variance of its own residuals. Of two networks this is Welch's test (1947). Returns the error,
        its degrees of freedom by Satterthwaite, and the p-value of the F-test that the sides vary alike; all are NaN
        where a side tells no variance. `weights` is (terms,) float.
        """
        sides = np.stack([~self.second[term], self.second[term]])
        dof = sides @ self.freedom
        if dof.min() < 1 - 1e-9:
            return np.nan, np.nan, np.nan
        variances = sides @ self.residuals**2 / dof
        parts = variances * (sides @ (weights @ self.influence) ** 2)
        if not variances.min() > 0:
            return np.nan, np.nan, np.nan
        ratio = variances[1] / variances[0]
        tails = stats.f.sf(ratio, dof[1], dof[0]), stats.f.cdf(ratio, dof[1], dof[0])
        return float(np.sqrt(parts.sum())), float(parts.sum() ** 2 / np.sum(parts**2 / dof)), float(2 * min(tails))

    def p_value(self, weights: np.ndarray) -> float:
        """The two-sided p-value of Student's t-test that a weighted sum of the effects is zero."""
        return t_test(*self.contrast(weights), self.dof)


def t_interval(effect: float, error: float, dof: float) -> tuple[float, float]:
    """The ends of the 95 % interval of an effect with a standard error."""
    reach = float(stats.t.ppf((1 + LEVEL) / 2, dof)) * error
    return effect - reach, effect + reach


def t_test(effect: float, error: float, dof: float) -> float:
    """The two-sided p-value of Student's t-test that an effect with a standard error is zero."""
    return float(2 * stats.t.sf(abs(effect) / error, dof)) if error > 0 else float(effect == 0)


def fit_effects(runs: pd.DataFrame, factors: Sequence[str], interactions: bool = True) -> LinearModel:
    """Fit main effects, two-way interactions and blocks (Box, Hunter and Hunter 2005, chapters 5 and 6).

    Interactions that the runs cannot tell from other effects or from blocks are taken as zero, and named as aliases of
    those effects. Higher interactions and seeds are the error; so are two-way ones where `interactions` is False.

    Parameters
    ----------
    runs : DataFrame
        One row a run: a column for each factor, `value`, and perhaps `data`, the run's block. Blocks differ by a
        constant; seeds are further rows.
    factors : sequence of str
        Columns of two levels each, in the order of their categories or else of first appearance; the first is the
        baseline.
    interactions : bool
        Whether there are two-way interactions in the model.

    Raises
    ------
    ValueError
        When a factor has not two levels, or the runs cannot tell the factors apart.
    """
    signs = _signs(runs, factors)
    blocks = np.empty((len(runs), 0))
    if "data" in runs:
        blocks = pd.get_dummies(runs["data"], drop_first=True).to_numpy(dtype=np.float64)
    terms: list[tuple[str, ...]] = [(factor,) for factor in factors]
    if np.linalg.matrix_rank(_columns(signs, terms, blocks)) <= len(terms) + blocks.shape[1]:
        among = " and blocks" if blocks.shape[1] else ""
        raise ValueError(f"{len(runs)} runs cannot tell the factors {list(factors)}{among} apart: add cells")
    if interactions:
        terms += _told_interactions(signs, factors, blocks)
    design = _columns(signs, terms, blocks)
    response = runs["value"].to_numpy(dtype=np.float64)
    estimate = linalg.lstsq(design, response)[0]
    residuals = response - design @ estimate
    rounding = len(runs) * np.finfo(float).eps * np.abs(response).max(initial=0.0)  # an effect so small is none
    estimate = np.where(np.abs(estimate) > rounding, estimate, 0.0)
    residuals = np.where(np.abs(residuals) > rounding, residuals, 0.0)
    dof = len(runs) - design.shape[1]
    variance = np.sum(residuals**2) / dof if dof > 0 else np.nan
    term_columns = slice(1, 1 + len(terms))
    inverse = linalg.inv(design.T @ design)
    second = design[:, term_columns] > 0
    changed = np.count_nonzero(second, axis=0)
    return LinearModel(
        terms=tuple(terms),
        effects=estimate[term_columns],
        covariance=variance * inverse[term_columns, term_columns],
        dof=dof,
        runs=np.column_stack([len(runs) - changed, changed]),
        aliases=_aliases(signs, factors, terms, blocks),
        residuals=residuals,
        spread=_spread(runs, signs, second, rounding) & residuals.any(),
        influence=(inverse @ design.T)[term_columns],
        freedom=1 - np.einsum("ij,jk,ik->i", design, inverse, design),
        second=second.T,
    )


def _told_interactions(
    signs: dict[str, np.ndarray], factors: Sequence[str], blocks: np.ndarray
) -> list[tuple[str, ...]]:
    """Two-way interactions of which all four cells were run, and that no other term or block stands in for."""
    pairs = [(a, b) for a, b in combinations(factors, 2) if len({*zip(signs[a], signs[b], strict=True)}) == 4]
    terms = [*((factor,) for factor in factors), *pairs]
    null_space = linalg.null_space(_columns(signs, terms, blocks))
    shares = np.abs(null_space).sum(axis=1)[1 + len(factors) :]
    return [pair for pair, share in zip(pairs, shares, strict=False) if share < 1e-9]  # 0 of a column of its own


def factorial_effects(runs: pd.DataFrame, factors: Sequence[str]) -> pd.DataFrame:
    """Effects of two-level factors with intervals, from `fit_effects`, which says what the arguments are.

    Columns are effect (`a` or `a:b`), estimate, lower, upper (a 95 % interval), p, dof, aliases. Where no degree of
    freedom is left for error, or an effect rests on fewer than three runs a side, lower, upper and p are None.
    """
    model = fit_effects(runs, factors)
    rows = []
    for k, term in enumerate(model.terms):
        lower = upper = p = None
        if model.is_tested(k):
            only_this = np.eye(len(model.terms))[k]
            lower, upper = t_interval(*model.contrast(only_this), model.dof)
            p = model.p_value(only_this)
        rows.append((":".join(term), model.effects[k], lower, upper, p, model.dof, model.aliases[term]))
    return pd.DataFrame(rows, columns=list(EFFECT_COLUMNS))


def defining_relation(runs: pd.DataFrame, factors: Sequence[str]) -> list[str]:
    """Words of a fraction, as `-a:b:c:d:e`: products of two-level factors that are the same in every run.

    Second levels count as +. A full factorial has no words. Raises ValueError when a factor has not two levels.
    """
    signs = _signs(runs, factors)
    words = []
    for factors_of_word in _subsets(factors, 1):
        product = _product(signs, factors_of_word)
        if (product == product[0]).all():
            sign = "-" if product[0] < 0 else ""
            words.append(sign + ":".join(factors_of_word))
    return words


def _signs(runs: pd.DataFrame, factors: Sequence[str]) -> dict[str, np.ndarray]:
    coded = {}
    for factor in factors:
        column = runs[factor]
        levels = list(column.cat.categories if hasattr(column, "cat") else column.unique())
        if len(levels) != 2 or column.nunique() != 2:
            raise ValueError(f"factor {factor} needs 2 levels, got {levels}")
        coded[factor] = np.where(column == levels[1], 1.0, -1.0)
    return coded


def _spread(runs: pd.DataFrame, signs: dict[str, np.ndarray], second: np.ndarray, rounding: float) -> np.ndarray:
    """`LinearModel.spread` of terms on whose second side each run is or not, (runs, terms) bool.

    A side where no cell has two runs has spread: the error is then told by effects that are taken as zero.
    """
    blocks = [runs["data"].to_numpy()] if "data" in runs else []
    cells = pd.Series(runs["value"].to_numpy(np.float64)).groupby([*signs.values(), *blocks])
    repeated = cells.transform("size").to_numpy() > 1
    varied = (cells.transform("max") - cells.transform("min")).to_numpy() > rounding
    sides = np.stack([~second, second]).T  # (terms, runs, 2)
    is_varied, is_repeated = (np.any(sides & rows[:, None], axis=1) for rows in (varied, repeated))
    return np.logical_or(is_varied, ~is_repeated)


def _product(signs: dict[str, np.ndarray], term: Sequence[str]) -> np.ndarray:
    return np.prod([signs[factor] for factor in term], axis=0)


def _columns(signs: dict[str, np.ndarray], terms: Sequence[tuple[str, ...]], blocks: np.ndarray) -> np.ndarray:
    """Design matrix whose coefficients are effects: the mean, then half a sign a term, then the blocks."""
    return np.column_stack([np.ones(len(blocks)), *(_product(signs, term) / 2 for term in terms), blocks])


def _subsets(factors: Sequence[str], smallest: int) -> list[tuple[str, ...]]:
    return [term for size in range(smallest, len(factors) + 1) for term in combinations(factors, size)]


def _aliases(
    signs: dict[str, np.ndarray], factors: Sequence[str], terms: Sequence[tuple[str, ...]], blocks: np.ndarray
) -> dict[tuple[str, ...], str]:
    """What each estimate holds beside its effect: from the alias matrix (X'X)^-1 X'Z (Box and Wilson 1951)."""
    left_out = [term for term in _subsets(factors, 2) if term not in terms]
    if not left_out:
        return dict.fromkeys(terms, "")
    others = np.column_stack([_product(signs, term) / 2 for term in left_out])
    matrix = linalg.lstsq(_columns(signs, terms, blocks), others)[0].round(6)
    texts = {}
    for term, shares in zip(terms, matrix[1:], strict=False):
        named = [(":".join(alias), share) for alias, share in zip(left_out, shares, strict=True) if share]
        whole = all(abs(share) == 1 for _, share in named) and len(named) <= MOST_NAMED
        text = " ".join(("-" if share < 0 else "+") + alias for alias, share in named)
        texts[term] = text if whole else "its interactions"
    return texts
