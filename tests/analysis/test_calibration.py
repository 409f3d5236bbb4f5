"""The statistics keep their word on simulated studies: with no true effect, no more false claims than were allowed."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

SCRIPT = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "calibration.py"))
REPETITIONS = 1000
# As many false claims as 1,000 repetitions at 5 % exceed once in a thousand times.
ALLOWED = stats.binom.ppf(0.999, REPETITIONS, 0.05) / REPETITIONS


@pytest.mark.slow
def test_false_claims_stay_below_five_per_cent_at_the_seed_level():
    assert ALLOWED < 0.075
    shares = SCRIPT["seed_level"](SCRIPT["MEASURED"], seeds=3, effect=0.0, repetitions=REPETITIONS)
    assert shares["alone"] <= ALLOWED, "a row judged alone"
    assert shares["any_differs"] <= ALLOWED, "any `differs` in a whole study"
    assert shares["any_alone"] > 0.3, "why rows are not judged alone"


@pytest.mark.slow
def test_sites_keep_their_level_where_frames_do_not():
    shares = SCRIPT["frame_level"](replace(SCRIPT["MEASURED"], run=0.0), effect=0.0, repetitions=REPETITIONS)
    assert shares["means"] <= ALLOWED
    assert shares["covered"] >= 1 - ALLOWED
    assert shares["frames"] > ALLOWED, "Wilcoxon over frames takes a site's frames for independent"


@pytest.mark.slow
def test_factorial_effects_keep_their_level_and_find_what_is_there():
    sizes = SCRIPT["MEASURED"]
    assert SCRIPT["factorial_level"](sizes, 2, 0.0, REPETITIONS) <= ALLOWED
    assert SCRIPT["factorial_level"](sizes, 3, SCRIPT["spread_of_run_means"](sizes), 200) > 0.8


def test_random_effects_are_estimated_from_a_study():
    sizes = SCRIPT["Sizes"](run=0.3, run_site=0.2, run_frame=0.4, sites=30, frames=6)
    rng = np.random.default_rng(0)
    frames = np.arange(180)
    tables = []
    for variant in ("sa2h", "nsa2h"):
        runs = SCRIPT["draw_runs"](sizes, 12, rng).reshape(12, -1)
        for seed, values in enumerate(runs):
            table = pd.DataFrame({"value": 20 + values, "frame": frames, "site": frames // 6})
            tables.append(table.assign(variant=variant, seed=seed))
    estimated = SCRIPT["sizes_of"](pd.concat(tables))
    assert estimated.run == pytest.approx(0.3, rel=0.3)
    assert estimated.run_site == pytest.approx(0.2, rel=0.1)
    assert estimated.run_frame == pytest.approx(0.4, rel=0.05)
    assert (estimated.sites, estimated.frames) == (30, 6)
    with pytest.raises(ValueError, match="no variant has two seeds"):
        SCRIPT["sizes_of"](tables[0])


@pytest.mark.slow
def test_verdicts_find_an_effect_of_three_standard_deviations_and_invent_none():
    answer = runpy.run_path(str(Path(__file__).parents[2] / "scripts" / "calibration_verdicts.py"))
    study, repetitions = (*answer["runs_of"]("full_model"), "att"), 100
    assert answer["shares"](*study, {"att": 3.0}, 0.5, repetitions)["earns"] > 0.9
    allowed = stats.binom.ppf(0.999, repetitions, 0.05) / repetitions
    assert answer["shares"](*study, {}, 0.5, repetitions)["any_earns"] <= allowed
    at_band = dict.fromkeys(answer["NAMES"], 1.0)
    assert answer["shares"](*study, at_band, 1.0, repetitions)["any_does_not"] <= allowed
