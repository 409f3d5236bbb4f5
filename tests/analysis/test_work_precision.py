"""Orders, budgets and their figures, against what they were made from."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.image import imread

from ablate.analysis import budget_table, error_vs_runtime, observed_order, order_figure, pareto_front

N = np.array([1, 2, 4, 8, 16, 32, 64, 128])


@given(order=st.floats(-3, 3), factor=st.floats(1e-6, 1e6))
def test_the_order_of_a_power_law_is_found(order: float, factor: float) -> None:
    fit = observed_order(N, factor * N**-order)
    assert fit is not None
    assert fit.order == pytest.approx(order, abs=1e-9)
    assert fit.standard_error == pytest.approx(0, abs=1e-6)


def test_the_standard_error_is_that_of_a_linear_fit() -> None:
    error = N**-0.5 * np.exp(np.random.default_rng(0).normal(0, 0.1, len(N)))
    fit = observed_order(N, error)
    slope, covariance = np.polyfit(np.log(N), np.log(error), 1, cov=True)
    assert fit is not None
    assert (fit.order, fit.standard_error) == pytest.approx((-slope[0], covariance[0, 0] ** 0.5))


def test_decibels_are_taken_as_the_error_that_they_stand_for() -> None:
    fit = observed_order(N, 20 * np.log10(255 / (30 * N**-0.5)), "psnr")
    assert fit is not None
    assert fit.order == pytest.approx(0.5)


def test_no_order_without_two_errors() -> None:
    assert observed_order(N, np.zeros(len(N))) is None
    assert observed_order(np.array([4.0]), np.array([1.0])) is None
    assert observed_order(np.array([4.0, 4.0]), np.array([1.0, 2.0])) is None
    fit = observed_order(N, np.where(N > 2, np.inf, 1 / N))
    assert fit is not None
    assert fit.order == pytest.approx(1)
    assert np.isnan(fit.standard_error)


def points(seed: int = 0) -> pd.DataFrame:
    random = np.random.default_rng(seed)
    rows = []
    for series, fixed in (("simulator, rays", 60.0), ("simulator, other scatterers", 60.0), ("sa2h", 20.0)):
        for n in N:
            ms = fixed + n * random.uniform(1, 9)
            for metric in ("envelope_rms", "mae", "psnr") if series != "sa2h" else ("mae", "psnr"):
                value = 30 + 2 * np.log2(n) if metric == "psnr" else 1 / n
                rows.append(
                    (series, f"{n} eager" if series == "sa2h" else str(n), ms, metric, value * random.uniform())
                )
    return pd.DataFrame(rows, columns=["series", "setting", "ms", "metric", "error"])


def test_pareto_front_against_brute_force() -> None:
    rng = np.random.default_rng(0)
    for n in (0, 1, 30):
        ms, error = rng.integers(1, 12, (2, n)).astype(float)
        points = set(zip(ms, error, strict=True))
        expected = {p for p in points if not any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)}
        front = pareto_front(ms, error)
        assert {(ms[k], error[k]) for k in front} == expected
        assert len(front) == len(expected)


@pytest.mark.parametrize("seed", range(5))
def test_the_best_within_a_budget_against_brute_force(seed: int) -> None:
    table = points(seed)
    groups = {"same": ["simulator, rays"], "other": ["simulator, other scatterers"], "run": ["sa2h"]}
    found = budget_table(table, groups, ("other", "run"))
    assert sorted(set(found["budget_ms"])) == [10, 40, 75, 200, 1000]
    for row in found.to_dict("records"):
        sign = -1 if row["metric"] == "psnr" else 1
        best = {}
        for group, series in groups.items():
            fit = [
                (sign * p["error"], p["ms"], f"{p['series']}: {p['setting']}")
                for p in table.to_dict("records")
                if p["series"] in series and p["metric"] == row["metric"] and p["ms"] <= row["budget_ms"]
            ]
            assert row[group] == (min(fit)[2] if fit else "")
            if fit:
                best[group] = min(fit)[0]
        rivals = {g: e for g, e in best.items() if g != "same"}
        compared = row["metric"] != "envelope_rms"  # a trained run has no envelope
        assert row["better"] == (min(rivals, key=lambda g: rivals[g]) if rivals and compared else "")


def test_the_fastest_of_equal_points_is_taken() -> None:
    equal = points().assign(error=1.0)
    row = budget_table(equal, {"a": ["sa2h"]}, ("a", "a")).set_index(["metric", "budget_ms"]).loc[("mae", 1000.0)]
    assert row["a_ms"] == equal[equal["series"] == "sa2h"]["ms"].min()


def assert_drawn(paths: list[Path]) -> None:
    assert [path.suffix for path in paths] == [".png", ".pdf"]
    assert imread(paths[0])[..., :3].std() > 0.01
    assert paths[1].read_bytes().startswith(b"%PDF")


def test_figures_are_drawn(tmp_path: Path) -> None:
    table = points()
    floors = {"mae": 0.3, "psnr": 20.0}
    times = [("simulator, rays", "1", "signal chain", 5.0), ("simulator, rays", "1", "S", 0.01)]
    times += [("sa2h", f"fp32, {engine}, seed 0", "network", ms) for engine, ms in (("eager", 9.0), ("compiled", 4.0))]
    parts = pd.DataFrame(times, columns=["series", "setting", "part", "ms"])
    assert_drawn(error_vs_runtime(table, tmp_path / "precision", floors, "a test", parts))
    alone = table[table["series"] == "simulator, rays"].assign(error=lambda t: t["error"].where(t["ms"] > 70, np.inf))
    assert_drawn(error_vs_runtime(alone, tmp_path / "alone", {}, "a test", parts[:2]))
    grids = [
        ("simulator, layers", setting, metric, value)
        for metric in ("mae_smooth", "pchi2")
        for setting, value in (("other scatterers", 2.0), ("1", 5.0), ("3", 2.5))
    ]
    convergence = pd.DataFrame(grids, columns=["series", "setting", "quantity", "value"])
    of_rays = table[table["series"] == "simulator, rays"]
    assert_drawn(order_figure(of_rays, convergence, {"simulator, layers": 3}, tmp_path / "order"))
