"""The paper's Table II beside the same seven networks to scale: means, tests, and the verdict of docs/table2.md.

python -m ablate +study=table2
python scripts/table2.py             # of runs/table2, or of what docs/results keeps of it
python scripts/table2.py keep        # adds what the kept study lacks to tell seen sites from others
"""

import json
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from scipy.stats import kendalltau
from scipy.stats import t as student

from ablate.analysis import holm
from ablate.study.run import Run, read_list

#: Table II of Zhang, Portenier and Goksel: PSNR, dB; MAE, grey levels; patch chi-square; FID.
PAPER = pd.DataFrame(
    {
        "lsa2h": (27.38, 6.21, 0.1361, 64.42),
        "nsa2h": (25.59, 8.22, 0.3139, 67.28),
        "sa2h-att": (25.04, 8.75, 0.2940, 92.49),
        "sa2h-concat": (26.23, 9.08, 0.2936, 76.40),
        "sa2h-conv": (24.85, 8.87, 0.3270, 93.18),
        "sa2h-noise": (26.45, 8.14, 0.2595, 97.85),
        "sa2h": (28.19, 6.37, 0.1860, 32.34),
    },
    index=["psnr", "mae", "pchi2", "fid"],
).T
#: Our metric in each of its columns; FD speckle in place of FID, which needs frames of 512 rows and given weights.
METRICS = {"psnr": "psnr", "mae": "mae", "pchi2": "pchi2", "fid": "fd_speckle"}
ABLATED = ("sa2h-att", "sa2h-concat", "sa2h-conv", "sa2h-noise", "nsa2h")
PRIMARY = ("pchi2", "psnr")
HIGHER_IS_BETTER = ("psnr",)
KEPT = Path(__file__).parents[1] / "docs" / "results" / "table2"
#: In the folder of the kept study: the sites that training has seen, by data set.
SEEN = "seen_sites.json"
MOST_FD, MOST_OCTAVE_DB = 1.5, 1.0  # of SA2H: more, and it does not draw speckle
LEVEL = 0.05


@dataclass(frozen=True)
class Fit:
    """Least squares of value = network + anatomy + error over runs."""

    mean: pd.Series  # by network, over anatomies alike
    sd: float  # of a run
    dof: int
    unscaled: pd.DataFrame  # covariance of the means over sd^2

    def difference(self, network: str, reference: str = "sa2h") -> tuple[float, float]:
        """What a network has more than the reference, and its standard error."""
        both = self.unscaled.loc[[network, reference], [network, reference]].to_numpy()
        return self.mean[network] - self.mean[reference], self.sd * float(
            np.sqrt(both[0, 0] + both[1, 1] - 2 * both[0, 1])
        )


def fitted(runs: pd.DataFrame, metric: str) -> Fit:
    """Fit the values of one metric; `runs` has columns network, anatomy and metrics, a row a run."""
    networks, anatomies = sorted(set(runs["network"])), sorted(set(runs["anatomy"]))
    of_network = np.stack([runs["network"] == name for name in networks], axis=1).astype(float)
    of_anatomy = np.stack([runs["anatomy"] == name for name in anatomies], axis=1).astype(float)
    design = np.hstack([of_network, of_anatomy[:, 1:] - 1 / len(anatomies)])  # a network's mean is over anatomies alike
    values = runs[metric].to_numpy(float)
    inverse = np.linalg.inv(design.T @ design)
    solution = inverse @ design.T @ values
    dof = len(values) - design.shape[1]
    sd = float(np.sqrt(np.square(values - design @ solution).sum() / dof))
    count = len(networks)
    unscaled = pd.DataFrame(inverse[:count, :count], networks, networks)
    return Fit(pd.Series(solution[:count], networks), sd, dof, unscaled)


