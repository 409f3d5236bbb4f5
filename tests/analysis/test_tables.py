"""Tables hold what pandas computes, are complete, say which network is best, and are LaTeX that compiles."""

import io
import re
import shutil
import subprocess

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from ablate import analysis
from ablate.analysis import RESIMULATION
from ablate.analysis.statistics.paired import PAIRED_COLUMNS
from ablate.analysis.tables import cell_texts, latex_text
from ablate.metrics import Direction, Metric


@pytest.fixture(scope="module")
def scalars():
    rows = [("sa2h", 0, "parameters", 14450964.0), ("nsa2h", 0, "parameters", 57170242.0)]
    rows += [(v, 0, "fd_speckle", value) for v, value in (("sa2h", 0.5), ("nsa2h", 0.4), (RESIMULATION, 0.01))]
    return pd.DataFrame(rows, columns=["variant", "seed", "metric", "value"])


def test_cells_are_means_and_deviations_and_order_is_fixed(study, scalars):
    table = analysis.comparison_table(study, scalars)
    assert list(dict.fromkeys(table["variant"])) == [RESIMULATION, "sa2h", "nsa2h", "sa2h-att"]
    assert list(dict.fromkeys(table["metric"])) == ["psnr", "pchi2", "fd_speckle", "parameters"]
    cell = table[(table["variant"] == "sa2h") & (table["metric"] == "psnr")].iloc[0]
    values = study[(study["variant"] == "sa2h") & (study["metric"] == "psnr")]
    assert cell["mean"] == pytest.approx(values["value"].mean())
    assert cell["sd"] == pytest.approx(values["value"].std())
    assert cell["seed_sd"] == pytest.approx(values.groupby("seed")["value"].mean().std())
    assert (cell["seeds"], cell["n"], cell["dropped"]) == (3, 72, 0)
    best = table.query("best")[["metric", "variant"]]
    assert set(map(tuple, best.to_numpy())) == {("psnr", "sa2h"), ("pchi2", "sa2h"), ("fd_speckle", "nsa2h")}


def test_metrics_that_only_some_runs_have_are_named(study, scalars):
    def lines(*of: pd.DataFrame) -> list[str]:
        wide = analysis.run_means(*of).pivot(index=["variant", "seed", "data"], columns="metric", values="value")
        return analysis.partly_scored(wide.reset_index(), {"psnr", "pchi2", "fd_speckle"})

    assert lines(study, scalars) == [
        "Not all runs have each metric: FD speckle of nsa2h (1 of 3), FD speckle of sa2h (1 of 3); means and tests are "
        "over the runs that have it; the command of the others scores them, if they can be."
    ]
    assert lines(study, scalars.iloc[:0]) == []
    part = study[(study["variant"] != "sa2h") | (study["metric"] != "pchi2") | (study["seed"] != 1)]
    (line,) = lines(part, scalars.iloc[:0])
    assert "pχ² of sa2h (2 of 3);" in line


@pytest.mark.parametrize(
    ("count", "text"), [(10, "10"), (9999, "9999"), (103_984, "0.104M"), (57_170_242, "57.2M"), (1_204_000_000, "1.2G")]
)
def test_numbers_of_parameters_are_short_and_true(count: int, text: str) -> None:
    rows = [("sa2h", 0, "parameters", float(count))]
    scalars = pd.DataFrame(rows, columns=["variant", "seed", "metric", "value"])
    none = pd.DataFrame(columns=["variant", "seed", "frame", "site", "metric", "value"]).astype({"value": float})
    cells = cell_texts(analysis.comparison_table(none, scalars))[2]
    assert cells["sa2h", "parameters"].mean == text


def test_formats_hold_every_variant_and_round_trip(study, scalars):
    table = analysis.comparison_table(study, scalars)
    for printed in (analysis.to_text(table), analysis.to_markdown(table)):
        assert all(name in printed for name in ("sa2h-att", "nsa2h", RESIMULATION, "57.2M", "14.5M"))
    assert "floor" in analysis.to_text(table)
    assert "…" not in analysis.to_text(table)
    wide = analysis.wide_table(table)
    back = pd.read_csv(io.StringIO(wide.to_csv(index=False)))
    pd.testing.assert_frame_equal(back, wide, check_dtype=False)
    assert list(wide["variant"]) == [RESIMULATION, "sa2h", "nsa2h", "sa2h-att"]


