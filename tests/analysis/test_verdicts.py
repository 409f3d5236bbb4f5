"""Verdicts on synthetic runs in half of a factorial of six: what was put in comes out, and chance does not."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from ablate import analysis
from ablate.analysis import Component, Design, Verdict, find_design
from ablate.analysis.statistics.verdicts import VERDICT_COLUMNS, verdict
from support.components import COMPONENTS, FULL, without

NAMES = [component.name for component in COMPONENTS]
METRIC = {component.name: str(component.metric) for component in COMPONENTS}
OF_ONE = tuple(replace(component, band=1.0) for component in COMPONENTS)  # all with a band of 1


def verdict_table(means: pd.DataFrame, design: Design | None, bands: bool = True, **more: object) -> pd.DataFrame:
    return analysis.verdict_table(means, design, COMPONENTS if bands else OF_ONE, **more)


@pytest.fixture(scope="module")
def cells() -> pd.DataFrame:
    """The runs of the study, and two more seeds of SA2H: variant, seed, data, a column a component that is 1 if on.

    The second anatomy has the runs in which an odd number of three components is off.
    """
    halves = [off for size in (0, 2, 4, 6) for off in combinations(NAMES, size)]
    rows = [
        {"variant": ".".join(["sa2h", *off]), "seed": seed, **{name: int(name not in off) for name in NAMES}}
        for seed, off in enumerate(halves)
    ]
    table = pd.DataFrame([*rows, *({**rows[0], "seed": seed} for seed in (32, 33))])
    return table.assign(data=((3 - table["att"] - table["concat"] - table["noise"]) % 2).astype(str))


@pytest.fixture(scope="module")
def design(cells: pd.DataFrame) -> Design:
    runs = {row["variant"]: without(*(name for name in NAMES if not row[name])) for row in cells.to_dict("records")}
    whole = find_design(runs, tuple(FULL))
    assert whole is not None
    return whole


def means_of(cells: pd.DataFrame, design: Design, values: np.ndarray) -> pd.DataFrame:
    """The table that verdicts are made from, with the same value in every primary metric."""
    runs = cells[["variant", "seed", "data"]].assign(value=values).join(design.cells, on="variant")
    return pd.concat([runs.assign(metric=metric) for metric in dict.fromkeys(METRIC.values())], ignore_index=True)


def response(cells: pd.DataFrame, mains: dict[str, float], pairs: dict[tuple[str, str], float]) -> np.ndarray:
    """A sum of what each component adds where it is on, and each pair where both are; the second anatomy adds 50."""
    value = 30.0 + 50.0 * (cells["data"] == "1")
    for name, size in mains.items():
        value += size * cells[name]
    for (a, b), size in pairs.items():
        value += size * cells[a] * cells[b]
    return value.to_numpy()


def test_known_effects_come_out_whatever_blocks_and_interactions_do(cells: pd.DataFrame, design: Design) -> None:
    mains, pairs = {"att": -7.0, "depth": 2.0}, {("att", "depth"): -4.0, ("concat", "noise"): 1.5}
    table = verdict_table(means_of(cells, design, response(cells, mains, pairs)), design).set_index("component")
    assert list(table.reset_index().columns) == list(VERDICT_COLUMNS)
    # Averaged over the other component, half of what a pair adds belongs to either of the two.
    averaged = {"att": -7 - 2, "depth": 2 - 2, "concat": 0.75, "noise": 0.75, "conv": 0, "encoding": 0}
    assert table["effect"].to_dict() == pytest.approx(averaged, abs=1e-9)
    at_full = {"att": -11, "depth": -2, "concat": 1.5, "noise": 1.5, "conv": 0, "encoding": 0}
    assert table["full_effect"].to_dict() == pytest.approx(at_full, abs=1e-9)
    counts = set(table[["runs_a", "runs_b", "dof"]].itertuples(index=False, name=None))
    assert counts == {(18, 16, 34 - 1 - 6 - 15 - 1)}
    in_pairs = analysis.interactions(means_of(cells, design, response(cells, mains, pairs)), design, COMPONENTS)
    assert len(in_pairs) == 30
    # Less is better in all primaries, so a smaller value improves.
    sizes = in_pairs.set_index(["component", "other"])["improvement"]
    put_in = {("att", "depth"): 2, ("depth", "att"): 2, ("noise", "concat"): -0.75, ("concat", "noise"): -0.75}
    assert sizes.to_dict() == pytest.approx(dict.fromkeys(sizes.index, 0) | put_in, abs=1e-9)


def test_intervals_are_those_of_least_squares_on_dummy_variables(cells: pd.DataFrame, design: Design) -> None:
    """The textbook's formula, on variables that are 1 where a component is on."""
    values = np.random.default_rng(0).normal(size=len(cells))
    table = verdict_table(means_of(cells, design, values), design).set_index("component")
    on = {name: cells[name].to_numpy(float) for name in NAMES}
    pairs = list(combinations(NAMES, 2))
    anatomy = (cells["data"] == "1").to_numpy(float)
    x = np.column_stack([np.ones(len(cells)), anatomy, *on.values(), *(on[a] * on[b] for a, b in pairs)])
    beta, rss, rank, _ = np.linalg.lstsq(x, values, rcond=None)
    dof = len(cells) - rank
    for k, name in enumerate(NAMES):
        for kind, share in (("", 0.5), ("full_", 1.0)):
            weights = np.array([0, 0, *np.eye(6)[k], *(share * (name in pair) for pair in pairs)])
            error = np.sqrt(rss[0] / dof * weights @ np.linalg.inv(x.T @ x) @ weights)
            reach = stats.t.ppf(0.975, dof) * error
            ends = (weights @ beta - reach, weights @ beta + reach)
            assert tuple(table.loc[name, [f"{kind}lower", f"{kind}upper"]]) == pytest.approx(ends)


