"""Does the effect of the attenuation map and of the maps at every level grow on the way from the study to the paper?

python scripts/ladder.py    # a table, from the kept runs of docs/results/full_model and docs/results/ladder
"""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import t as student

from recompute_verdicts import holm

KEPT = Path(__file__).resolve().parents[1] / "docs" / "results"
STEPS = {"study": "", "images": "", "L1": "reconstruction-l1", "split": "split-frame"}  # said by labels from there on
NETWORKS = {"": "full", "attenuation-none": "att", "concat-input": "concat"}
#: What is read of each component; more is better of PSNR, and less of the others.
READ = {"att": ("shadow_contrast", "psnr"), "concat": ("thin_contrast", "psnr")}


def values() -> pd.DataFrame:
    """A row a run in anatomy 3: step, network, and its mean over test frames of every metric."""
    rows = []
    for file in sorted((*KEPT.glob("full_model/sa2h*/seed[01]/result.json"), *KEPT.glob("ladder/*/seed*/result.json"))):
        changes = json.loads(file.read_text())["label"].split(".")[1:]
        step = "study" if file.parts[-4] == "full_model" else "images"
        step = next((name for name in ("split", "L1") if STEPS[name] in changes), step)
        network = NETWORKS.get(".".join(change for change in changes if change not in STEPS.values()))
        if network is not None:
            frames = pd.read_parquet(file.parent / "per_image.parquet").query("source == 'model' and split == 'test'")
            means = frames[np.isfinite(frames["value"])].groupby("metric")["value"].mean()
            rows.append({"step": step, "network": network, **means})
    return pd.DataFrame(rows)


def effects(runs: pd.DataFrame) -> pd.DataFrame:
    """A row a component, metric and step: the mean with it minus that without it, and half of its 95 % interval."""
    rows = []
    for component, metrics in READ.items():
        for metric in metrics:
            cells = runs.groupby(["step", "network"])[metric]
            dof = len(runs) - cells.ngroups
            sd = float(np.sqrt(((runs[metric] - cells.transform("mean")) ** 2).sum() / dof))
            mean, count = cells.mean(), cells.count()
            for step in STEPS:
                on, off = (step, "full"), (step, component)
                if {on, off} <= set(mean.index):  # else not made yet
                    half = student.ppf(0.975, dof) * sd * np.sqrt(1 / count[on] + 1 / count[off])
                    rows.append((component, metric, step, mean[on], mean[off], mean[on] - mean[off], half))
    names = ["component", "metric", "step", "with", "without", "effect", "half"]
    return pd.DataFrame(rows, columns=names)


def differences(table: pd.DataFrame, dof: int) -> pd.DataFrame:
    """A row a component, metric and pair of steps: each after the one before, and the last after the first."""
    rows = []
    for (component, metric), of in table.groupby(["component", "metric"], sort=False):
        pairs = [*pairwise(range(len(of))), *([(0, len(of) - 1)] if len(of) > 2 else [])]
        for first, then in pairs:
            a, b = of.iloc[first], of.iloc[then]
            change, half = b["effect"] - a["effect"], float(np.hypot(a["half"], b["half"]))
            p = 2 * student.sf(abs(change) / half * student.ppf(0.975, dof), dof)
            rows.append((component, metric, a["step"], b["step"], change, half, p))
    found = pd.DataFrame(rows, columns=["component", "metric", "from", "to", "change", "half", "p"])
    return found.assign(p=holm(found["p"]))


def main() -> None:
    """Print the effect at each step, and which steps differ."""
    runs = values()
    table = effects(runs)
    print(table.round(2).to_string(index=False))
    if len(set(table["step"])) > 1:
        found = differences(table, len(runs) - len(runs.groupby(["step", "network"])))
        said = np.where(found["p"] < 0.05, "differs", "no difference found")
        print(f"\nDifferences, p with Holm's correction\n{found.assign(verdict=said).round(3).to_string(index=False)}")


if __name__ == "__main__":
    main()
