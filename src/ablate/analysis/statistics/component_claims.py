"""Whether a variant differs from the reference: judged on trainings, not on frames."""

from enum import StrEnum

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.scored import LEVEL, REFERENCE, finite_values, is_network, judged_metrics, ordered_variants
from ablate.analysis.statistics.paired import holm, where_known

FEWEST_SEEDS = 3


class Claim(StrEnum):
    """What may be said about the difference of a variant from the reference."""

    not_claimable = "not claimable"
    no_difference_found = "no difference found"
    suggested = "suggested"  # taken alone it differs, but not after correction for the number of comparisons
    differs = "differs"


def welch(a: np.ndarray, b: np.ndarray) -> tuple[float, float, float, float]:
    """Difference of the means of two samples, (k,) and (l,), its 95 % interval by Welch's test, and the p-value."""
    shift = float(a.mean() - b.mean())
    unit = max(np.ptp(a), np.ptp(b))  # squares of smaller numbers may vanish
    terms = np.array([np.var((side - side.mean()) / unit, ddof=1) / len(side) for side in (a, b)])
    error = float(unit * np.sqrt(terms.sum()))
    dof = float(terms.sum() ** 2 / np.sum(terms**2 / (np.array([len(a), len(b)]) - 1)))
    reach = float(stats.t.ppf((1 + LEVEL) / 2, dof)) * error
    return shift, shift - reach, shift + reach, float(2 * stats.t.sf(abs(shift) / error, dof))


def has_spread(means: np.ndarray) -> bool:
    """Whether the means of runs, (k,), differ by more than rounding."""
    return bool(np.ptp(means) > len(means) * np.finfo(float).eps * np.abs(means).max())


def seed_claims(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, reference: str = REFERENCE
) -> pd.DataFrame:
    """Which variants may be said to differ from the reference: Welch's test on one mean a seed, and Holm's correction.

    Frames cannot answer this: two trainings of one network differ on them with p down to 1e-12. A row is
    `not_claimable` where either side has fewer than three seeds, or no spread, as no seed changes anything there.
    Where each row is judged alone, most studies of eight variants hold a false claim (docs/statistics.md); so `differs`
    is said only after Holm's correction over all rows, and `suggested` of a row that differs when taken alone.

    `per_image` and `scalars` are as for `comparison_table`; costs are not judged. A mean is over the frames of which
    all runs have a value. Columns are variant, metric, verdict, seeds, shift, lower, upper (the interval of one row
    alone), p, p_holm.
    """
    values = finite_values(per_image, scalars)
    values = values[is_network(values["variant"])]
    means = values.groupby(["metric", "variant", "seed"])["value"].mean()
    rows = []
    for metric in judged_metrics(list(values["metric"])):
        run_means = means.loc[metric]
        variants = ordered_variants(list(run_means.index.get_level_values("variant")), reference)
        if reference not in variants:
            continue
        for variant in variants:
            if variant == reference:
                continue
            a = run_means.loc[variant].to_numpy()
            b = run_means.loc[reference].to_numpy()
            seeds = min(len(a), len(b))
            testable = seeds >= FEWEST_SEEDS and has_spread(a) and has_spread(b)
            shift, lower, upper, p = welch(a, b) if testable else (None, None, None, None)
            rows.append((variant, metric, seeds, shift, lower, upper, p))
    table = pd.DataFrame(rows, columns=["variant", "metric", "seeds", "shift", "lower", "upper", "p"])
    table["p_holm"] = where_known(holm, table["p"])
    alone = table["p"].astype(float)
    corrected = table["p_holm"].astype(float)
    conditions = [corrected < 1 - LEVEL, alone < 1 - LEVEL, alone.notna()]
    claims = [Claim.differs, Claim.suggested, Claim.no_difference_found]
    table.insert(2, "verdict", np.select(conditions, claims, Claim.not_claimable))
    return table
