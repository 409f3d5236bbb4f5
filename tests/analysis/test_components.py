"""Any key of a configuration can be a component: declared before the runs, or swept by somebody without a word."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from ablate import analysis
from ablate.analysis import Component
from ablate.analysis.components import level_with
from ablate.analysis.statistics.component_models import UNDECLARED
from support.components import COMPONENTS, FULL, without


def scored_runs(runs: dict[str, dict[str, object]], value: Callable[[dict[str, object]], float]) -> pd.DataFrame:
    """Three seeds of every label, two frames each, scored by `mae_smooth`."""
    rng = np.random.default_rng(0)
    rows = [
        (label, seed, frame, frame, "mae_smooth", value(made) + 0.1 * rng.normal())
        for label, made in runs.items()
        for seed in range(3)
        for frame in range(2)
    ]
    return pd.DataFrame(rows, columns=["variant", "seed", "frame", "site", "metric", "value"])


def test_a_seventh_component_of_any_key_has_effects_interactions_and_a_verdict() -> None:
    loss = Component("loss", "training.reconstruction", "l1", "l2", metric="mae_smooth", band=0.5)
    base = FULL | {"training.reconstruction": "l1"}
    runs = {
        "sa2h": base,
        "sa2h-att": base | {"model.attenuation": "none"},
        "sa2h.reconstruction-l2": base | {"training.reconstruction": "l2"},
        "sa2h-att.reconstruction-l2": base | {"model.attenuation": "none", "training.reconstruction": "l2"},
    }
    per_image = scored_runs(runs, lambda made: 9.0 + 3.0 * (made["training.reconstruction"] == "l2"))
    components = (*COMPONENTS, loss)
    design = analysis.find_design(runs, [component.key for component in components])
    assert design is not None
    assert design.name == "full factorial of 2 components (4 cells)"
    means = analysis.run_means(per_image, None, design)
    effects = analysis.effects_table(means, design).set_index("effect")["estimate"]
    assert effects["training.reconstruction"] == pytest.approx(3.0, abs=0.2)
    row = analysis.verdict_table(means, design, components).set_index("component").loc["loss"]
    assert (row["verdict"], row["band"], row["runs_a"]) == ("earns", 0.5, 6)
    assert row["effect"] == pytest.approx(-3.0, abs=0.2)
    assert set(analysis.interactions(means, design, components)["other"]) == {"att"}, "att itself has no score here"


@pytest.mark.parametrize(
    ("key", "here", "other"),
    [("training.learning_rate", 4e-4, 1e-4), ("training.augment", False, True), ("training.clip", None, [1, 2])],
)
def test_a_component_that_nobody_declared_has_effects_and_no_verdict(key: str, here: object, other: object) -> None:
    runs = {
        "sa2h": FULL | {key: here},
        "sa2h.changed": FULL | {key: other},
        "sa2h-depth": without("depth") | {key: here},
    }
    per_image = scored_runs(runs, lambda made: 9.0 + 3.0 * (made[key] == other))
    design = analysis.find_design(runs, [*FULL, key])
    assert design is not None
    means = analysis.run_means(per_image, None, design)
    assert analysis.effects_table(means, design).set_index("effect").loc[key, "estimate"] == pytest.approx(3.0, abs=0.2)
    for components in (COMPONENTS, (*COMPONENTS, Component("mine", key))):
        row = analysis.verdict_table(means, design, components).iloc[-1]
        assert row["component"] == (components[6].name if len(components) > 6 else key.rpartition(".")[2])
        assert (row["verdict"], row["why"], pd.isna(row["metric"])) == ("undecided", UNDECLARED, True)
        assert set(analysis.improvements(means, design, components)["component"]) == {"depth"}
        assert analysis.interactions(means, design, components).empty
    declared = replace(Component("rate", key), metric="mae_smooth", band=0.5)
    row = analysis.verdict_table(means, design, [declared]).set_index("component").loc["rate"]
    assert row["effect"] == pytest.approx(-3.0, abs=0.2), "the level of the reference is the one with it"


def test_the_smaller_depth_is_the_full_model_s_at_every_size_of_a_frame() -> None:
    depth = COMPONENTS[4]
    assert level_with(depth, [6, 2]) == level_with(depth, [2, 6]) == 2
    assert level_with(replace(depth, on=8, off=4), [6, 2]) == 6
    assert level_with(COMPONENTS[0], ["none", "integral"]) == "integral"
    assert level_with(Component("l1", "training.l1_weight", 100.0, 0.0), [300.0, 100.0]) == 100.0, "as declared"


def test_components_that_cannot_be_are_refused() -> None:
    with pytest.raises(ValueError, match=r"component att: band=0\.0: allowed are finite numbers above 0"):
        replace(COMPONENTS[0], band=0.0)
    with pytest.raises(ValueError, match="component att: key is empty"):
        replace(COMPONENTS[0], key="")
    with pytest.raises(ValueError, match="component='a/b'"):
        Component("a/b", "model.depth")