def tests(runs: pd.DataFrame) -> pd.DataFrame:
    """The ten tests of the rule: is SA2H better than each ablated network in each primary metric?

    Columns are network, metric, worse (by how much the network is, in units of the metric), lower and upper (95 %),
    share and the shares of its bounds (of SA2H's value), paper (that share in the paper), p (one-sided), p_holm,
    p_reversed and p_reversed_holm (that the network is the better one).
    """
    rows = []
    for metric in PRIMARY:
        fit = fitted(runs, metric)
        sign = -1 if metric in HIGHER_IS_BETTER else 1
        reach = student.ppf(0.975, fit.dof)
        for network in ABLATED:
            more, error = fit.difference(network)
            worse, scale = sign * more, fit.mean["sa2h"]
            printed = sign * (PAPER.loc[network, metric] - PAPER.loc["sa2h", metric]) / PAPER.loc["sa2h", metric]
            rows.append(
                {
                    "network": network,
                    "metric": metric,
                    "worse": worse,
                    "lower": worse - reach * error,
                    "upper": worse + reach * error,
                    "share": worse / scale,
                    "upper_share": (worse + reach * error) / scale,
                    "paper": printed,
                    "p": float(student.sf(worse / error, fit.dof)),
                    "p_reversed": float(student.cdf(worse / error, fit.dof)),
                }
            )
    table = pd.DataFrame(rows)
    for name in ("p", "p_reversed"):
        table[f"{name}_holm"] = holm(table[name].to_numpy())
    return table


def verdict(runs: pd.DataFrame, table: pd.DataFrame) -> str:
    """The verdict by the rule of docs/table2.md."""
    of_sa2h = runs[runs["network"] == "sa2h"]
    fd, octave = of_sa2h["fd_speckle"].mean(), of_sa2h["octave_sd"].mean()
    if fd > MOST_FD or octave > MOST_OCTAVE_DB:
        return f"no verdict: SA2H does not draw speckle (FD speckle {fd:.2f}, octave error {octave:.2f} dB)"
    if (table["p_reversed_holm"] < LEVEL).any():
        reversed_ = table[table["p_reversed_holm"] < LEVEL]
        return "undecided: reversed in " + ", ".join(f"{row.metric} of {row.network}" for row in reversed_.itertuples())
    better = {metric: int((table["p_holm"][table["metric"] == metric] < LEVEL).sum()) for metric in PRIMARY}
    found = f"SA2H is better than {better['pchi2']} of 5 in patch chi-square, than {better['psnr']} of 5 in PSNR"
    if better["pchi2"] >= 4 and better["psnr"] >= 3:
        return (
            f"reproduced: SA2H is better in {better['pchi2']} of 5 in patch chi-square, {better['psnr']} of 5 in PSNR"
        )
    bounded = table[(table["metric"] == "pchi2") & (table["upper_share"] < table["paper"] / 4)]
    if len(bounded) >= 3:
        return f"not reproduced: {len(bounded)} of 5 effects are below a quarter of the paper's"
    return f"undecided: {found}"


def orders(runs: pd.DataFrame) -> pd.DataFrame:
    """Kendall's tau of the seven networks with the paper's order, by metric, with its exact two-sided p."""
    rows = {}
    for printed, metric in METRICS.items():
        means = fitted(runs, metric).mean
        tau, p = kendalltau(means[PAPER.index], PAPER[printed], method="exact")
        rows[metric] = {"tau": tau, "p": p}
    return pd.DataFrame.from_dict(rows, orient="index")


def read_runs(folder: Path, sites: str = "all") -> pd.DataFrame:
    """A row a run: label order, network, anatomy, seed, and its mean over test frames of every metric.

    `sites` are `all`, `seen` in training or `unseen`; distances of sets of frames are of all.
    """
    return pd.DataFrame([_row(run, sites) for run in read_list(folder).runs])


def _row(run: Run, sites: str) -> dict[str, object]:
    frames = _test_frames(run).query("source == 'model'")
    if sites != "all":
        kept = seen_sites(run.training.folder.parent, run.data)
        frames = frames[frames["site"].isin(kept) == (sites == "seen")]
    return {
        "network": run.label.partition(".")[0],
        "labels": run.training.changed.get("encoding", "arbitrary"),
        "anatomy": run.training.changed["scene.anatomy_seed"],
        "seed": run.seed,
        **frames.groupby("metric")["value"].mean(),
        "fd_speckle": run.scalars["test/fd_speckle"],
    }