def test_markdown_has_a_cell_for_every_head_and_the_spread_over_frames(study, scalars):
    table = analysis.comparison_table(study, scalars)
    text = analysis.to_markdown(table)
    lines = text.splitlines()
    assert {line.count("|") for line in lines} == {2 + len(set(table["metric"])) + 1}
    cell = table.query("variant == 'sa2h' and metric == 'psnr'").iloc[0]
    assert f"**{cell['mean']:.2f}** ± {cell['sd']:.2f}" in text
    assert lines[2].startswith(f"| {RESIMULATION} | – |")
    assert lines[3].startswith("| sa2h | 3 |")


def test_variants_are_ordered_with_what_was_changed_beside_them_last():
    names = ["sa2h.depth-8", "sa2h-conv", "lsa2h", "sa2h", "sa2h-att.encoding-arbitrary", RESIMULATION]
    assert analysis.ordered_variants(names) == [
        *(RESIMULATION, "sa2h", "lsa2h", "sa2h-conv"),
        *("sa2h.depth-8", "sa2h-att.encoding-arbitrary"),
    ]


def test_paired_table_is_the_paired_difference_with_holm_over_networks(study):
    table = analysis.paired_table(study, resamples=200)
    assert tuple(table.columns) == PAIRED_COLUMNS
    assert set(table["variant"]) == {RESIMULATION, "sa2h-att", "nsa2h"}
    means = study.groupby(["metric", "variant", "frame"])["value"].mean()
    raw = []
    for row in table.to_dict("records"):
        a, b = means[row["metric"], row["variant"]], means[row["metric"], "sa2h"]
        difference = analysis.paired_difference(a, b, [f"site{k % 8}" for k in a.index], resamples=200)
        assert (row["shift"], row["lower"], row["upper"]) == (difference.shift, difference.lower, difference.upper)
        raw.append(difference.p)
    networks = (table["variant"] != RESIMULATION).to_numpy()
    np.testing.assert_allclose(table["p_holm"][networks], analysis.holm(np.array(raw)[networks]))
    site_means = (study.groupby(["metric", "variant", "site"])["value"].mean()).unstack("site")
    compared = zip(table["metric"][networks], table["variant"][networks], strict=True)
    raw = [stats.wilcoxon(site_means.loc[m, v] - site_means.loc[m, "sa2h"]).pvalue for m, v in compared]
    np.testing.assert_allclose(table["p_sites_holm"][networks], analysis.holm(raw))
    assert set(table["sites"]) == {8}
    assert table.query("variant == 'nsa2h' and metric == 'psnr'")["shift"].iloc[0] == pytest.approx(-2, abs=0.1)


def test_missing_reference_or_single_variant_give_empty_tables(study_of):
    assert analysis.paired_table(study_of(variants=("nsa2h", "sa2h-att"))).empty
    assert analysis.paired_table(study_of(variants=("sa2h",))).empty
    alone = analysis.comparison_table(study_of(variants=("sa2h",)))
    assert not alone["best"].any(), "one network alone is not the best of anything"
    assert "sa2h" in analysis.to_text(alone)


def test_seed_claims(study, study_of, scalars):
    claims = analysis.seed_claims(study).set_index(["variant", "metric"])
    assert claims.loc[("nsa2h", "psnr"), "verdict"] == "differs"
    means = study.groupby(["variant", "metric", "seed"])["value"].mean()
    p = stats.ttest_ind(means["nsa2h", "psnr"], means["sa2h", "psnr"], equal_var=False).pvalue
    assert claims.loc[("nsa2h", "psnr"), "p"] == pytest.approx(p)
    assert claims.loc[("nsa2h", "pchi2"), "verdict"] == "not claimable", "no seed changes it: no error to judge by"
    assert RESIMULATION not in claims.index.get_level_values("variant")
    assert set(analysis.seed_claims(study_of(seeds=(0,)))["verdict"]) == {"not claimable"}
    assert "fd_speckle" in set(analysis.seed_claims(study, scalars)["metric"])
    assert "parameters" not in set(analysis.seed_claims(study, scalars)["metric"])
    assert analysis.seed_claims(study, reference="elsewhere").empty


def test_a_claim_that_does_not_survive_holm_is_a_suggestion():
    by_seed = {"sa2h": (0.0, 0.3, 0.6), "b0": (1.0, 1.4, 1.9), "b1": (0.1, 0.2, 0.5), "b2": (0.3, 0.2, 0.1)}
    rows = [
        (variant, seed, 0, 0, f"m{k}", value if k == 0 or variant == "sa2h" else value / 4)
        for k in range(4)
        for variant, values in by_seed.items()
        for seed, value in enumerate(values)
    ]
    table = pd.DataFrame(rows, columns=["variant", "seed", "frame", "site", "metric", "value"])
    claims = analysis.seed_claims(table)
    np.testing.assert_allclose(claims["p_holm"].astype(float), analysis.holm(claims["p"].astype(float)))
    row = claims.query("variant == 'b0' and metric == 'm0'").iloc[0]
    assert row["p"] < 0.05 < row["p_holm"]
    assert row["verdict"] == "suggested"
    assert row["lower"] > 0


