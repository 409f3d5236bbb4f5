"""What a terminal shows fits it, is in the order of a metric, and says how much better the best network is."""

import re
from random import Random
from unittest import mock

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ablate import analysis
from ablate.analysis import RESIMULATION, verdict_table
from ablate.analysis.leaderboard import SCREEN_COLUMNS
from ablate.metrics import METRICS, Shown, shown_in
from ablate.study.compare import Compared, on_screen
from ablate.study.run import COMPARISON

NAMES = st.lists(
    st.from_regex(r"[a-z]{2,12}(-[a-z]{2,8}){0,3}(\.[a-z]{2,12}-[a-z0-9]{1,9}){0,5}", fullmatch=True),
    min_size=1,
    max_size=4,
    unique=True,
)


def comparison(means: dict[str, dict[str, float]], seeds: int = 3, spread: float = 0.01) -> pd.DataFrame:
    """Scalars of some seeds about the means by variant and metric."""
    offsets = np.linspace(-spread, spread, seeds) if seeds > 1 else [0.0]
    rows = [
        (variant, seed, metric, mean + offset)
        for variant, of_metrics in means.items()
        for metric, mean in of_metrics.items()
        for seed, offset in enumerate([0.0] if variant == RESIMULATION else offsets)
    ]
    return pd.DataFrame(rows, columns=["variant", "seed", "metric", "value"])


NOTHING = pd.DataFrame(columns=["variant", "seed", "frame", "site", "metric", "value"]).astype({"value": float})


def table_of(scalars: pd.DataFrame) -> pd.DataFrame:
    return analysis.comparison_table(NOTHING, scalars)


@settings(max_examples=12, deadline=None)
@example(["aa", "aa.aa-0.aa-0.aa-0.aa-00000.aa-00000000"], {"mae_smooth", "mae", "motion", "psnr", "pchi2"}, Random(0))
@given(NAMES, st.sets(st.sampled_from(shown_in(Shown.screen)), min_size=1), st.randoms(use_true_random=False))
def test_a_comparison_fits_a_terminal_and_has_every_variant_and_every_metric_by_name(names, metrics, random) -> None:
    values = {name: {metric: random.uniform(0, 99) for metric in metrics} for name in [*names, RESIMULATION]}
    printed = analysis.to_text(table_of(comparison(values, seeds=1)))
    assert max(map(len, printed.splitlines())) <= SCREEN_COLUMNS
    unbroken = re.sub(r"\s+", "", printed)
    assert all(METRICS[metric].label.split()[0] in unbroken for metric in metrics)
    for name in names:
        assert all(part in printed for part in re.split(r"(?=\.)", name))


@settings(max_examples=10, deadline=None)
@given(st.lists(st.integers(0, 99_999), min_size=2, max_size=8, unique=True))
def test_the_best_network_is_first_and_baselines_are_set_apart_below(values: list[int]) -> None:
    means = {f"v{k}": {"pchi2": value / 1e5, "psnr": value / 1e3} for k, value in enumerate(values)}
    lines = analysis.to_text(table_of(comparison({RESIMULATION: {"pchi2": 0.0, "psnr": 1.0}, **means}, spread=0)))
    rows = [line.split()[0] for line in lines.splitlines() if re.match(r"v\d|re-sim|---", line)]
    networks = [f"v{k}" for k in np.argsort(values)]
    rule = rows[0]
    assert set(rule) == {"-"}
    assert rows == [rule, *networks, rule, RESIMULATION]


@pytest.mark.parametrize(("metric", "first"), [("pchi2", "b"), ("psnr", "a"), ("noise_sd", None)])
def test_the_order_is_that_of_the_first_metric_that_judges(metric: str, first: str | None) -> None:
    scalars = comparison({"a": {metric: 2.0, "parameters": 5.0}, "b": {metric: 1.0, "parameters": 1.0}})
    table = table_of(scalars)
    assert analysis.ranked_by(table) == (metric if first else None)
    assert analysis.best_first(table)[0] == (first or "a")
    assert analysis.ranked_by(table_of(comparison({"a": {"psnr": 1.0, "pchi2": 1.0}}))) == "pchi2"


def test_a_metric_that_no_screen_shows_otherwise_is_shown_where_networks_are_ordered_by_it(tmp_path) -> None:
    """Times are not there where jobs ran elsewhere, so that no column was left."""
    comparison_folder = tmp_path / COMPARISON
    comparison_folder.mkdir()
    verdict_table(NOTHING, None, []).to_csv(comparison_folder / "verdicts.csv", index=False)
    for metric, shown in (("mae_fan", "fan"), ("motion_screen", "Best    no metric")):
        scalars = comparison({"sa2h": {metric: 2.0}, "b": {metric: 1.0}})
        results = mock.Mock(claims=analysis.seed_claims(NOTHING, scalars))
        study = mock.Mock(table=table_of(scalars), results=results, folder=tmp_path, reference="sa2h")
        assert shown in on_screen(Compared(study, ()), "make ui")


WORDS = {
    "the reference is not best": ({"sa2h": 0.2, "b": 0.1}, 3, r"b by pχ² ↓: 0\.100 \(sa2h 0\.200, .*difference of -0"),
    "the reference is best": ({"sa2h": 0.1, "b": 0.2}, 3, r"sa2h by pχ² ↓: 0\.100 \(b 0\.200, .*difference of -0\.10"),
    "one seed": ({"sa2h": 0.1, "b": 0.2}, 1, r"sa2h by pχ² ↓.*too few seeds to say more"),
    "one network": ({"sa2h": 0.1}, 3, r"sa2h by pχ² ↓: 0\.100, the only network \(re-simulation 0\.050\)"),
    "no reference": ({"a": 0.1, "b": 0.2}, 3, r"a by pχ² ↓: 0\.100 \(b 0\.200, re-.*reference=b"),
}


def test_one_network_of_several_with_a_score_is_not_called_the_only_one() -> None:
    table = table_of(comparison({"sa2h": {"pchi2": 0.1, "psnr": 20.0}, "b": {"psnr": 21.0}}))
    claims = analysis.seed_claims(NOTHING, comparison({"sa2h": {"pchi2": 0.1}}))
    assert "the only network with this score" in analysis.best_in_words(table, claims, "sa2h")


@pytest.mark.parametrize("case", WORDS)
def test_who_is_best_is_said_with_by_how_much(case: str) -> None:
    means, seeds, words = WORDS[case]
    scalars = comparison({RESIMULATION: {"pchi2": 0.05}} | {name: {"pchi2": m} for name, m in means.items()}, seeds)
    said = analysis.best_in_words(table_of(scalars), analysis.seed_claims(NOTHING, scalars), "sa2h")
    assert re.match(words, said), said
    interval = re.search(r"\[(.+), (.+)\]", said)
    if interval:
        assert float(interval[1]) < -0.1 < float(interval[2]), "the difference of the means lies in its interval"
        assert "more than seeds explain" in said
