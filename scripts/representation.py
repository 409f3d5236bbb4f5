"""What each part of the networks' representation buys, on validation sites alone, as a table.

python -m ablate +study=representation
python scripts/representation.py [folder of the study]
"""

import math
import sys

import pandas as pd

import ablate
from ablate.metrics import metric_of
from numerics import markdown

SHOWN = ("mae_smooth", "pchi2_tissue", "shadow_contrast", "thin_contrast", "crps", "noise_sd")


def shares(study: "ablate.study.opened.Study") -> pd.DataFrame:
    """A row a run: its scores on validation sites over those of re-simulation, FD speckle, and minutes of training."""
    rows = {}
    for run in study.usable.runs:
        scalars = run.scalars
        row = {metric_of(name).label: scalars[f"val/{name}"] / scalars[f"val/floor_{name}"] for name in SHOWN}
        row["FD speckle"] = scalars["val/fd_speckle"]
        rows[run.name] = row | {"minutes": scalars.get("train/seconds", math.nan) / 60}  # of a run without a break
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("run")


def main() -> None:
    """Print the table."""
    table = shares(ablate.open_study(sys.argv[1] if len(sys.argv) > 1 else "runs/representation"))
    print(markdown(table.map("{:.2f}".format)))


if __name__ == "__main__":
    main()
