"""What is amiss with a study is said in words, with the names of what it concerns."""

import numpy as np
import pandas as pd
import pytest

from ablate.analysis import RESIMULATION, cautions, listed


def only(texts, part):
    matching = [text for text in texts if part in text]
    assert len(matching) == 1, texts
    return matching[0]


def test_a_whole_study_is_only_warned_of_its_few_sites(study):
    assert len(cautions(study)) == 1
    assert only(cautions(study), "8 probe sites").endswith("are rough.")


@pytest.mark.parametrize(
    ("variants", "part"),
    [
        (("sa2h",), "one variant, sa2h: nothing is compared"),
        (("nsa2h", "sa2h-att"), "reference sa2h is missing"),
        ((RESIMULATION,), "no network"),
        (("sa2h", "nsa2h"), "re-simulation is missing"),
    ],
)
def test_what_is_missing_is_said(variants, part, study_of):
    assert only(cautions(study_of(variants=variants)), part)


def test_networks_of_which_none_renders_are_named(study):
    smooth = study[study["metric"] == "psnr"].assign(metric="mae_smooth")
    for floor, told in ((10.0, ["1.80 times"]), (11.0, []), (0.0, [])):
        values = smooth["variant"].map({RESIMULATION: floor, "sa2h": 18.0}).fillna(90.0)
        texts = cautions(pd.concat([study, smooth.assign(value=values)]))
        assert [text.split("network is ")[1][:10] for text in texts if "Smooth MAE" in text] == told


def test_few_seeds_and_few_sites_are_named(study_of):
    both = study_of()
    one = both[(both["variant"] != "nsa2h") | (both["seed"] == 0)]
    assert "nsa2h (1):" in only(cautions(one), "not claimable")
    assert "can show nothing" in only(cautions(study_of(sites=5)), "5 probe sites")
    assert only(cautions(study_of(sites=1)), "1 probe site:")


def test_half_scored_runs_are_named(study):
    part = study[~((study["variant"] == "nsa2h") & (study["seed"] == 2) & (study["frame"] > 9))].copy()
    assert "nsa2h/seed2 (10 of 24)" in only(cautions(part), "all test frames")


def test_infinite_and_nan_values_are_named_with_their_frames(study):
    broken = study.copy()
    rows = (broken["variant"] == "sa2h-att") & (broken["seed"] == 1) & (broken["metric"] == "psnr")
    broken.loc[rows & (broken["frame"] == 7), "value"] = np.inf
    broken.loc[rows & (broken["frame"] == 9), "value"] = np.nan
    texts = cautions(broken)
    assert "1 infinite value left out (identical images: sa2h-att/seed1 frame 7)" in only(texts, "infinite")
    assert "PSNR: 1 NaN left out (sa2h-att/seed1 frame 9)" in only(texts, "NaN")
    own = only(cautions(broken.replace({"metric": {"psnr": "of_mine"}})), "infinite")
    assert "of_mine: 1 infinite value left out (sa2h-att/seed1 frame 7)" in own, "nothing is identical"
    broken.loc[rows, "value"] = np.nan
    assert "24 NaNs" in only(cautions(broken), "NaN")


def test_an_empty_study_is_said_to_be_empty_and_long_lists_are_cut():
    empty = pd.DataFrame(columns=["variant", "seed", "frame", "site", "metric", "value"])
    assert only(cautions(empty), "no network")
    assert listed([str(k) for k in range(9)]) == "0, 1, 2, 3, 4, 5 and 3 more"