def test_one_nan_costs_one_frame_and_an_infinite_value_one_too(study):
    broken = study[~((study["variant"] == "nsa2h") & (study["frame"] < 4))].copy()
    hit = (broken["variant"] == "nsa2h") & (broken["metric"] == "psnr") & (broken["seed"] == 1)
    broken.loc[hit & (broken["frame"] == 5), "value"] = np.nan
    broken.loc[hit & (broken["frame"] == 6), "value"] = np.inf
    cell = analysis.comparison_table(broken).query("variant == 'nsa2h' and metric == 'psnr'").iloc[0]
    assert (cell["n"], cell["dropped"], np.isfinite(cell["mean"])) == (58, 2, True)
    row = analysis.paired_table(broken, resamples=10).query("variant == 'nsa2h' and metric == 'psnr'").iloc[0]
    assert (row["n"], row["dropped"]) == (18, 2), "a frame that one seed has no value for is compared by no seed"
    assert analysis.seed_claims(broken).query("variant == 'nsa2h' and metric == 'psnr'")["verdict"].iloc[0] == "differs"
    other = (broken["variant"] == "nsa2h") & (broken["metric"] == "psnr") & (broken["seed"] == 0)
    broken.loc[other & (broken["frame"] == 6), "value"] = -np.inf
    row = analysis.paired_table(broken, resamples=10).query("variant == 'nsa2h' and metric == 'psnr'").iloc[0]
    assert (row["n"], row["dropped"]) == (18, 2), "infinities of both signs have no mean"


def test_a_metric_without_one_value_is_shown_as_such(study):
    broken = study.copy()
    broken.loc[(broken["variant"] == "nsa2h") & (broken["metric"] == "psnr"), "value"] = np.nan
    table = analysis.comparison_table(broken)
    assert table.query("variant == 'nsa2h' and metric == 'psnr'")["n"].iloc[0] == 0
    for printed in (analysis.to_text(table), analysis.to_latex(table)):
        assert "nan" not in printed.lower()
    assert analysis.paired_table(broken, resamples=10).query("variant == 'nsa2h' and metric == 'psnr'").empty


LABELS = [f"sa2h{part}{more}" for part in ("", "-att", "-conv", "-noise") for more in ("", ".encoding-arbitrary")]


@pytest.fixture(scope="module")
def large(study_of):
    """Eight labels, a metric with a name of the user's, and metrics of a whole run."""
    study = study_of(variants=(RESIMULATION, "sa2h", "nsa2h"))
    base = study[study["variant"] == "sa2h"]
    study = pd.concat([study, *(base.assign(variant=name) for name in LABELS[1:])])
    study = pd.concat([study, base[base["metric"] == "psnr"].assign(metric="my_metric_%")])
    names = ["sa2h", "nsa2h", *LABELS[1:]]
    rows = [(v, s, m, 1.0 + k) for k, v in enumerate(names) for s in (0, 1, 2) for m in ("fd_speckle", "parameters")]
    rows += [(RESIMULATION, 0, "fd_speckle", 0.1)]
    return analysis.comparison_table(study, pd.DataFrame(rows, columns=["variant", "seed", "metric", "value"]))


def width(line):
    """Columns that a row of a tabular takes."""
    spans = [re.search(r"\\multicolumn\{(\d+)\}", cell) for cell in re.split(r"(?<!\\)&", line)]
    return sum(int(span[1]) if span else 1 for span in spans)


def test_every_row_is_as_wide_as_the_tabular(large):
    latex = analysis.to_latex(large)
    columns = len(re.search(r"\\begin\{tabular\}\{(l[r]+)\}", latex)[1])
    rows = [line for line in latex.splitlines() if line.endswith(r"\\")]
    assert {width(line) for line in rows} == {columns}
    assert len(rows) == 2 + 1 + 9, "two heads, the re-simulation, nine networks"
    for a, b in re.findall(r"\\cmidrule\(lr\)\{(\d+)-(\d+)\}", latex):
        assert 2 <= int(a) < int(b) <= columns
    for rule, count in ((r"\toprule", 1), (r"\bottomrule", 1), (r"\midrule", 4)):
        assert latex.count(rule) == count
    assert re.findall(r"\\begin\{(.+?)\}", latex) == re.findall(r"\\end\{(.+?)\}", latex)[::-1]
    assert latex.count("{") == latex.count("}")
    assert not re.search(r"(?<!\\)[_#%](?! needs)", latex), "a bare special sign"


