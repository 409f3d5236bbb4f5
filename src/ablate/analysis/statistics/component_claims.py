"""Whether a component matters: judged on trainings, not on frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import pandas as pd
from scipy import stats

from ablate.analysis.scored import LEVEL, REFERENCE, RESIMULATION, finite_values, judged_metrics, ordered_variants
from ablate.analysis.statistics.paired import holm, where_known

FEWEST_SEEDS = 3


class Verdict(StrEnum):
    """What the seeds of a study say about a component."""

    not_claimable = "not claimable"
    no_difference_found = "no difference found"
    suggested = "suggested"  # taken alone it differs, but not after correction for the number of comparisons
    differs = "differs"


@dataclass(frozen=True)
class ComponentClaim:
    """Whether a component matters, judged on seeds rather than frames.

    `shift`, `lower`, `upper` are the difference of the seeds' means (variant minus reference) and its Welch interval;
    they and `p` are None when nothing can be claimed.
    """

    verdict: Verdict
    seeds: int
    shift: float | None = None
    lower: float | None = None
    upper: float | None = None
    p: float | None = None


def component_claim(values: Sequence[float] | np.ndarray, reference: Sequence[float] | np.ndarray) -> ComponentClaim:
    """Judge a component by Welch's test on one mean a seed: `differs` where the 95 % interval excludes 0.

    It is `not_claimable` where no seed changes anything. Frames cannot answer this: two trainings of one network differ
    on them with p down to 1e-12.

    Parameters
    ----------
    values, reference : (k,) and (l,) float
        Test mean of each seed, with and without the change. At least three on either side must be finite.

    Examples
    --------
    >>> from ablate.analysis import component_claim
    >>> print(component_claim([18.1, 18.3, 18.2], [17.0, 17.3, 17.1]).verdict)
    differs
    >>> print(component_claim([18.1, 18.3], [17.0, 17.3]).verdict)
    not claimable
    """
    sides = [np.asarray(side, dtype=np.float64) for side in (values, reference)]
    a, b = (side[np.isfinite(side)] for side in sides)
    seeds = min(len(a), len(b))
    if seeds < FEWEST_SEEDS or (np.ptp(a) == 0 and np.ptp(b) == 0):
        return ComponentClaim(Verdict.not_claimable, seeds)
    shift = float(a.mean() - b.mean())
    unit = max(np.ptp(a), np.ptp(b))  # squares of smaller numbers may vanish
    terms = np.array([np.var((side - side.mean()) / unit, ddof=1) / len(side) for side in (a, b)])
    error = float(unit * np.sqrt(terms.sum()))
    dof = float(terms.sum() ** 2 / np.sum(terms**2 / (np.array([len(a), len(b)]) - 1)))
    p = float(2 * stats.t.sf(abs(shift) / error, dof))
    reach = float(stats.t.ppf((1 + LEVEL) / 2, dof)) * error
    verdict = Verdict.differs if p < 1 - LEVEL else Verdict.no_difference_found
    return ComponentClaim(verdict, seeds, shift, shift - reach, shift + reach, p)


def seed_claims(
    per_image: pd.DataFrame, scalars: pd.DataFrame | None = None, reference: str = REFERENCE
) -> pd.DataFrame:
    """Which components may be said to matter: `component_claim` on the seeds' means, and Holm's correction.

    Where each row is judged alone, most studies of eight variants hold a false claim (docs/statistics.md); so `differs`
    is said only after Holm's correction over all rows, and `suggested` of a row that differs when taken alone.

    Parameters
    ----------
    per_image, scalars : DataFrame
        As for `comparison_table`; costs are not judged.

    Returns
    -------
    DataFrame
        Columns variant, metric, verdict, seeds, shift, lower, upper (the interval of one row alone), p, p_holm.
    """
    values = finite_values(per_image, scalars)
    values = values[values["variant"] != RESIMULATION]
    means = values.groupby(["metric", "variant", "seed"])["value"].mean()
    rows = []
    for metric in judged_metrics(list(values["metric"])):
        of_metric = means.loc[metric]
        variants = ordered_variants(list(of_metric.index.get_level_values("variant")), reference)
        for variant in variants if reference in variants else ():
            if variant != reference:
                claim = component_claim(of_metric.loc[variant].to_numpy(), of_metric.loc[reference].to_numpy())
                rows.append({"variant": variant, "metric": metric, **vars(claim)})
    table = pd.DataFrame(rows, columns=["variant", "metric", "verdict", "seeds", "shift", "lower", "upper", "p"])
    table["p_holm"] = where_known(holm, table["p"])
    weak = (table["verdict"] == Verdict.differs) & (table["p_holm"].astype(float) >= 1 - LEVEL)
    table.loc[weak, "verdict"] = Verdict.suggested
    return table
