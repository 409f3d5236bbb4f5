"""Does the effect of the attenuation map and of the maps at every level grow on the way from the study to the paper?

python scripts/ladder.py    # a table, from the kept runs of docs/results/full_model and docs/results/ladder
"""

import json
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import t as student

KEPT = Path(__file__).resolve().parents[1] / "docs" / "results"
RUNGS = {
    "study": "",
    "images": "",
    "L1": "reconstruction-l1",
    "split": "split-frame",
}  # in a label, from a rung on
NETWORKS = {"": "full", "attenuation-none": "att", "concat-input": "concat"}
#: What is read of each component; more is better of PSNR, and less of the others.
READ = {"att": ("shadow_contrast", "psnr"), "concat": ("thin_contrast", "psnr")}


def values() -> pd.DataFrame:
    """A row a run in anatomy 3: rung, network, and its mean over test frames of every metric."""
    rows = []
    for file in sorted(
        [*KEPT.glob("full_model/sa2h*/seed[01]/result.json"), *KEPT.glob("ladder/sa2h*/seed*/result.json")]
    ):
        changes = json.loads(file.read_text())["label"].split(".")[1:]
        rung = "study" if file.parts[-4] == "full_model" else "images"
        rung = next((name for name in ("split", "L1") if RUNGS[name] in changes), rung)
        network = NETWORKS.get(".".join(change for change in changes if change not in RUNGS.values()))
        if network is not None:
            frames = pd.read_parquet(file.parent / "per_image.parquet").query("source == 'model' and split == 'test'")
            means = frames[np.isfinite(frames["value"])].groupby("metric")["value"].mean()
            rows.append({"rung": rung, "network": network, **means})
    return pd.DataFrame(rows)


def effects(runs: pd.DataFrame) -> pd.DataFrame:
    """A row a component, metric and rung: the mean with it minus that without it, and half of its 95 % interval."""
    rows = []
    for component, metrics in READ.items():
        for metric in metrics:
            cells = runs.groupby(["rung", "network"])[metric]
            dof = len(runs) - cells.ngroups
            sd = float(np.sqrt(((runs[metric] - cells.transform("mean")) ** 2).sum() / dof))
            mean, count = cells.mean(), cells.count()
            for rung in (name for name in RUNGS if name in set(runs["rung"])):
                with_it, without = (rung, "full"), (rung, component)
                half = student.ppf(0.975, dof) * sd * np.sqrt(1 / count[with_it] + 1 / count[without])
                rows.append(
                    (component, metric, rung, mean[with_it], mean[without], mean[with_it] - mean[without], half)
                )
    names = ["component", "metric", "rung", "with", "without", "effect", "half"]
    return pd.DataFrame(rows, columns=names)


def main() -> None:
    """Print the effects of each rung, and which of them differ from that of the rung before by more than chance."""
    table = effects(values())
    step = table.groupby(["component", "metric"])["effect"].diff()
    before = table.groupby(["component", "metric"])["half"].shift()
    said = np.where(step.abs() > np.hypot(table["half"], before), "another", "no difference found")
    print(table.assign(against_the_rung_before=np.where(step.isna(), "", said)).round(2).to_string(index=False))


if __name__ == "__main__":
    main()
