"""The verdicts of the study and its extension, recomputed from kept files: no code of `ablate` decides anything here.

python scripts/recompute_verdicts.py                         # verdicts, and which of them hang on a single run
python scripts/recompute_verdicts.py docs/results/patient    # beside them the same effects in another body
"""

import json
import sys
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pandas as pd
import yaml
from scipy.stats import f as fisher
from scipy.stats import t as student

ROOT = Path(__file__).resolve().parents[1]
COMPONENTS = {path.stem: yaml.safe_load(path.read_text()) for path in (ROOT / "conf" / "component").glob("*.yaml")}
FULL = "full model"
NETWORKS = {  # by what a label says after sa2h and its anatomy
    **{"attenuation-none": "att", "interfaces-none": "interfaces", "position-none": "position", "space-image": "space"},
    **{"concat-input": "concat", "upsampling-transposed": "conv", "noise-input": "noise", "grain-output": "grain"},
    **{"depth-6": "depth", "encoding-arbitrary": "encoding", "loss-none": "loss", "": FULL},
}


def values(study: Path) -> pd.DataFrame:
    """A row a run of the design: its name, network, anatomy, and its mean over test frames of every metric."""
    rows = []
    for job in json.loads((study / "comparison" / "jobs.json").read_text())["jobs"]:
        variant, *changes = job["label"].split(".")
        anatomy = next((part for part in changes if part.startswith("anatomy_seed")), "")
        network = NETWORKS.get(".".join(part for part in changes if part != anatomy))
        if variant != "sa2h" or network is None:
            continue  # beside the design
        files = [study / job["training"] / "scores" / name for name in job["scores"]]
        frames = pd.concat([pd.read_parquet(file) for file in files]).query("source == 'model' and split == 'test'")
        means = frames[np.isfinite(frames["value"])].groupby("metric")["value"].mean()
        rows.append({"run": job["training"].rpartition("-")[0], "network": network, "anatomy": anatomy, **means})
    return pd.DataFrame(rows)


