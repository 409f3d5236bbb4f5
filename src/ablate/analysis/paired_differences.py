"""Every variant against the reference, frame by frame, in every metric."""

from __future__ import annotations

import numpy as np
import pandas as pd

from ablate.analysis.metric_facts import REFERENCE, RESIMULATION
from ablate.analysis.order import ordered_metrics, ordered_variants
from ablate.analysis.statistics import holm, paired_difference
from ablate.analysis.tables import PER_IMAGE_COLUMNS, require_columns

PAIRED_COLUMNS = (
    *("variant", "reference", "metric", "shift", "low", "high", "p_holm", "effect", "n"),
    *("p_sites_holm", "sites", "dropped"),
)


def aligned_differences(per_image: pd.DataFrame, metric: str, reference: str = REFERENCE) -> dict[str, pd.DataFrame]:
    """Per-frame values of every other variant beside the reference's.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    metric : str
    reference : str

    Returns
    -------
    dict of str to DataFrame
        For each variant but the reference: columns frame, site, value, reference, on the frames both have; values are
        means over seeds, infinite where one seed's is not finite.
    """
    chosen = per_image[per_image["metric"] == metric]
    chosen = chosen.assign(value=chosen["value"].fillna(np.inf))
    means = chosen.groupby(["variant", "frame"], as_index=False).agg(value=("value", "mean"), site=("site", "first"))
    base = means[means["variant"] == reference][["frame", "value"]]
    base = base.rename(columns={"value": "reference"})
    result = {}
    for variant in ordered_variants(list(means["variant"]), reference):
        joined = means[means["variant"] == variant].merge(base, on="frame", validate="one_to_one")
        if variant != reference and len(joined):
            result[variant] = joined[["frame", "site", "value", "reference"]]
    return result


def paired_table(
    per_image: pd.DataFrame, reference: str = REFERENCE, resamples: int = 2000, seed: int = 0
) -> pd.DataFrame:
    """Paired differences of every variant to the reference, in every metric.

    Holm's correction runs over all networks and metrics together; the re-simulation is no network and has a
    family of its own. Metrics without one finite pair are left out.

    Parameters
    ----------
    per_image : DataFrame
        Columns variant, seed, frame, site, metric, value.
    reference : str
    resamples, seed : int
        Of the bootstrap over sites.

    Returns
    -------
    DataFrame
        Columns variant, reference, metric, shift, low, high, p_holm (Wilcoxon over frames), effect, n (frames),
        p_sites_holm (Wilcoxon over the sites' means), sites, dropped (frames without two finite values); empty when
        the reference is missing or alone.

    Raises
    ------
    ValueError
        When a column is missing.
    """
    require_columns(per_image, PER_IMAGE_COLUMNS, "per_image")
    rows = []
    for metric in ordered_metrics(list(per_image["metric"])):
        for variant, pairs in aligned_differences(per_image, metric, reference).items():
            value, base = pairs["value"].to_numpy(), pairs["reference"].to_numpy()
            if not (np.isfinite(value) & np.isfinite(base)).any():
                continue
            found = paired_difference(value, base, pairs["site"].to_numpy(), resamples=resamples, seed=seed)
            rows.append(
                {
                    "variant": variant,
                    "reference": reference,
                    "metric": metric,
                    "shift": found.shift,
                    "low": found.low,
                    "high": found.high,
                    "p_holm": found.p,
                    "effect": found.effect,
                    "n": found.n,
                    "p_sites_holm": found.p_sites,
                    "sites": found.clusters,
                    "dropped": found.dropped,
                }
            )
    table = pd.DataFrame(rows, columns=list(PAIRED_COLUMNS))
    for family in (table["variant"] == RESIMULATION, table["variant"] != RESIMULATION):
        for p in ("p_holm", "p_sites_holm"):
            if family.any():
                table.loc[family, p] = holm(table.loc[family, p].to_numpy())
    order = {name: k for k, name in enumerate(ordered_variants(list(table["variant"]), reference))}
    return table.sort_values("variant", key=lambda v: v.map(order), kind="stable").reset_index(drop=True)
