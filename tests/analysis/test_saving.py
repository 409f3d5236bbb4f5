"""What is asked of a component that saves, networks that vary more than others, and keys of three levels."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from ablate import analysis
from ablate.analysis import Component, Design, Question, Verdict, find_design
from ablate.analysis.statistics.verdicts import saving_verdict

METRIC = "mae_smooth"  # less is better
NAMES = ("a", "b", "c", "d", "e", "f", "g", "h")
COMPONENTS = tuple(Component(name, f"model.{name}", "on", "off", metric=METRIC, band=1.0) for name in NAMES)
SEEDS = {"sa2h": 5} | dict.fromkeys(NAMES, 3)  # what a small study affords


def one_at_a_time(names: tuple[str, ...] = NAMES) -> Design:
    full = {f"model.{name}": "on" for name in names}
    runs = {"sa2h": full} | {name: full | {f"model.{name}": "off"} for name in names}
    design = find_design(runs, tuple(full))
    assert design is not None
    return design


def means_of(values: dict[str, list[float]], design: Design, **costs: float) -> pd.DataFrame:
    """The means of runs by label; a cost is what the first label has more than the others."""
    rows = [(v, s, "", METRIC, score) for v, scores in values.items() for s, score in enumerate(scores)]
    for cost, more in costs.items():
        rows += [(v, s, "", cost, 40.0 + more * (v == "sa2h")) for v, of in values.items() for s in range(len(of))]
    table = pd.DataFrame(rows, columns=["variant", "seed", "data", "metric", "value"])
    return table.join(design.cells, on="variant")


@pytest.mark.parametrize(
    ("improvement", "p", "p_band", "cheaper", "expected"),
    [
        (0.1, 0.6, 0.001, True, Verdict.saves),
        (-0.3, 0.001, 0.001, True, Verdict.saves),  # harm that is certain, but too small to matter
        (0.1, 0.6, 0.001, False, Verdict.undecided),
        (-5.0, 0.001, 1.0, True, Verdict.harms),
        (-0.3, 0.2, 0.2, True, Verdict.undecided),
        (5.0, 0.001, 0.2, True, Verdict.undecided),  # cannot be: an improvement is further from the band than from 0
    ],
)
def test_the_rule_for_what_saves(improvement: float, p: float, p_band: float, cheaper: bool, expected: Verdict) -> None:
    assert saving_verdict(improvement, p, p_band, cheaper) is expected


@pytest.mark.parametrize(("added_ms", "expected"), [(-6.0, "saves"), (0.0, "undecided"), (6.0, "undecided")])
def test_non_inferiority_is_the_shifted_t_test_of_scipy(added_ms: float, expected: str) -> None:
    full, without = [10.2, 10.4, 9.9, 10.1, 10.3], [10.0, 10.1, 9.8, 10.2]
    design = one_at_a_time(("a",))
    means = means_of({"sa2h": full, "a": without}, design, ms_per_frame=added_ms)
    (row,) = analysis.verdict_table(means, design, [replace(COMPONENTS[0], question=Question.saves)]).to_dict("records")
    shifted = stats.ttest_ind(np.array(full) - 1.0, without, alternative="less")
    assert row["p_band_holm"] == pytest.approx(shifted.pvalue)
    assert row["p_holm"] == pytest.approx(stats.ttest_ind(full, without).pvalue)
    assert (row["verdict"], row["question"]) == (expected, "saves")
    upper = -stats.ttest_ind(full, without).confidence_interval(0.90).high
    assert row["least"] == pytest.approx(upper), "the upper end of the harm's one-sided interval"
    assert (row["least"] > -row["band"]) == (shifted.pvalue < 0.05)
    asked_to_earn = analysis.verdict_table(means, design, COMPONENTS[:1])["verdict"].item()
    assert asked_to_earn == "does_not", "the other question has another answer"


def test_harm_that_is_shown_is_said() -> None:
    design = one_at_a_time(("a",))
    means = means_of({"sa2h": [14.0, 14.3, 13.9], "a": [10.0, 10.1, 9.8]}, design, ms_per_frame=-6.0)
    row = analysis.verdict_table(means, design, [replace(COMPONENTS[0], question=Question.saves)]).iloc[0]
    assert (row["verdict"], bool(row["most"] < 0)) == ("harms", True)


@pytest.mark.parametrize("spread", [1.0, 6.0])
def test_two_networks_that_vary_differently_are_compared_by_welchs_test(spread: float) -> None:
    chance = np.array([0.3, -0.4, 0.1, 0.2, -0.2])
    full, without = 10 + chance, 13 + spread * chance
    design = one_at_a_time(("a",))
    means = means_of({"sa2h": list(full), "a": list(without)}, design)
    (row,) = analysis.verdict_table(means, design, COMPONENTS[:1]).to_dict("records")
    expected = stats.ttest_ind(full, without, equal_var=spread == 1)
    assert row["error"] == ("all" if spread == 1 else "own")
    assert row["p_holm"] == pytest.approx(expected.pvalue)
    assert (row["lower"], row["upper"]) == pytest.approx(tuple(expected.confidence_interval()))
    assert row["dof"] == pytest.approx(expected.df)


def by_hand(values: np.ndarray, label: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of studies (n, runs): improvements by each component, p by the pooled error, and p by the rule, (n, 8) each.

    Every network has a mean of its own: an effect is a difference of two means, and errors are spreads in networks.
    """
    cells = [values[:, label == name] for name in SEEDS]
    sizes = np.array([cell.shape[1] for cell in cells])
    squares = np.stack([cell.var(axis=1) * cell.shape[1] for cell in cells], axis=1)
    means = np.stack([cell.mean(axis=1) for cell in cells], axis=1)
    improvement = means[:, 1:] - means[:, :1]
    dof = sizes.sum() - len(sizes)
    pooled = np.sqrt(squares.sum(axis=1, keepdims=True) / dof * (1 / sizes[0] + 1 / sizes[1:]))
    p_pooled = 2 * stats.t.sf(np.abs(improvement) / pooled, dof)
    own_dof, rest_dof = sizes[1:] - 1, dof - sizes[1:] + 1
    own = squares[:, 1:] / own_dof
    rest = (squares.sum(axis=1, keepdims=True) - squares[:, 1:]) / rest_dof
    parts = own / sizes[1:], rest / sizes[0]
    error = np.sqrt(parts[0] + parts[1])
    welch_dof = error**4 / (parts[0] ** 2 / own_dof + parts[1] ** 2 / rest_dof)
    p_own = 2 * stats.t.sf(np.abs(improvement) / error, welch_dof)
    alike = 2 * np.minimum(stats.f.sf(rest / own, rest_dof, own_dof), stats.f.cdf(rest / own, rest_dof, own_dof))
    return improvement, p_pooled, np.where((alike < 0.05) & (error > pooled), p_own, p_pooled)