def test_bold_is_the_best_network_and_never_the_resimulation(large):
    lines = {line.split(" & ")[0]: line for line in analysis.to_latex(large).splitlines() if line.endswith(r"\\")}
    assert r"\textbf" not in lines[RESIMULATION]
    best = large[large["best"]]
    for row in best.to_dict("records"):
        assert r"\textbf" in lines[row["variant"]]
    assert sum(line.count(r"\textbf") for line in lines.values()) == len(best)


def test_the_caption_tells_a_floor_from_a_level(large):
    caption = re.search(r"\\caption\{(.*)\}\n", analysis.to_latex(large))[1]
    assert "floor for p$\\chi^2$, FD speckle" in caption
    assert "level of a perfect stochastic renderer for PSNR" in caption
    assert "24 test frames" in caption
    assert "3 seeds" in caption
    alone = analysis.to_latex(large[large["variant"] != RESIMULATION])
    assert "floor" not in alone


def test_the_caption_tells_of_frames_only_where_there_are_values_of_frames(large):
    one = large.assign(n=large["seeds"], dropped=0, sd=np.nan)
    assert r"\caption{Mean, 3 seeds a network." in analysis.to_latex(one)
    less = large.assign(n=large["n"] - large["seeds"], dropped=large["seeds"])  # one frame of each run is infinite
    assert "over 24 test frames, 3 seeds" in analysis.to_latex(less)


def test_special_signs_are_escaped():
    assert latex_text(r"a_b%c&d#$e\f~^{}") == (
        r"a\_b\%c\&d\#\$e\textbackslash{}f\textasciitilde{}\textasciicircum{}\{\}"
    )


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="there is no LaTeX here")
def test_it_compiles(large, tmp_path):
    head = [r"\documentclass[twocolumn]{article}", r"\usepackage{booktabs}", r"\begin{document}"]
    (tmp_path / "table.tex").write_text("\n".join([*head, analysis.to_latex(large), r"\end{document}"]))
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "table.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (tmp_path / "table.pdf").exists()


def test_a_value_that_only_some_runs_have_is_counted_and_compared_by_none(study):
    """One seed has no value of the six easiest frames: its own mean would be too low."""
    frame = study.query("variant == 'sa2h' and seed == 0 and metric == 'psnr'").nlargest(6, "value")["frame"]
    gone = (study["variant"] == "nsa2h") & (study["seed"] == 1) & (study["metric"] == "psnr")
    part = study[~(gone & study["frame"].isin(frame))]
    cell = analysis.comparison_table(part).query("variant == 'nsa2h' and metric == 'psnr'").iloc[0]
    assert (cell["n"], cell["dropped"]) == (66, 6)
    row = analysis.paired_table(part, resamples=10).query("variant == 'nsa2h' and metric == 'psnr'").iloc[0]
    assert (row["n"], row["dropped"]) == (18, 6)
    claims = analysis.seed_claims(part).set_index(["variant", "metric"])
    both = analysis.seed_claims(study[~study["frame"].isin(frame)]).set_index(["variant", "metric"])
    for variant in ("nsa2h", "sa2h-att"):
        assert claims.loc[(variant, "psnr"), "shift"] == pytest.approx(both.loc[(variant, "psnr"), "shift"])
    text = " ".join(analysis.cautions(part))
    assert "PSNR: 6 missing values left out (nsa2h/seed1 frame" in text
    assert "means over the frames of which all runs have a value" in text
    nowhere = study[(study["metric"] == "pchi2") | (study["frame"] != 3)]
    assert "missing value" not in " ".join(analysis.cautions(nowhere)), "the frame offers nothing to measure"
    assert set(analysis.comparison_table(nowhere).query("metric == 'psnr'")["dropped"]) == {3, 1}


def test_the_best_at_zero_is_nearest_to_it_in_every_seed(monkeypatch):
    rows = [("sa2h", 0, 1.0), ("sa2h", 1, 2.0), ("nsa2h", 0, 5.0), ("nsa2h", 1, -5.0)]
    table = pd.DataFrame(rows, columns=["variant", "seed", "value"]).assign(frame=0, site=0, metric="bias")
    monkeypatch.setattr("ablate.analysis.summaries.metric_of", lambda name: Metric(name, better=Direction.zero))
    compared = analysis.comparison_table(table).set_index("variant")
    assert compared["mean"].to_dict() == {"sa2h": 1.5, "nsa2h": 0.0}
    assert compared["best"].to_dict() == {"sa2h": True, "nsa2h": False}, "5 too much and 5 too little"