@pytest.mark.parametrize(
    ("improvement", "p", "p_band", "expected"),
    [
        (5.0, 0.001, 0.9, Verdict.earns),
        (5.0, 0.06, 0.9, Verdict.undecided),
        (-5.0, 0.001, 0.001, Verdict.does_not),  # harm
        (0.3, 0.001, 0.001, Verdict.does_not),  # there, but too small to matter
        (0.3, 0.4, 0.001, Verdict.does_not),
        (0.3, 0.4, 0.2, Verdict.undecided),
        (-0.3, 0.4, 0.2, Verdict.undecided),
        (-5.0, 0.001, 0.2, Verdict.undecided),  # cannot be: harm is further from the band than from zero
    ],
)
def test_the_rule(improvement: float, p: float, p_band: float, expected: Verdict) -> None:
    assert verdict(improvement, p, p_band) is expected


def test_verdicts_follow_the_rule_with_holms_correction_by_hand(cells: pd.DataFrame, design: Design) -> None:
    rng = np.random.default_rng(3)
    sizes = {"att": -3.0, "concat": -0.2, "conv": -1.2, "noise": 1.0, "depth": -0.9, "encoding": 0.0}
    values = response(cells, sizes, {}) + rng.normal(size=len(cells))
    table = verdict_table(means_of(cells, design, values), design, bands=False)
    dof = int(table["dof"].iloc[0])
    error = (table["upper"] - table["lower"]) / 2 / stats.t.ppf(0.975, dof)
    ps = {
        "p_holm": 2 * stats.t.sf(np.abs(table["effect"]) / error, dof),
        "p_band_holm": stats.t.cdf((-table["effect"] - 1.0) / error, dof),
    }
    for name, raw in ps.items():
        adjusted = np.empty(6)
        running = 0.0
        for rank, k in enumerate(np.argsort(raw)):
            running = max(running, raw[k] * (6 - rank))
            adjusted[k] = min(running, 1.0)
        np.testing.assert_allclose(table[name], adjusted)
    verdicts = dict(zip(table["component"], table["verdict"], strict=True))
    assert verdicts["att"] == "earns"
    assert verdicts["noise"] == "does_not"
    assert set(verdicts.values()) == {"earns", "does_not", "undecided"}
    why = table.set_index("component")["why"]
    assert all(isinstance(why[name], str) == (word == "undecided") for name, word in verdicts.items())


def with_and_without(other: str) -> Design:
    """SA2H, and the same with another attenuation map."""
    made = {"model.family": "local", "model.attenuation": "integral", "model.noise": "inject"}
    runs = {"sa2h": made, "sa2h-att": made | {"model.attenuation": other}}
    design = find_design(runs, ("model.attenuation", "model.noise"))
    assert design is not None
    return design


def judged_by(component: Component, here: object, other: object) -> pd.Series:
    """The verdict on a component of which three seeds of two variants have these levels."""
    key = component.key
    pair = find_design({"sa2h": {key: here}, "sa2h.other": {key: other}}, (key,))
    assert pair is not None
    return analysis.verdict_table(seeds_of(pair, str(component.metric)), pair, [component]).iloc[0]


