"""The scale that networks stand on: 0 is the formula, which has no weights, and 1 is re-simulation."""

import pandas as pd

from ablate.analysis.scored import RESIMULATION, is_network
from ablate.metrics import Direction, metric_of
from ablate.metrics.metric import FORMULA

_JUDGED = (Direction.higher, Direction.lower)


def scale_table(table: pd.DataFrame) -> pd.DataFrame:
    """Where every network stands between the formula and re-simulation.

    Parameters
    ----------
    table : DataFrame
        What `comparison_table` gives.

    Returns
    -------
    DataFrame
        A row a network and a column a metric: (mean - formula) / (re-simulation - formula). Below 0 a network is worse
        than no network. Above 1 it is smoother than a perfect stochastic renderer, or knows the scatterers. Metrics
        without both baselines, of which re-simulation is no better, or that do not judge, are left out.
    """
    means = table.pivot(index="variant", columns="metric", values="mean")
    if not {FORMULA, RESIMULATION} <= set(means.index):
        return pd.DataFrame()
    formula, best = means.loc[FORMULA], means.loc[RESIMULATION]
    order = [name for name in dict.fromkeys(table["metric"]) if metric_of(name).better in _JUDGED]
    apart = [name for name in order if metric_of(name).badness(best[name]) < metric_of(name).badness(formula[name])]
    networks = [name for name in dict.fromkeys(table["variant"]) if is_network(pd.Series([name]))[0]]
    return ((means - formula) / (best - formula)).loc[networks, apart]
