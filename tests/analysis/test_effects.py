"""Factorial effects against means taken by hand and a t-test."""

import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from ablate.analysis import factorial_effects


def factorial(seeds, effect, noise=0.0):
    rng = np.random.default_rng(0)
    rows = [
        {"att": a, "conv": b, "noise": c, "value": effect(i, j, k) + noise * rng.normal()}
        for (i, a), (j, b), (k, c) in itertools.product(
            *(enumerate(x) for x in (("on", "off"), ("on", "off"), ("inject", "none")))
        )
        for _ in range(seeds)
    ]
    return pd.DataFrame(rows)


def test_known_effects_are_recovered():
    runs = factorial(1, lambda i, j, k: 10 - 2 * i + 0.5 * j + 3 * i * k)
    table = factorial_effects(runs, ["att", "conv", "noise"]).set_index("effect")
    # With the interaction 3 i k, the effect of att averaged over noise is -2 + 1.5.
    assert table["estimate"].to_dict() == pytest.approx(
        {"att": -0.5, "conv": 0.5, "noise": 1.5, "att:conv": 0, "att:noise": 1.5, "conv:noise": 0}, abs=1e-12
    )
    assert (table["dof"] == 1).all()


def test_balanced_estimates_are_differences_of_means_and_intervals_hold_them():
    runs = factorial(3, lambda i, j, _: i - j, noise=0.5)
    table = factorial_effects(runs, ["att", "conv", "noise"]).set_index("effect")
    by_level = runs.groupby("att")["value"].mean()
    assert table.loc["att", "estimate"] == pytest.approx(by_level["off"] - by_level["on"])
    assert table.loc["att", "lower"] < 1 < table.loc["att", "upper"]
    assert table.loc["att", "p"] < 0.01
    assert (table["dof"] == 24 - 7).all()


def test_one_factor_is_the_two_sample_t_test():
    values = [1.0, 1.4, 0.9, 2.0, 2.2, 2.9]
    runs = pd.DataFrame({"att": ["on"] * 3 + ["off"] * 3, "value": values})
    row = factorial_effects(runs, ["att"]).iloc[0]
    assert row["p"] == pytest.approx(stats.ttest_ind(values[:3], values[3:]).pvalue)


def test_standard_errors_are_those_of_ordinary_least_squares():
    """Against the textbook's formula on dummy variables: effects are sums of their coefficients."""
    runs = factorial(3, lambda i, j, k: i - j * k, noise=0.7)
    row = factorial_effects(runs, ["att", "conv", "noise"]).set_index("effect").loc["att"]
    i, j, k = (
        (runs[name] == level).to_numpy(float) for name, level in (("att", "off"), ("conv", "off"), ("noise", "none"))
    )
    design = np.column_stack([np.ones(len(runs)), i, j, k, i * j, i * k, j * k])
    beta, rss, _, _ = np.linalg.lstsq(design, runs["value"].to_numpy(), rcond=None)
    weights = np.array([0, 1, 0, 0, 0.5, 0.5, 0])  # the effect of att, averaged over the levels of the others
    error = np.sqrt(rss[0] / (24 - 7) * weights @ np.linalg.inv(design.T @ design) @ weights)
    reach = stats.t.ppf(0.975, 17) * error
    assert row["estimate"] == pytest.approx(weights @ beta)
    assert (row["lower"], row["upper"]) == pytest.approx((weights @ beta - reach, weights @ beta + reach))
    assert row["p"] == pytest.approx(2 * stats.t.sf(abs(weights @ beta) / error, 17))


def test_saturated_designs_have_no_interval_and_bad_ones_are_refused():
    runs = pd.DataFrame({"a": [0, 0, 1, 1], "b": [0, 1, 0, 1], "value": [1.0, 2.0, 3.0, 5.0]})
    table = factorial_effects(runs, ["a", "b"])
    assert table["lower"].isna().all()
    assert (table["dof"] == 0).all()
    with pytest.raises(ValueError, match="lack the columns"):
        factorial_effects(runs, ["a", "c"])
    with pytest.raises(ValueError, match="needs 2 levels"):
        factorial_effects(runs.assign(b=0), ["a", "b"])
    with pytest.raises(ValueError, match="tell"):
        factorial_effects(runs.iloc[[0, 3]], ["a", "b"])
