"""The analysis of docs/table2.md: its fit against another parametrisation, its verdict on runs of which it is known."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from support.scripts import script

table2 = script("scripts/table2.py")
SEEDS = {network: (0, 1, 2, 3, 4) if network == "sa2h" else (0, 1, 2) for network in table2.PAPER.index}


def runs_of(
    pchi2: dict[str, float], psnr: dict[str, float], sd: float = 0.0, fd_speckle: float = 1.0, seed: int = 0
) -> pd.DataFrame:
    """Runs whose network has these values, in two anatomies that are some way apart."""
    random = np.random.default_rng(seed)
    rows = []
    for number, (network, seeds) in enumerate(SEEDS.items()):
        for run in seeds:
            apart = 1 + 0.1 * (run % 2)
            noise = random.normal(0, sd, 2)
            row = {
                "network": network,
                "anatomy": 10 + run % 2,
                "seed": run,
                "labels": "arbitrary",
                "mae": number + apart,
            }
            row |= {"pchi2": pchi2[network] + 0.02 * apart + noise[0] / 100, "psnr": psnr[network] + apart + noise[1]}
            rows.append(row | {"fd_speckle": fd_speckle + number / 1000, "octave_sd": 0.5})
    return pd.DataFrame(rows)


def alike(value: float) -> dict[str, float]:
    return dict.fromkeys(table2.PAPER.index, value)


def of_paper(share: float) -> tuple[dict[str, float], dict[str, float]]:
    """Values whose effects are so large a share of the paper's."""
    printed = table2.PAPER
    pchi2 = {name: 0.2 * (1 + share * (printed.pchi2[name] / printed.pchi2["sa2h"] - 1)) for name in printed.index}
    psnr = {name: 20 * (1 + share * (printed.psnr[name] / printed.psnr["sa2h"] - 1)) for name in printed.index}
    return pchi2, psnr


def test_the_fit_is_that_of_dummies_and_of_a_t_test() -> None:
    runs = runs_of(*of_paper(1.0), sd=0.7)
    fit = table2.fitted(runs, "psnr")
    dummies = pd.get_dummies(runs[["network", "anatomy"]].astype(str), drop_first=True).astype(float)
    design = np.column_stack([np.ones(len(runs)), dummies])
    solution, residual, *_ = np.linalg.lstsq(design, runs["psnr"], rcond=None)
    assert fit.dof == 23 - 8
    assert fit.sd == pytest.approx(np.sqrt(residual[0] / fit.dof))
    of_name = dict(zip(dummies.columns, solution[1:], strict=True))
    for network in table2.ABLATED:
        more, error = fit.difference(network)
        expected = of_name.get(f"network_{network}", 0.0) - of_name["network_sa2h"]
        assert more == pytest.approx(expected)
        assert error > 0
    one = runs[runs["network"].isin(["sa2h", "nsa2h"]) & (runs["anatomy"] == 10)]
    welch = stats.ttest_ind(*(one.loc[one["network"] == name, "psnr"] for name in ("nsa2h", "sa2h")), equal_var=True)
    more, error = table2.fitted(one, "psnr").difference("nsa2h")
    assert more / error == pytest.approx(welch.statistic)


@pytest.mark.parametrize(
    ("runs", "verdict"),
    [
        (runs_of(*of_paper(1.0), sd=0.3), "reproduced"),
        (runs_of(*of_paper(1.0), sd=0.3, fd_speckle=1.6), "no verdict"),
        (runs_of(*of_paper(0.0), sd=0.3), "not reproduced"),
        (runs_of(*of_paper(0.0), sd=8.0), "undecided"),
        (runs_of(*of_paper(-1.0), sd=0.3), "undecided: reversed"),
        (runs_of(of_paper(1.0)[0], alike(20.0), sd=0.3), "undecided"),
    ],
)
def test_the_verdict_is_that_of_the_rule(runs: pd.DataFrame, verdict: str) -> None:
    assert table2.verdict(runs, table2.tests(runs)).startswith(verdict)


