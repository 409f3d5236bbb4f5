"""Designs are recognised, say what they cannot tell apart, and give the effects that were put in."""

import itertools
import re

import numpy as np
import pandas as pd
import pytest

from ablate.analysis import effects_table, factorial_effects, find_design, run_means
from ablate.analysis.scored import RESIMULATION, finite_values
from ablate.analysis.statistics.effects import defining_relation
from support.components import without

KEYS = {"attenuation": "att", "concat": "concat", "upsampling": "conv", "noise": "noise", "depth": "depth"}
NAMES = tuple(KEYS)
FACTORS = tuple(f"model.{name}" for name in NAMES)
OFF = {name: without(component)[f"model.{name}"] for name, component in KEYS.items()}


def label_of(off):
    return ".".join(["sa2h", *(f"{name}-{OFF[name]}" for name in off)])


def study_of(subsets, **more):
    """What runs were made from by label, each subset of the factors turned off."""
    return {label_of(off): {"model.family": "local", **without(*(KEYS[n] for n in off)), **more} for off in subsets}


ALL = [off for size in range(6) for off in itertools.combinations(NAMES, size)]
HALF = [off for off in ALL if len(off) % 2 == 0]
LEAVE_ONE_OUT = [off for off in ALL if len(off) < 2]
ADD_ONE_IN = [(), *(off for off in ALL if len(off) > 3)]


def off_of(made):
    return {name: made[f"model.{name}"] == OFF[name] for name in NAMES}