def holm(p: np.ndarray) -> np.ndarray:
    """Holm's correction in each row."""
    order = np.argsort(p, axis=1)
    corrected = np.take_along_axis(p, order, axis=1) * np.arange(p.shape[1], 0, -1)
    corrected = np.minimum(np.maximum.accumulate(corrected, axis=1), 1)
    return np.take_along_axis(corrected, np.argsort(order, axis=1), axis=1)


def simulated(n: int, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Studies in which no component does anything, (n, runs); the first network without one varies `spread` times."""
    label = np.repeat(list(SEEDS), list(SEEDS.values()))
    chance = np.random.default_rng(0).normal(size=(n, len(label)))
    return 10 + chance * np.where(label == "a", spread, 1.0), label


@pytest.mark.parametrize(("spread", "pooled_is_wrong"), [(1.0, False), (3.0, True), (6.0, True)])
def test_a_network_that_varies_more_makes_no_more_false_verdicts(spread: float, pooled_is_wrong: bool) -> None:
    """The share of 20,000 studies without any effect that say `earns` of a component."""
    values, label = simulated(20_000, spread)
    improvement, p_pooled, p = by_hand(values, label)
    pooled, by_rule = (np.mean(((holm(by) < 0.05) & (improvement > 0)).any(axis=1)) for by in (p_pooled, p))
    print(f"{spread:g} times the spread: {pooled:.3f} by the pooled error, {by_rule:.3f} by the rule")
    assert by_rule < 0.05
    assert (pooled > 0.05) == pooled_is_wrong


def test_the_simulation_is_of_the_rule_of_the_package() -> None:
    values, label = simulated(4, 6.0)
    design = one_at_a_time()
    improvement, _, p = by_hand(values, label)
    for k, own in enumerate(values):
        means = means_of({name: list(own[label == name]) for name in SEEDS}, design)
        table = analysis.verdict_table(means, design, COMPONENTS)
        np.testing.assert_allclose(table["p_holm"], holm(p[k : k + 1])[0])
        np.testing.assert_allclose(-table["effect"], improvement[k])


def test_where_a_saving_costs_the_band_at_most_one_study_in_twenty_says_that_it_saves() -> None:
    values, label = simulated(20_000, 1.0)
    improvement, _, _ = by_hand(values - 1.0 * (label != "sa2h"), label)  # without it each is better by the band
    _, p_pooled, _ = by_hand(values, label)
    t = stats.t.isf(p_pooled / 2, sum(SEEDS.values()) - len(SEEDS))
    error = np.abs(improvement + 1.0) / t
    p_band = stats.t.sf((improvement + 1.0) / error, sum(SEEDS.values()) - len(SEEDS))
    assert 0.03 < np.mean((holm(p_band) < 0.05).any(axis=1)) < 0.055


LABELS = (
    Component("order", "encoding", "echogenicity", "arbitrary", metric=METRIC, band=1.0),
    Component("properties", "encoding", "properties", "echogenicity", metric=METRIC, band=1.0),
)


def test_a_key_of_three_levels_has_a_verdict_for_each_two_that_were_declared() -> None:
    values = {"sa2h": [10.0, 10.4, 9.7], "mixed": [14.0, 14.5, 13.6], "told": [7.0, 7.2, 6.5]}
    levels = {"sa2h": "echogenicity", "mixed": "arbitrary", "told": "properties"}
    runs = {name: {"encoding": level} for name, level in levels.items()}
    design = find_design(runs, ("encoding",), components=LABELS)
    assert design is not None
    assert design.factors == ["encoding=arbitrary", "encoding=properties"]
    assert "one change at a time around sa2h (3 cells)" in design.name
    table = analysis.verdict_table(means_of(values, design), design, LABELS).set_index("component")
    means = {name: np.mean(scores) for name, scores in values.items()}
    assert table["effect"].to_dict() == pytest.approx(
        {"order": means["sa2h"] - means["mixed"], "properties": means["told"] - means["sa2h"]}
    )
    pooled = np.mean([np.var(scores, ddof=1) for scores in values.values()]) * 2 / 3
    p = [2 * stats.t.sf(abs(effect) / np.sqrt(pooled), 6) for effect in table["effect"]]
    assert table["p_holm"].tolist() == pytest.approx(holm(np.array([p]))[0].tolist())
    assert table["verdict"].tolist() == ["earns", "earns"]
    effects = analysis.effects_table(means_of(values, design), design)
    assert effects["to"].tolist() == ["arbitrary", "properties"]
    dots = analysis.improvements(means_of(values, design), design, LABELS)
    assert dots.groupby(["component", "on"])["improvement"].mean().round(9).to_dict() == pytest.approx(
        {("order", False): 0, ("order", True): 4.0, ("properties", False): 0, ("properties", True): 3.133333333},
        abs=1e-6,
    )


def test_a_third_level_that_nobody_declared_is_left_out() -> None:
    runs = {name: {"encoding": name} for name in ("echogenicity", "arbitrary", "properties", "mine")}
    one = find_design(runs, ("encoding",), "echogenicity", LABELS[:1])
    assert one is not None
    assert one.factors == ["encoding"]
    assert one.reading.endswith("Left out of it: properties, mine.")
    both = find_design(runs, ("encoding",), "echogenicity", LABELS)
    assert both is not None
    assert both.reading.endswith("Left out of it: mine.")


def test_two_levels_are_judged_by_the_component_that_compares_them() -> None:
    for other, (judged, not_judged) in zip(("arbitrary", "properties"), [*pairwise([*LABELS, LABELS[0]])], strict=True):
        design = find_design({"sa2h": {"encoding": "echogenicity"}, "other": {"encoding": other}}, ("encoding",))
        assert design is not None
        means = means_of({"sa2h": [1.0, 1.2, 0.9], "other": [4.0, 4.1, 4.4]}, design)
        table = analysis.verdict_table(means, design, LABELS).set_index("component")
        assert np.isfinite(table.loc[judged.name, "effect"])
        assert table.loc[not_judged.name, "why"] == f"the runs compare echogenicity with {other}"


def test_a_share_that_is_none_is_refused() -> None:
    with pytest.raises(ValueError, match=r"component a: share=0\.0: allowed are finite numbers above 0"):
        replace(COMPONENTS[0], share=0.0)