def _test_frames(run: Run) -> pd.DataFrame:
    """The finite scores of test frames, of the network and of the baselines."""
    return run.scores[(run.scores["split"] == "test") & np.isfinite(run.scores["value"])]


def on_the_scale(folder: Path) -> pd.DataFrame:
    """Formula, SA2H with the labels of its seed, and re-simulation, in the mean of the anatomies.

    `place` is where SA2H is on the way from the formula, 0, to re-simulation, 1.
    """
    tables = []
    for run in read_list(folder).runs:
        if run.label.partition(".")[0] == "sa2h" and "encoding" not in run.training.changed:
            means = _test_frames(run).groupby(["source", "metric"])["value"].mean()
            tables.append(means.rename(run.training.changed["scene.anatomy_seed"]))
    of_anatomies = pd.concat(tables, axis=1).T.groupby(level=0).mean().mean()
    table = of_anatomies.unstack("source")[["formula", "model", "resimulation"]].rename(columns={"model": "sa2h"})
    table["place"] = (table["sa2h"] - table["formula"]) / (table["resimulation"] - table["formula"])
    return table.loc[["psnr", "mae", "pchi2", "mae_smooth", "shadow_contrast", "thin_contrast", "octave_sd"]]


def seen_sites(folder: Path, data: str) -> set[int]:
    """The probe sites of a data set, by its name, that its training has frames of; a kept study lists them."""
    kept = folder / SEEN
    if kept.exists():
        return set(json.loads(kept.read_text())[data])
    from ablate.dataset import Part, open_pairs

    pairs = open_pairs(folder.parent / "data" / data)
    return {int(site) for site in pairs.sites[pairs.split == Part.train]}


def keep_sites(folder: Path, kept: Path) -> None:
    """Write the sites seen in training beside the kept results of the study."""
    names = sorted({json.loads(file.read_text())["data"] for file in folder.glob("*/training.json")})
    (kept / SEEN).write_text(json.dumps({name: sorted(seen_sites(folder, name)) for name in names}))


def beside_the_paper(runs: pd.DataFrame) -> pd.DataFrame:
    """Means of the seven networks, and the paper's."""
    columns = {}
    for printed, metric in METRICS.items():
        columns[f"{printed}, paper"] = PAPER[printed]
        columns[f"{metric}, here"] = fitted(runs, metric).mean
    for metric in ("octave_sd", "mae_smooth", "shadow_contrast", "nyquist_excess", "noise_sd"):
        columns[metric] = fitted(runs, metric).mean
    return pd.DataFrame(columns).loc[PAPER.index]


def main() -> None:
    """Print the tables and the verdict."""
    from numerics import markdown  # beside this script

    folder = next(place for place in (Path("runs/table2"), KEPT) if (place / "comparison" / "jobs.json").exists())
    if sys.argv[1:] == ["keep"]:
        keep_sites(folder, KEPT)
    everything = read_runs(folder)
    runs = everything[everything["labels"] == "arbitrary"]
    print(markdown(beside_the_paper(runs).map("{:.3f}".format)))
    table = tests(runs)
    print(markdown(table.set_index(["network", "metric"]).map("{:.3f}".format)))
    print(markdown(orders(runs).map("{:.3f}".format)))
    print(verdict(runs, table))
    print(f"\nSA2H between the formula and re-simulation\n{markdown(on_the_scale(folder).map('{:.3f}'.format))}")
    for sites in ("seen", "unseen"):
        some = read_runs(folder, sites)
        some = some[some["labels"] == "arbitrary"]
        means = pd.DataFrame({metric: fitted(some, metric).mean for metric in ("psnr", "mae", "pchi2")})
        print(f"\nsites {sites} in training\n{markdown(means.loc[PAPER.index].map('{:.3f}'.format))}")
    beside = everything[everything["labels"] != "arbitrary"]
    print(markdown(beside[["network", "anatomy", "seed", "psnr", "pchi2", "fd_speckle", "octave_sd"]]))


if __name__ == "__main__":
    main()