def runs_of(runs, response, seeds=3, noise=0.0):
    rng = np.random.default_rng(0)
    rows = [
        (label, seed, frame, frame // 2, "psnr", response(off_of(made)) + shock)
        for label, made in runs.items()
        for seed in range(seeds)
        for shock in [noise * rng.normal()]
        for frame in range(4)
    ]
    return pd.DataFrame(rows, columns=["variant", "seed", "frame", "site", "metric", "value"])


def effects_of(runs, design):
    """The table of effects, with the last parts of the keys that its effects and aliases are named by."""
    table = effects_table(run_means(runs, None, design), design)
    return table.assign(**{name: table[name].str.replace("model.", "") for name in ("effect", "aliases")})


def respond(off):
    """Main effects and one interaction."""
    return 20 - 2 * off["attenuation"] - off["concat"] + 0.5 * off["noise"] - off["attenuation"] * off["depth"]


@pytest.mark.parametrize(
    ("subsets", "name", "effects"),
    [
        (ALL, "full factorial of 5 components (32 cells)", 15),
        (HALF, "half of the factorial of 5 components (16 of 32 cells)", 15),
        (LEAVE_ONE_OUT, "one change at a time around sa2h (6 cells)", 5),
        (ADD_ONE_IN, f"one change at a time around {label_of(NAMES)} (6 cells)", 5),
        ([*LEAVE_ONE_OUT, ("attenuation", "depth")], "7 of the 32 cells of 5 components", 6),
    ],
    ids=["full", "half", "leave one out", "add one in", "mixed"],
)
def test_every_design_is_named_and_gives_the_effects_it_can(subsets, name, effects):
    components = study_of(subsets)
    design = find_design(components, FACTORS)
    assert design.name == name
    table = effects_of(runs_of(components, respond), design)
    assert len(table) == effects
    estimates = table.set_index("effect")["estimate"]
    # Averaged over the other levels an interaction of -1 adds half of itself to each of its components.
    shared = 0.0 if "around sa2h (" in name else -1.0 if "around" in name else -0.5
    expected = {"attenuation": -2 + shared, "concat": -1, "noise": 0.5, "upsampling": 0}
    expected |= {"attenuation:depth": -0.5} if "attenuation:depth" in estimates else {}
    assert estimates[list(expected)].to_dict() == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("beside", [[NAMES], ADD_ONE_IN[1:]], ids=["nothing on", "add one in"])
def test_an_interaction_of_cells_far_from_the_full_model_is_no_effect_of_other_components(beside):
    components = study_of([*LEAVE_ONE_OUT, *beside])
    design = find_design(components, FACTORS)
    assert design.name == "one change at a time around sa2h (6 cells)"
    assert f"Left out of it: {label_of(beside[0])}" in design.reading
    runs = runs_of(components, lambda off: 20.0 * (off["attenuation"] or off["noise"]))
    estimates = effects_of(runs, design).set_index("effect")["estimate"].to_dict()
    expected = {"attenuation": 20, "noise": 20, "concat": 0, "upsampling": 0, "depth": 0}
    assert estimates == pytest.approx(expected, abs=1e-9)


def test_a_component_that_only_cells_far_from_the_full_model_lack_is_not_judged():
    unfinished = study_of([*LEAVE_ONE_OUT[:-1], NAMES])
    assert find_design(unfinished, FACTORS).factors == list(FACTORS[:-1])
    with_a_pair = find_design(study_of([*LEAVE_ONE_OUT[:-1], ("attenuation", "concat"), NAMES]), FACTORS)
    assert with_a_pair.name == "6 of the 16 cells of 4 components", "of those that vary in it"
    beside = find_design(study_of([*LEAVE_ONE_OUT[:-1], *ADD_ONE_IN[1:]]), FACTORS)
    assert beside.name == "one change at a time around sa2h (5 cells)", "the full model stays the centre"


@pytest.mark.parametrize("backwards", [False, True])
def test_a_design_does_not_depend_on_the_order_of_its_runs(backwards):
    components = study_of([*ADD_ONE_IN, ("attenuation", "concat", "depth")])
    order = sorted(components, reverse=backwards)
    design = find_design({label: components[label] for label in order}, FACTORS)
    assert design.name == "7 of the 32 cells of 5 components"
    assert "Left out of it: sa2h." in design.reading


def test_without_the_reference_the_cell_in_the_middle_stands_in_for_it():
    bare = study_of(ADD_ONE_IN[1:])
    design = find_design(bare, FACTORS)
    assert design.name == f"one change at a time around {label_of(NAMES)} (6 cells)"
    estimates = effects_of(runs_of(bare, respond), design).set_index("effect")["estimate"]
    assert estimates["concat"] == pytest.approx(1), "the change is now to put it back"


def test_the_half_fraction_says_what_it_cannot_tell_apart():
    components = study_of(HALF)
    design = find_design(components, FACTORS)
    words = defining_relation(design.cells.rename(columns=dict(zip(FACTORS, NAMES, strict=True))), NAMES)
    assert words == ["-attenuation:concat:upsampling:noise:depth"], "an even number changed: their product is -1"
    assert words[0] in design.reading
    table = effects_of(runs_of(components, respond), design).set_index("effect")
    assert table.loc["attenuation", "aliases"] == "-concat:upsampling:noise:depth"
    assert table.loc["noise:depth", "aliases"] == "-attenuation:concat:upsampling"

    def four_way(off):
        return 1.5 * np.prod([1 if off[name] else -1 for name in NAMES[1:]])

    fooled = effects_of(runs_of(components, four_way), design).set_index("effect")["estimate"]
    assert fooled["attenuation"] == pytest.approx(-3.0), "the four-way interaction comes back under its alias"
    full = study_of(ALL)
    told = effects_of(runs_of(full, four_way), find_design(full, FACTORS)).set_index("effect")
    assert told["estimate"].abs().max() == pytest.approx(0, abs=1e-9)
    assert (told["aliases"] != "").sum() == 0


def test_one_change_at_a_time_says_that_interactions_are_out_of_reach():
    components = study_of(LEAVE_ONE_OUT)
    design = find_design(components, FACTORS)
    assert "cannot be told" in design.reading
    table = effects_of(runs_of(components, respond, noise=0.1), design)
    assert set(table["aliases"]) == {"its interactions"}


def test_a_quarter_fraction_keeps_only_what_is_not_confounded():
    """Resolution III: no interaction of two is free of a main effect, so none is estimated."""
    words = ("noise", "attenuation", "concat"), ("depth", "attenuation", "upsampling")
    quarter = [off for off in ALL if all(sum(name in off for name in word) % 2 == 0 for word in words)]
    assert len(quarter) == 8
    design = find_design(study_of([(), *quarter[1:]]), FACTORS)
    assert len(defining_relation(design.cells, design.factors)) == 3
    table = effects_of(runs_of(study_of(quarter), respond), design).set_index("effect")
    assert {"attenuation", "concat", "upsampling", "noise", "depth"} <= set(table.index)
    assert "concat:noise" in table.loc["attenuation", "aliases"]


def test_cells_beside_a_half_are_left_out_because_they_would_confound_it():
    half = find_design(study_of(HALF), FACTORS)
    beside = find_design(study_of([*HALF, ("attenuation",), ("depth",)]), FACTORS)
    pd.testing.assert_frame_equal(beside.cells, half.cells)
    assert beside.name == half.name
    assert beside.reading == f"{half.reading} Left out of it: {label_of(('attenuation',))}, {label_of(('depth',))}."
    assert not {label_of(("attenuation",)), label_of(("depth",))} & set(beside.cells.index)
    third = study_of(HALF)
    third["sa2h.attenuation-compensated"] = {**third["sa2h"], "model.attenuation": "compensated"}
    assert "sa2h.attenuation-compensated" not in find_design(third, FACTORS).cells.index


def test_a_value_that_is_the_same_in_all_runs_has_no_effect():
    components = study_of(HALF)
    table = effects_of(runs_of(components, lambda *_: 1 / 3), find_design(components, FACTORS))
    assert (table["estimate"] == 0).all()
    assert set(table["p"].dropna()) <= {1.0}, "a rounding error is no effect"


def test_blocks_are_taken_out_of_effects_and_cost_one_degree_of_freedom_each():
    components = study_of(HALF)
    design = find_design(components, FACTORS)
    runs = runs_of(components, respond, seeds=2, noise=0.1)
    block = (runs["variant"].str.contains("attenuation").to_numpy() + runs["seed"].to_numpy()) % 2  # each cell in both
    plain = effects_of(runs, design).set_index("effect")
    moved = runs.assign(data=np.array(["a", "b"])[block], value=runs["value"] + 50 * block)
    blocked = effects_of(moved, design).set_index("effect")
    pd.testing.assert_series_equal(blocked["estimate"], plain["estimate"])
    assert (blocked["dof"] == plain["dof"] - 1).all()
    assert effects_of(runs.assign(data=runs["variant"].str.contains("depth")), design).empty, "depth is the block"
    off = {name: runs["variant"].str.contains(name) for name in ("attenuation", "noise")}
    hidden = effects_of(runs.assign(data=off["attenuation"] ^ off["noise"]), design)
    assert len(hidden) == 14
    assert "attenuation:noise" not in set(hidden["effect"]), "it is the block"


def test_what_differs_otherwise_is_left_out():
    components = study_of(LEAVE_ONE_OUT)
    components["nsa2h"] = {**components["sa2h"], "model.family": "unet"}
    components["sa2h.noise-none"] = {**components["sa2h"], "model.noise": "none"}
    components["sa2h-again"] = {**components["sa2h"], "model.noise": "input"}
    design = find_design(components, FACTORS)
    assert set(components) - set(design.cells.index) == {"nsa2h", "sa2h.noise-none"}
    assert find_design({}, FACTORS) is None
    assert find_design({k: components[k] for k in ("sa2h", "nsa2h")}, FACTORS) is None
    pairs = {"sa2h": (1, 1), "b": (2, 2), "c": (2, 4), "d": (3, 3), "e": (4, 3)}
    runs = {name: dict(zip("AB", levels, strict=True)) for name, levels in pairs.items()}
    assert find_design(runs, "AB") is None, "no label has two levels of one factor and the reference's of the other"


def test_intervals_need_three_trainings_a_side():
    components = study_of(LEAVE_ONE_OUT)
    design = find_design(components, FACTORS)
    for seeds, given in ((1, False), (2, False), (3, True)):
        table = effects_of(runs_of(components, respond, seeds=seeds, noise=0.1), design)
        assert table["p"].notna().all() == given
    full = study_of(ALL)
    once = effects_of(runs_of(full, respond, seeds=1, noise=0.1), find_design(full, FACTORS))
    assert once["p"].notna().all(), "sixteen trainings a side"
    assert (once["dof"] == 16).all()


def test_saturated_designs_have_no_interval_and_bad_ones_are_refused():
    runs = pd.DataFrame({"a": [0, 0, 1, 1], "b": [0, 1, 0, 1], "value": [1.0, 2.0, 3.0, 5.0]})
    table = factorial_effects(runs, ["a", "b"])
    assert table["lower"].isna().all()
    assert (table["dof"] == 0).all()
    with pytest.raises(ValueError, match="needs 2 levels"):
        factorial_effects(runs.assign(b=0), ["a", "b"])
    with pytest.raises(ValueError, match="tell"):
        factorial_effects(runs.iloc[[0, 3]], ["a", "b"])


def test_a_word_that_lacks_a_component_says_nothing_of_its_effect():
    words = [off for off in ALL if sum(name in off for name in NAMES[:3]) % 2 == 0]
    design = find_design(study_of(words), FACTORS)
    assert "I = -attenuation:concat:upsampling," in design.reading
    assert "interaction of 2 components" not in design.reading
    assert "aliases of effects.csv" in design.reading
    assert "interaction of 4 components" in find_design(study_of(HALF), FACTORS).reading


def test_cells_of_two_anatomies_are_counted_once():
    labels = study_of(LEAVE_ONE_OUT)
    twice = labels | {f"{label}.anatomy_seed-1": made for label, made in labels.items()}
    assert find_design(twice, FACTORS).name == "one change at a time around sa2h (6 cells)"


def test_the_level_of_the_resimulation_is_over_the_frames_of_the_networks() -> None:
    """Every network equals the re-simulation on every frame, and one has no value on the hard half of them."""
    rows = [
        (v, s, f, f, "mae_smooth", np.nan if (v, s) == ("sa2h-att", 2) and f > 11 else 10.0 + 30.0 * (f > 11))
        for v, seeds in ((RESIMULATION, (0,)), ("sa2h", (0, 1, 2)), ("sa2h-att", (0, 1, 2)))
        for s in seeds
        for f in range(24)
    ]
    values = finite_values(pd.DataFrame(rows, columns=["variant", "seed", "frame", "site", "metric", "value"]))
    assert values.groupby("variant")["value"].mean().to_dict() == dict.fromkeys(
        (RESIMULATION, "sa2h", "sa2h-att"), 10.0
    )


@pytest.mark.parametrize(
    ("cells", "reading"),
    [
        ([(1, 1), (0, 0)], "The effects of the two components cannot be told apart."),
        ([(1, 1, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1)], "A main effect cannot be separated from the interaction of the"),
        ([c for c in itertools.product((0, 1), repeat=4) if sum(c) % 2 == 0], "from an interaction of 3 components."),
    ],
    ids=["two", "three", "four"],
)
def test_a_half_says_what_is_aliased_in_it_however_few_components_it_has(cells, reading) -> None:
    runs = {str(cell): dict(zip("abcd", cell, strict=False)) for cell in cells}
    design = find_design(runs, list("abcd")[: len(cells[0])], str(cells[0]))
    assert design.name.startswith(f"half of the factorial of {len(cells[0])} components")
    assert reading in design.reading
    assert not re.search(r"interaction of 1 |one of [01] ", design.reading)
