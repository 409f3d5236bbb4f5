"""Tables hold what pandas computes, are complete, and say which network is best."""

import io

import numpy as np
import pandas as pd
import pytest

from ablate.analysis import (
    RESIMULATION,
    comparison_table,
    holm,
    paired_difference,
    paired_table,
    seed_claims,
    to_html,
    to_latex,
    to_text,
    wide_table,
)
from ablate.analysis.tables import PAIRED_COLUMNS


@pytest.fixture(scope="module")
def scalars():
    rows = [
        ("sa2h", 0, "parameters", 14450964.0),
        ("nsa2h", 0, "parameters", 57170242.0),
        ("sa2h", 0, "fd_speckle", 0.5),
        ("nsa2h", 0, "fd_speckle", 0.4),
        (RESIMULATION, 0, "fd_speckle", 0.01),
    ]
    return pd.DataFrame(rows, columns=["variant", "seed", "metric", "value"])


def test_cells_are_means_and_deviations_and_order_is_fixed(study, scalars):
    table = comparison_table(study, scalars)
    assert list(dict.fromkeys(table["variant"])) == [RESIMULATION, "sa2h", "nsa2h", "sa2h-att"]
    assert list(dict.fromkeys(table["metric"])) == ["psnr", "pchi2", "fd_speckle", "parameters"]
    cell = table[(table["variant"] == "sa2h") & (table["metric"] == "psnr")].iloc[0]
    values = study[(study["variant"] == "sa2h") & (study["metric"] == "psnr")]
    assert cell["mean"] == pytest.approx(values["value"].mean())
    assert cell["sd"] == pytest.approx(values["value"].std())
    assert cell["seed_sd"] == pytest.approx(values.groupby("seed")["value"].mean().std())
    assert (cell["seeds"], cell["n"], cell["dropped"]) == (3, 72, 0)


def test_best_is_a_network_and_never_the_resimulation(study, scalars):
    best = comparison_table(study, scalars).query("best")[["metric", "variant"]]
    assert set(map(tuple, best.to_numpy())) == {("psnr", "sa2h"), ("pchi2", "sa2h"), ("fd_speckle", "nsa2h")}


def test_infinite_values_are_counted(study):
    marked = study.copy()
    marked.loc[marked.index[(marked["variant"] == "sa2h") & (marked["metric"] == "psnr")][:2], "value"] = np.inf
    cell = comparison_table(marked).query("variant == 'sa2h' and metric == 'psnr'").iloc[0]
    assert (cell["n"], cell["dropped"]) == (70, 2)
    assert np.isfinite(cell["mean"])


def test_formats_hold_every_variant_and_round_trip(study, scalars):
    table = comparison_table(study, scalars)
    text, latex, html = to_text(table), to_latex(table), to_html(table)
    for printed in (text, latex, html):
        assert all(name in printed for name in ("sa2h-att", "nsa2h", RESIMULATION, "57.2M", "14.5M"))
    assert "floor" in text
    assert "…" not in text
    assert r"\textbf{" in latex
    assert latex.count(r"\toprule") == latex.count(r"\bottomrule") == 1
    columns = latex[latex.index("{l") : latex.index("}\n\\toprule")].count("r")
    for line in latex.splitlines():
        if line.endswith(r"\\"):
            assert line.count("&") == columns
    wide = wide_table(table)
    back = pd.read_csv(io.StringIO(wide.to_csv(index=False)))
    pd.testing.assert_frame_equal(back, wide, check_dtype=False)
    assert list(wide["variant"]) == [RESIMULATION, "sa2h", "nsa2h", "sa2h-att"]


def test_paired_table_is_the_paired_difference_with_holm_over_networks(study):
    table = paired_table(study, resamples=200)
    assert tuple(table.columns) == PAIRED_COLUMNS
    assert set(table["variant"]) == {RESIMULATION, "sa2h-att", "nsa2h"}
    means = study.groupby(["metric", "variant", "frame"])["value"].mean()
    raw = []
    for row in table.to_dict("records"):
        a, b = means[row["metric"], row["variant"]], means[row["metric"], "sa2h"]
        found = paired_difference(a, b, [f"site{k % 8}" for k in a.index], resamples=200)
        assert (row["shift"], row["low"], row["high"]) == (found.shift, found.low, found.high)
        raw.append(found.p)
    networks = (table["variant"] != RESIMULATION).to_numpy()
    np.testing.assert_allclose(table["p_holm"][networks], holm(np.array(raw)[networks]))
    assert table.query("variant == 'nsa2h' and metric == 'psnr'")["shift"].iloc[0] == pytest.approx(-2, abs=0.1)


def test_frames_without_partner_are_left_out(study):
    part = study[~((study["variant"] == "nsa2h") & (study["frame"] < 4))]
    table = paired_table(part, resamples=10)
    assert table.query("variant == 'nsa2h'")["n"].unique().tolist() == [20]


def test_missing_reference_or_single_variant_give_empty_tables(study_of):
    assert paired_table(study_of(variants=("nsa2h", "sa2h-att"))).empty
    assert paired_table(study_of(variants=("sa2h",))).empty
    alone = comparison_table(study_of(variants=("sa2h",)))
    assert not alone["best"].any(), "one network alone is not the best of anything"
    assert "sa2h" in to_text(alone)


def test_seed_claims(study, study_of):
    claims = seed_claims(study).set_index(["variant", "metric"])
    assert claims.loc[("nsa2h", "psnr"), "verdict"] == "differs"
    assert set(seed_claims(study_of(seeds=(0,)))["verdict"]) == {"not claimable"}


def test_bad_frames_are_refused(study):
    with pytest.raises(ValueError, match="lacks the columns \\['site'\\]"):
        comparison_table(study.drop(columns="site"))
    broken = study.copy()
    broken.loc[0, "value"] = np.nan
    with pytest.raises(ValueError, match="NaN: metric psnr"):
        paired_table(broken)