def seeds_of(pair: Design, metric: str, seeds: int = 3) -> pd.DataFrame:
    """Runs of two variants, of which the second is worse by 5."""
    rows = [(v, s, "", 9.0 + s + 5 * (v != "sa2h")) for v in pair.cells.index for s in range(seeds)]
    runs = pd.DataFrame(rows, columns=["variant", "seed", "data", "value"]).assign(metric=metric)
    return runs.join(pair.cells, on="variant")


RATE = Component("rate", "training.learning_rate", 1e-3, 1e-4, metric="mae_smooth", band=0.5)


@pytest.mark.parametrize(
    ("component", "here", "other", "judged"),
    [
        # Four levels are declared, of any two depths: frames with fewer rows have networks with fewer levels.
        *((COMPONENTS[NAMES.index("depth")], 2, other, judged) for other, judged in ((3, False), (5, True), (6, True))),
        (RATE, 1e-3, 1e-4, True),
        (RATE, 1e-3, 2e-3, False),
        (RATE, 5e-4, 1e-4, False),
        # A level that no run has judges nothing, and YAML reads 1e-3 as text: the other level would be taken for it.
        *((replace(RATE, on=on, off=None), 1e-3, 1e-4, True) for on in (1e-3, 1e-4)),
        *((replace(RATE, on=on, off=None), 1e-3, 1e-4, False) for on in (2e-3, "1e-3")),
    ],
)
def test_a_component_is_judged_on_its_declared_levels_alone(
    component: Component, here: float, other: float, judged: bool
) -> None:
    row = judged_by(component, here, other)
    assert pd.notna(row["effect"]) == judged
    assert judged or row["why"] == f"the runs compare {here} with {other}"


def test_a_cost_judges_nothing_because_the_seeds_of_a_network_share_one_time() -> None:
    pair = with_and_without("none")
    fast = replace(COMPONENTS[NAMES.index("att")], metric="ms_per_frame")
    row = analysis.verdict_table(seeds_of(pair, "ms_per_frame"), pair, [fast]).iloc[0]
    assert (row["verdict"], row["why"]) == ("undecided", "it has no metric that judges it")


def test_a_metric_that_this_command_does_not_know_is_named_as_such() -> None:
    pair = with_and_without("none")
    own = replace(COMPONENTS[NAMES.index("att")], metric="my_bias")
    row = analysis.verdict_table(seeds_of(pair, "my_bias"), pair, [own]).iloc[0]
    assert row["why"] == "its metric is not known to this command: name it in metrics="


def test_what_cannot_be_judged_says_why(design: Design, cells: pd.DataFrame) -> None:
    means = means_of(cells, design, response(cells, {}, {}))
    nothing = verdict_table(means, None)
    assert set(nothing["verdict"]) == {"undecided"}
    assert set(nothing["why"]) == {"no run goes without it"}
    assert list(nothing["component"]) == NAMES
    assert nothing["band"].to_dict() == dict(enumerate(c.band for c in COMPONENTS))
    pair = with_and_without("none")
    assert pair.name == "with and without one component (attenuation)"
    for seeds, why in ((1, "1 runs with it and 1 without it"), (2, "2 runs with it and 2 without it")):
        rows = [(v, s, "", 9.0 + s) for v in pair.cells.index for s in range(seeds)]
        runs = pd.DataFrame(rows, columns=["variant", "seed", "data", "value"]).assign(metric=METRIC["att"])
        row = verdict_table(runs.join(pair.cells, on="variant"), pair).set_index("component").loc["att"]
        assert (row["verdict"], row["effect"]) == ("undecided", pytest.approx(0.0, abs=1e-9))
        assert row["why"].startswith(why)
    third = with_and_without("compensated")
    row = verdict_table(runs.join(third.cells, on="variant"), third).iloc[0]
    assert row["why"] == "the runs compare integral with compensated"
    several_on = replace(COMPONENTS[NAMES.index("att")], on=("integral", "compensated"))
    row = analysis.verdict_table(runs.join(third.cells, on="variant"), third, [several_on]).iloc[0]
    assert row["why"] == "the runs compare integral with compensated", "neither is without the component"
    unscored = verdict_table(means[means["metric"] != METRIC["conv"]], design).set_index("component")
    assert unscored.loc["conv", "why"] == f"no run was scored by {METRIC['conv']}"
    confounded = means.assign(data=means["model.attenuation"].astype(str))
    assert "cannot tell the factors" in verdict_table(confounded, design)["why"].iloc[0]


