"""The two tables that every comparison starts from, and the order in which variants and metrics are shown."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ablate.metrics import METRICS, Group, metric_of
from ablate.metrics.metric import SCALAR_COLUMNS

REFERENCE = "sa2h"
RESIMULATION = "re-simulation"  # shown among the variants
CHANGED = 3
LEVEL = 0.95  # coverage of the intervals of all tables


def ordered_variants(variants: Sequence[str], reference: str = REFERENCE) -> list[str]:
    """Re-simulation, reference, the other variants by name, then `sa2h.depth-8` and the like; each once."""
    return sorted(set(variants), key=lambda name: (variant_group(name, reference), name.replace(".", " ")))


def variant_group(name: str, reference: str = REFERENCE) -> int:
    """Block of rows of a variant: 0 re-simulation, 1 reference, 2 variants, `CHANGED` what was changed beside one."""
    return {RESIMULATION: 0, reference: 1}.get(name, CHANGED if "." in name else 2)


def ordered_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics in the order of `METRICS`, unknown ones last by name; each once."""
    place = {name: k for k, name in enumerate(METRICS)}
    return sorted(set(metrics), key=lambda name: (place.get(name, len(place)), name))


def judged_metrics(metrics: Sequence[str]) -> list[str]:
    """Metrics that claims are made about, in the same order: all but what a network costs."""
    return [name for name in ordered_metrics(metrics) if metric_of(name).group is not Group.cost]


def finite_values(per_image: pd.DataFrame, scalars: pd.DataFrame | None = None) -> pd.DataFrame:
    """The finite values of both tables, with the columns variant, seed, metric, value, and data where they have it."""
    columns = [*SCALAR_COLUMNS, *({"data"} & set(per_image))]
    values = per_image[columns] if scalars is None else pd.concat([per_image[columns], scalars[columns]])
    return values[np.isfinite(values["value"])]