def test_effects_are_shares_of_sa2h_and_corrected_over_all_ten() -> None:
    table = table2.tests(runs_of(*of_paper(0.5), sd=0.2)).set_index(["metric", "network"])
    assert table.loc[("pchi2", "sa2h-conv"), "paper"] == pytest.approx(0.76, abs=0.005)
    # 0.02 and 1 are added for the anatomy's mean, so a share of SA2H is a little smaller than it was made
    assert table.loc[("pchi2", "sa2h-conv"), "share"] == pytest.approx(0.5 * 0.758 * 0.2 / 0.221, abs=0.05)
    p = table["p"].to_numpy()
    ordered = np.sort(p)
    by_hand = [max(min(1, ordered[j] * (10 - j)) for j in range(k + 1)) for k in range(10)]
    np.testing.assert_allclose(np.sort(table["p_holm"]), by_hand)


def test_tau_is_one_for_the_papers_order_and_minus_one_for_its_reverse() -> None:
    assert table2.orders(runs_of(*of_paper(1.0)))["tau"]["psnr"] == pytest.approx(1.0)
    assert table2.orders(runs_of(*of_paper(-0.5)))["tau"]["pchi2"] == pytest.approx(-1.0)
    assert table2.orders(runs_of(*of_paper(1.0)))["p"]["psnr"] == pytest.approx(2 / 5040)


KEPT = Path(__file__).parents[1] / "docs" / "results" / "table2"


def kept_means(metric: str) -> pd.DataFrame:
    """Network, anatomy and mean over test frames of the kept runs with labels in the order of their seed."""
    rows = []
    for folder in sorted(KEPT.glob("*-seed*")):
        changed = json.loads((folder / "training.json").read_text())["changed"]
        if "encoding" in changed:
            continue
        (file,) = folder.glob(f"scores/{metric}@*.parquet")
        frames = pd.read_parquet(file)
        of_network = frames[(frames["source"] == "model") & (frames["split"] == "test")]
        rows.append(
            (folder.name.partition(".")[0], changed["scene.anatomy_seed"], of_network["value"].to_numpy().mean())
        )
    return pd.DataFrame(rows, columns=["network", "anatomy", "value"])


@pytest.mark.parametrize(("metric", "sign"), [("pchi2", 1), ("psnr", -1)])
def test_the_kept_study_gives_the_same_in_another_way(metric: str, sign: int) -> None:
    """Differences to SA2H as coefficients of dummies, their errors by the normal equations."""
    kept = kept_means(metric)
    assert len(kept) == 23
    others = [name for name in table2.PAPER.index if name != "sa2h"]
    columns = [np.ones(len(kept)), kept["anatomy"] == 11, *(kept["network"] == name for name in others)]
    design = np.column_stack(columns).astype(float)
    solution, residual, rank, _ = np.linalg.lstsq(design, kept["value"].to_numpy(), rcond=None)
    dof = len(kept) - rank
    error = np.sqrt(np.diag(np.linalg.inv(design.T @ design)) * residual[0] / dof)
    runs = table2.read_runs(KEPT)
    found = table2.tests(runs[runs["labels"] == "arbitrary"]).set_index(["metric", "network"]).loc[metric]
    for number, name in enumerate(others, start=2):
        if name in found.index:
            worse = sign * solution[number]
            assert found.loc[name, "worse"] == pytest.approx(worse)
            assert found.loc[name, "p"] == pytest.approx(stats.t.sf(worse / error[number], dof))
            assert found.loc[name, "upper"] == pytest.approx(worse + stats.t.ppf(0.975, dof) * error[number])


def test_the_page_says_what_the_rule_says_of_the_kept_study() -> None:
    runs = table2.read_runs(KEPT)
    runs = runs[runs["labels"] == "arbitrary"]
    word = table2.verdict(runs, table2.tests(runs)).partition(":")[0]
    page = (KEPT.parents[1] / "table2.md").read_text()
    assert page.partition("## Result")[2].strip().lower().startswith(f"**{word}**")
    means = table2.beside_the_paper(runs)
    for network in table2.PAPER.index:
        (row,) = [line for line in page.splitlines() if line.lower().startswith(f"| {network} |")]
        cells = [cell.strip() for cell in row.split("|")]
        for place, metric in ((2, "psnr, here"), (4, "mae, here"), (6, "pchi2, here"), (8, "fd_speckle, here")):
            decimals = len(cells[place].partition(".")[2])
            assert float(cells[place]) == pytest.approx(means.loc[network, metric], abs=0.51 * 10**-decimals)
