"""Main effects and two-way interactions of a factorial study, with intervals."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from scipy import stats


def factorial_effects(
    runs: pd.DataFrame, factors: Sequence[str], value: str = "value", level: float = 0.95
) -> pd.DataFrame:
    """Least-squares effects of two-level factors (Box, Hunter and Hunter 2005, chapter 5).

    An effect is the mean at a factor's second level minus the mean at its first; a two-way interaction is
    half the difference of one factor's effect between the other's levels. Higher interactions and seeds are the
    error that intervals are made of.

    Parameters
    ----------
    runs : DataFrame
        One row a run: a column for each factor, one for the value; seeds are further rows.
    factors : sequence of str
        Columns with two levels each, in order of first appearance (the first level is the baseline).
    value : str
        Column of the response.
    level : float
        Coverage of the intervals.

    Returns
    -------
    DataFrame
        Columns effect (`a` or `a:b`), estimate, low, high, p, dof; low, high and p are None where no degree
        of freedom is left for error.

    Raises
    ------
    ValueError
        When a column is missing, a factor has not two levels, or the runs cannot tell effects apart.
    """
    missing = [name for name in (*factors, value) if name not in runs.columns]
    if missing:
        raise ValueError(f"runs lack the columns {missing}, they have {list(runs.columns)}")
    coded = {}
    for factor in factors:
        levels = list(pd.unique(runs[factor]))
        if len(levels) != 2:
            raise ValueError(f"factor {factor} needs 2 levels, got {levels}")
        coded[factor] = np.where(runs[factor] == levels[1], 0.5, -0.5)
    for a, b in combinations(factors, 2):
        coded[f"{a}:{b}"] = 2.0 * coded[a] * coded[b]
    design = np.column_stack([np.ones(len(runs)), *coded.values()])
    if np.linalg.matrix_rank(design) < design.shape[1]:
        raise ValueError(f"{len(runs)} runs cannot tell {design.shape[1]} effects apart: add cells")
    response = runs[value].to_numpy(dtype=np.float64)
    inverse = np.linalg.inv(design.T @ design)
    estimate = inverse @ design.T @ response
    dof = len(runs) - design.shape[1]
    rows = []
    for k, name in enumerate(coded, start=1):
        row: dict[str, object] = {"effect": name, "estimate": float(estimate[k])}
        if dof > 0:
            variance = np.sum((response - design @ estimate) ** 2) / dof
            error = float(np.sqrt(variance * inverse[k, k]))
            reach = float(stats.t.ppf((1 + level) / 2, dof)) * error
            ratio = abs(estimate[k]) / error if error > 0 else np.inf
            p = float(2 * stats.t.sf(ratio, dof)) if estimate[k] else 1.0
            row |= {"low": estimate[k] - reach, "high": estimate[k] + reach, "p": p}
        else:
            row |= {"low": None, "high": None, "p": None}
        rows.append(row | {"dof": dof})
    return pd.DataFrame(rows)
