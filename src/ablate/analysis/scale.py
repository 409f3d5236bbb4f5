"""The scale that networks stand on: 0 is the formula, which has no weights, and 1 is re-simulation."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from ablate.analysis.components import Component
from ablate.analysis.scored import BASELINE_NAMES, RESIMULATION, finite_values
from ablate.metrics import Direction, metric_of
from ablate.metrics.metric import FORMULA

_JUDGED = (Direction.higher, Direction.lower)


def scale_table(table: pd.DataFrame) -> pd.DataFrame:
    """Where every network of a `comparison_table` stands between the formula and re-simulation.

    A row a network and a column a metric: (mean - formula) / (re-simulation - formula). Below 0 a network is worse than
    no network. Above 1 it is smoother than a perfect stochastic renderer, or knows the scatterers. Metrics without both
    baselines, of which re-simulation is no better, or that do not judge, are left out.
    """
    means = table.pivot(index="variant", columns="metric", values="mean")
    if not {FORMULA, RESIMULATION} <= set(means.index):
        return pd.DataFrame()
    formula, best = means.loc[FORMULA], means.loc[RESIMULATION]
    order = [name for name in dict.fromkeys(table["metric"]) if scale_length(name, formula[name], best[name]) > 0]
    networks = [name for name in dict.fromkeys(table["variant"]) if name not in BASELINE_NAMES]
    return ((means - formula) / (best - formula)).loc[networks, order]


def scale_length(metric: str, formula: float, resimulation: float) -> float:
    """How much better re-simulation is than the formula, in units of the metric; 0 where the metric does not judge."""
    judge = metric_of(metric)
    return judge.badness(formula) - judge.badness(resimulation) if judge.better in _JUDGED else 0.0


def scaled_bands(components: Sequence[Component], per_image: pd.DataFrame) -> tuple[Component, ...]:
    """The components with the bands that count in a study: shares of its scale, where it has one.

    Where a share counts, the band is that share of the scale in units of the metric. Elsewhere the band is the declared
    one, and the share is None. The scale is the mean of those of the data sets in `per_image`, which is as for
    `comparison_table`, perhaps with a column data.
    """
    baselines = finite_values(per_image)
    baselines = baselines[baselines["variant"].isin(BASELINE_NAMES)]
    by_data = baselines.groupby(["variant", "metric", *(["data"] if "data" in baselines else [])])["value"].mean()
    means = by_data.groupby(["variant", "metric"]).mean()
    bands = []
    for component in components:
        metric = str(component.metric)
        ends = [float(means.get((name, metric), np.nan)) for name in (FORMULA, RESIMULATION)]
        length = scale_length(metric, *ends)
        if component.share is not None and length > 0:  # not where an end is not known
            bands.append(replace(component, band=component.share * length))
        else:
            bands.append(replace(component, share=None))
    return tuple(bands)