def test_three_seeds_of_two_variants_are_the_t_test() -> None:
    pair = with_and_without("none")
    values = {"sa2h": [3.0, 3.4, 2.9], "sa2h-att": [9.0, 9.9, 9.2]}
    rows = [(v, s, "", value) for v, scores in values.items() for s, value in enumerate(scores)]
    runs = pd.DataFrame(rows, columns=["variant", "seed", "data", "value"]).assign(metric=METRIC["att"])
    table = verdict_table(runs.join(pair.cells, on="variant"), pair)
    row = table.set_index("component").loc["att"]
    expected = stats.ttest_ind(values["sa2h"], values["sa2h-att"])
    assert row["p_holm"] == pytest.approx(expected.pvalue)
    assert (row["lower"], row["upper"]) == pytest.approx(tuple(expected.confidence_interval()))
    assert row["effect"] == pytest.approx(3.1 - 28.1 / 3)
    assert (row["verdict"], row["better"]) == ("earns", "lower")


@pytest.mark.parametrize("known", [True, False])
def test_the_effect_at_the_full_model_is_given_where_runs_tell_it(known: bool) -> None:
    off = [(), ("att",), ("concat",)] if known else [("att", "concat"), ("att",), ("concat",)]
    runs = {".".join(["sa2h", *names]): without(*names) for names in off}
    design = find_design(runs, tuple(FULL))
    assert design is not None
    rows = [(label, seed, "", 9.0 + seed) for label in runs for seed in range(3)]
    means = pd.DataFrame(rows, columns=["variant", "seed", "data", "value"]).assign(metric=METRIC["att"])
    row = verdict_table(means.join(design.cells, on="variant"), design).set_index("component").loc["att"]
    assert pd.notna(row["effect"])
    assert row[["full_effect", "full_lower", "full_upper"]].notna().tolist() == 3 * [known]


def test_the_ends_of_an_improvement_tell_the_verdict(cells: pd.DataFrame, design: Design) -> None:
    said = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        sizes = {name: float(rng.choice([-1.5, 0.0, 0.4, 1.0, 3.0])) for name in NAMES}
        chance = rng.uniform(0.1, 2) * rng.normal(size=len(cells))
        table = verdict_table(means_of(cells, design, chance - response(cells, sizes, {})), design, bands=False)
        below, above = table["most"] < table["band"], table["least"] > 0
        assert np.select([below, above], ["does_not", "earns"], "undecided").tolist() == table["verdict"].tolist()
        assert (table["least"] <= -table["upper"]).all(), "wider than without the correction, towards 0"
        said += table["verdict"].to_list()
    assert all(said.count(word) > 20 for word in (Verdict.earns, Verdict.does_not, Verdict.undecided))


NOISE = (0.0, 0.4, -0.1)  # of three seeds
NONE = (0.0, 0.0, 0.0)
ROUNDING = (0.0, 3e-16, -2e-16)


@pytest.mark.parametrize(
    ("full", "without_it", "where"),
    [
        (NOISE, NOISE, None),
        (NONE, NONE, "without it and with it"),
        (ROUNDING, NONE, "without it and with it"),
        (NONE, NOISE, "with it"),
        (NOISE, ROUNDING, "without it"),
    ],
)
@pytest.mark.parametrize("effect", [0.0, 5.0])
def test_runs_that_no_seed_changes_decide_nothing(
    full: tuple[float, ...], without_it: tuple[float, ...], where: str | None, effect: float
) -> None:
    """Neither in verdicts, nor in effects, nor in claims: equal runs are one run, however often it is repeated."""
    pair = with_and_without("none")
    values = [("sa2h", seed, 2 + chance) for seed, chance in enumerate(full)]
    values += [("sa2h-att", seed, 2 + effect + chance) for seed, chance in enumerate(without_it)]
    runs = pd.DataFrame(values, columns=["variant", "seed", "value"]).assign(metric=METRIC["att"], data="")
    means = runs.join(pair.cells, on="variant")
    row = verdict_table(means, pair).set_index("component").loc["att"]
    (of_effect,) = analysis.effects_table(means, pair).to_dict("records")
    (claim,) = analysis.seed_claims(runs.assign(frame=0, site=0)).to_dict("records")
    if where is None:
        assert np.isfinite([row["p_holm"], of_effect["p"], claim["p"]]).all()
        return
    assert (row["verdict"], row["why"]) == ("undecided", f"no spread: no seed changes anything in the runs {where}")
    assert pd.isna([row["p_holm"], row["lower"], row["least"], of_effect["p"], of_effect["lower"], claim["p"]]).all()
    assert claim["verdict"] == "not claimable"
    assert row["effect"] == pytest.approx(-effect + np.mean(full) - np.mean(without_it)), "it is still told"


