"""The two tables that every comparison starts from: per-image values, and scalars that only a run has."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ablate.metrics.stored_names import SCALAR_COLUMNS


def require_columns(frame: pd.DataFrame, columns: Sequence[str], name: str) -> None:
    """Raise ValueError where a table lacks columns; the message calls it by `name`."""
    missing = [column for column in columns if column not in frame.columns]
    if missing:
        raise ValueError(f"{name} lacks the columns {missing}, it has {list(frame.columns)}")


def finite_values(per_image: pd.DataFrame, scalars: pd.DataFrame | None = None) -> pd.DataFrame:
    """The finite values of both tables, with the columns variant, seed, metric, value, and data where they have it."""
    columns = [*SCALAR_COLUMNS, *({"data"} & set(per_image))]
    values = per_image[columns] if scalars is None else pd.concat([per_image[columns], scalars[columns]])
    return values[np.isfinite(values["value"])]