def least_squares(runs: pd.DataFrame, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A column a network and one an anatomy but the first, the values, and what of the columns a component changes."""
    y = runs[COMPONENTS[name]["metric"]].to_numpy(float)
    networks = sorted(set(runs["network"]))
    x = [runs["network"] == network for network in networks]
    x = np.stack([*x, *(runs["anatomy"] == one for one in sorted(set(runs["anatomy"]))[1:])], axis=1).astype(float)
    contrast = np.zeros(x.shape[1])
    contrast[[networks.index(FULL), networks.index(name)]] = 1, -1
    return x, y, contrast


def effect(runs: pd.DataFrame, name: str) -> tuple[float, float, float, int]:
    """Least squares of value = network + anatomy + error: what a component changes, its error, a run's sd, and dof."""
    x, y, contrast = least_squares(runs, name)
    inverse = np.linalg.inv(x.T @ x)
    solution, dof = inverse @ x.T @ y, len(y) - x.shape[1]
    sd = np.sqrt(np.sum((y - x @ solution) ** 2) / dof)
    return contrast @ solution, sd * np.sqrt(contrast @ inverse @ contrast), sd, dof


def own_error(runs: pd.DataFrame, name: str) -> tuple[float, float] | None:
    """The error of an effect and its degrees of freedom, where the runs without a component vary otherwise (F test).

    The residuals of either side have a variance each, of as many degrees of freedom as they keep of the errors.
    """
    x, y, contrast = least_squares(runs, name)
    inverse = np.linalg.inv(x.T @ x)
    hat = x @ inverse @ x.T
    squares, kept, influence = ((y - hat @ y) ** 2), 1 - np.diag(hat), x @ inverse @ contrast
    sides = [mask.to_numpy() for mask in (runs["network"] == name, runs["network"] != name)]
    counts = [kept[side].sum() for side in sides]
    variances = [squares[side].sum() / count for side, count in zip(sides, counts, strict=True)]
    ratio = variances[0] / variances[1]
    if 2 * min(fisher.sf(ratio, *counts), fisher.cdf(ratio, *counts)) >= 0.05:
        return None
    parts = [variance * (influence[side] ** 2).sum() for variance, side in zip(variances, sides, strict=True)]
    return np.sqrt(sum(parts)), sum(parts) ** 2 / sum(p**2 / n for p, n in zip(parts, counts, strict=True))


def holm(p: pd.Series) -> pd.Series:
    """Holm (1979): the k-th smallest of m is multiplied by m - k + 1, and none is below the one before."""
    ordered = p.sort_values()
    return (ordered * np.arange(len(p), 0, -1)).cummax().clip(upper=1).reindex(p.index)


def verdicts(runs: pd.DataFrame) -> pd.DataFrame:
    """A row a component, by the rule of docs/study.md; less is better in all primary metrics."""
    rows = {}
    for name in sorted(set(runs["network"]) - {FULL}):
        metric, band = COMPONENTS[name]["metric"], COMPONENTS[name]["band"]
        change, error, sd, dof = effect(runs, name)
        if (own := own_error(runs, name)) and own[0] > error:
            error, dof = own
        half = student.ppf(0.975, dof) * error
        p = 2 * student.sf(abs(change) / error, dof), student.cdf((-change - band) / error, dof)
        rows[name] = metric, change, change - half, change + half, band, *p, sd, dof
    names = ["metric", "effect", "lower", "upper", "band", "p_zero", "p_band", "sd", "dof"]
    table = pd.DataFrame.from_dict(rows, orient="index", columns=names)
    table["p_zero"], table["p_band"] = holm(table["p_zero"]), holm(table["p_band"])
    earns = (table["p_zero"] < 0.05) & (table["effect"] < 0)
    return table.assign(verdict=np.select([table["p_band"] < 0.05, earns], ["does_not", "earns"], "undecided"))


def lack_of_fit(runs: pd.DataFrame, names: Iterable[str]) -> dict[str, float]:
    """By primary metric, the probability of what differs between the anatomies in effects, if it is chance (F test)."""
    found = {}
    for name in names:
        if (metric := COMPONENTS[name]["metric"]) not in found:
            _, _, sd, dof = effect(runs, name)
            cells = runs.groupby(["network", "anatomy"])[metric]
            pure, pure_dof = float(((runs[metric] - cells.transform("mean")) ** 2).sum()), len(runs) - cells.ngroups
            ratio = ((sd**2 * dof - pure) / (dof - pure_dof)) / (pure / pure_dof)
            found[metric] = float(fisher.sf(ratio, dof - pure_dof, pure_dof))
    return found


def by_own_spread(runs: pd.DataFrame, name: str) -> tuple[float, float, float]:
    """Welch's test of a component: its p, and the standard deviations of its runs and of those of the full model.

    The mean of each anatomy is taken out, and the error is that of these two networks alone (Welch 1947).
    """
    metric = COMPONENTS[name]["metric"]
    means, variances, counts = [], [], []
    for network in (FULL, name):
        own = runs[runs["network"] == network]
        of_anatomies = own.groupby("anatomy")[metric]
        counts.append((len(own), len(own) - of_anatomies.ngroups))
        variances.append(float(((own[metric] - of_anatomies.transform("mean")) ** 2).sum()) / counts[-1][1])
        means.append(float(of_anatomies.mean().mean()))
    parts = [variance / n for variance, (n, _) in zip(variances, counts, strict=True)]
    dof = sum(parts) ** 2 / sum(part**2 / k for part, (_, k) in zip(parts, counts, strict=True))
    p = 2 * student.sf(abs(means[0] - means[1]) / np.sqrt(sum(parts)), dof)
    return float(p), float(np.sqrt(variances[1])), float(np.sqrt(variances[0]))


def report(study: str, runs: pd.DataFrame) -> None:
    """Print the verdicts of a study, and those that change without a single run."""
    table = verdicts(runs)
    print(f"\n{study}: {len(runs)} runs\n{table.to_string(float_format='{:.4f}'.format)}\n")
    primary = [COMPONENTS[name]["metric"] for name in table.index]
    means = runs.groupby("network")[list(dict.fromkeys(primary))].mean()
    print(f"Means of both anatomies\n{means.to_string(float_format='{:.3f}'.format)}\n")
    for anatomy, own in runs.groupby("anatomy"):
        here = own.groupby("network")[list(means)].mean()
        found = (f"{name} {here[m][FULL] - here[m][name]:.3f}" for name, m in zip(table.index, primary, strict=True))
        print(f"Effects in {anatomy or 'the first anatomy'}: {', '.join(found)}")
    fit = ", ".join(f"{metric} {p:.3f}" for metric, p in lack_of_fit(runs, table.index).items())
    print(f"Lack of fit, p of the difference between anatomies: {fit}\n")
    own = pd.DataFrame([by_own_spread(runs, name) for name in table.index], table.index, ["p", "sd", "sd_full"])
    own["p_holm"] = holm(own["p"])
    print(f"Welch's test, by the spread of a component's own runs\n{own.to_string(float_format='{:.4f}'.format)}\n")
    changed = 0
    for k, run in enumerate(runs["run"]):
        without = verdicts(runs.drop(index=k))["verdict"]
        for name in table.index[without != table["verdict"]]:
            changed += 1
            print(f"without {run}: {name} {without[name]}")
    print(f"Leaving out one run at a time changes {changed} of {len(table) * len(runs)} verdicts.")


def main() -> None:
    """Print what the study and its extension say, and the effects in other bodies."""
    runs = values(ROOT / "docs" / "results" / "full_model")
    report("study", runs)
    if len(extension := values(ROOT / "docs" / "results" / "extension")):
        report("extension", extension)
    for body in map(Path, sys.argv[1:]):
        print(f"\n{body.name}: effect, its 95 % interval, and the effect in the study")
        there = values(body)
        for name in sorted(set(there["network"]) - {FULL}):
            own = there[there["network"].isin([FULL, name])].groupby("network")[COMPONENTS[name]["metric"]]
            before, error, sd, dof = effect(runs, name)
            here, share = own.mean()[FULL] - own.mean()[name], np.sqrt((1 / own.count()).sum())
            t = student.ppf(0.975, dof)
            differs = abs(here - before) > t * np.hypot(sd * share, error)
            ends = f"[{here - t * sd * share:.4f}, {here + t * sd * share:.4f}]"
            print(f"{name:11}{here:9.4f} {ends:20}{before:9.4f} {'differs' if differs else 'no difference found'}")


if __name__ == "__main__":
    main()