def test_a_factorial_decides_where_some_cell_has_spread_or_no_cell_is_repeated(
    cells: pd.DataFrame, design: Design
) -> None:
    chance = np.random.default_rng(0).normal(size=len(cells))
    chance[[0, 32, 33]] = 1.0  # the only cell with several runs
    repeated = verdict_table(means_of(cells, design, chance), design)
    assert set(repeated["why"]) == {"no spread: no seed changes anything in the runs with it"}
    chance[33] = 1.2
    assert verdict_table(means_of(cells, design, chance), design)["p_holm"].notna().all()
    once = cells["seed"] < 32
    assert verdict_table(means_of(cells[once], design, chance[once]), design)["p_holm"].notna().all()
    constant = verdict_table(means_of(cells[once], design, np.full(32, 7.0)), design)
    assert set(constant["verdict"]) == {"undecided"}


def test_dots_are_the_runs_without_what_other_components_and_anatomies_add(cells: pd.DataFrame, design: Design) -> None:
    sizes = {"att": -3.0, "concat": 2.0, "depth": -5.0}
    dots = analysis.improvements(means_of(cells, design, response(cells, sizes, {})), design, COMPONENTS)
    assert len(dots) == 6 * len(cells)
    for name in NAMES:
        chosen = dots[dots["component"] == name]
        expected = np.where(chosen["on"], -sizes.get(name, 0.0), 0.0)
        assert chosen["improvement"].to_numpy() == pytest.approx(expected, abs=1e-9)
        assert chosen["on"].sum() == 18


def test_where_one_component_at_a_time_is_off_the_dots_are_the_runs_that_its_effect_compares() -> None:
    runs = {"sa2h": FULL, "sa2h.att": without("att"), "sa2h.depth": without("depth")}
    design = find_design(runs, tuple(FULL))
    assert design is not None
    values = {"sa2h": [1.0, 2.0], "sa2h.att": [7.0, 8.0], "sa2h.depth": [40.0, 50.0]}
    rows = [(label, k, "0", v) for label, of in values.items() for k, v in enumerate(of)]
    means = pd.DataFrame(rows, columns=["variant", "seed", "data", "value"]).assign(metric=METRIC["att"])
    dots = analysis.improvements(means.join(design.cells, on="variant"), design, COMPONENTS).set_index("variant")
    assert dots["component"].unique().tolist() == ["att"]
    assert dots.loc["sa2h", "improvement"].tolist() == pytest.approx([6.5, 5.5]), "7.5 is the mean without it"
    assert dots.loc["sa2h.att", "improvement"].tolist() == pytest.approx([0.5, -0.5])
    assert "sa2h.depth" not in dots.index


def test_a_component_has_the_time_that_the_timed_runs_tell(cells: pd.DataFrame, design: Design) -> None:
    means = means_of(cells, design, response(cells, {"att": -9.0}, {}))
    ms = 20.0 + response(cells, {"att": 4.0, "noise": 7.0}, {})
    times = means[means["metric"] == METRIC["att"]].assign(metric="ms_per_frame", value=ms)
    timed = times[times["variant"].isin(cells.loc[cells["noise"] == 1, "variant"])]
    tables = (verdict_table(pd.concat([means, rows]), design) for rows in (times, timed))
    both = [table.set_index("component")["ms_per_frame"] for table in tables]
    assert both[0].loc[["att", "noise"]].tolist() == pytest.approx([4.0, 7.0])
    assert both[1]["att"] == pytest.approx(4.0)
    assert np.isnan(both[1]["noise"]), "a time that was measured on one side only is no difference of 0"


def test_an_interaction_of_two_runs_a_side_has_no_q_as_it_has_no_p() -> None:
    labels = {"sa2h": (), "sa2h.att": ("att",), "sa2h.noise": ("noise",), "sa2h.att.noise": ("att", "noise")}
    whole = find_design({label: without(*off) for label, off in labels.items()}, tuple(FULL))
    assert whole is not None
    runs = pd.DataFrame({"variant": ["sa2h"] * 6 + [*labels][1:], "data": ""}).assign(seed=range(9))
    means = means_of(runs, whole, np.random.default_rng(0).normal(size=9))
    p = analysis.effects_table(means, whole).set_index("effect")["p"]
    assert p[":".join(whole.factors)].isna().all(), "one product of their signs is that of two runs"
    assert analysis.interactions(means, whole, COMPONENTS)["q"].tolist() == pytest.approx([np.nan] * 2, nan_ok=True)
