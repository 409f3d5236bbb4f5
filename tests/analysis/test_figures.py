"""Figures are written whole, in both formats, and show what they say."""

import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from ablate import analysis
from ablate.analysis import RESIMULATION
from ablate.analysis import figures as package
from ablate.analysis.figures.style import shown_name
from ablate.metrics import patch_chi2
from support.components import COMPONENTS
from support.runtime import measured_points


def test_figures_are_written_whole_in_both_formats(study, pictures, tmp_path):
    bare = replace(pictures, name="frame 8", predictions={"sa2h": pictures.target}, attenuation=None)
    pairs = analysis.paired_table(study, resamples=50)
    for paths in (
        analysis.boxplot_panels(study, ["psnr"], tmp_path / "boxplot_psnr", paired=pairs),
        analysis.forest_figure(verdicts_of(), NOTHING, NOTHING, COMPONENTS, tmp_path / "verdicts"),
        analysis.qualitative_figure([pictures, bare], tmp_path / "deep" / "qualitative_0"),
        analysis.chi2_maps_figure(pictures, tmp_path / "pchi2_maps_0"),
        analysis.error_vs_runtime(measured_points(), tmp_path / "error_vs_runtime", {"mae": 0.2}, "a test"),
        analysis.convergence_figure(measured_points(), tmp_path / "convergence", "a test"),
    ):
        assert [path.suffix for path in paths] == [".png", ".pdf"]
        picture = imread(paths[0])
        assert picture.shape[1] >= 600
        assert picture[..., :3].std() > 0.01, "a blank page"
        page = paths[1].read_bytes()
        assert page.startswith(b"%PDF")
        assert b"/FontFile2" in page, "journals want TrueType fonts"


def legend_of(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_boxes_are_quartiles_of_the_paired_differences_and_resimulation_is_a_band(study, figures, tmp_path):
    analysis.boxplot_panels(
        study, ["psnr", "pchi2"], tmp_path / "boxplots", paired=analysis.paired_table(study, resamples=50)
    )
    left, right = figures["boxplots"].axes
    assert [text.get_text() for text in left.get_yticklabels()] == ["nsa2h", "sa2h-att"]
    means = study[study["metric"] == "psnr"].groupby(["variant", "frame"])["value"].mean()
    delta = means["nsa2h"] - means["sa2h"]
    box = max(left.patches, key=lambda patch: patch.get_path().get_extents().y1 if patch.get_zorder() > 0 else -1)
    extent = box.get_path().get_extents()
    assert (extent.x0, extent.x1) == pytest.approx(tuple(np.quantile(delta, [0.25, 0.75])))
    assert legend_of(figures["boxplots"]) == [
        "re-simulation, quartiles",
        "re-simulation, median (dashed: floor, dotted: level)",
    ]
    assert "better →" in left.get_xlabel()
    assert "← better" in right.get_xlabel()


NOTHING = pd.DataFrame(columns=["component", "other", "improvement", "q", "on"])  # of runs, or of interactions


def verdicts_of(**more):
    """Verdicts of two components whose metrics are better where they are smaller; the second is without an effect."""
    first = {"component": "att", "metric": "shadow_contrast", "effect": -6.0, "lower": -8.0, "upper": -4.0, "band": 3.0}
    first |= {
        "question": "earns",
        "verdict": "earns",
        "least": 3.9,
        "most": 7.5,
        "ms_per_frame": 1.26,
        "parameters": -2400.0,
    }
    second = dict.fromkeys(first, np.nan) | {"component": "conv", "metric": "nyquist_excess", "verdict": "undecided"}
    second["question"] = "earns"
    third = first | {"component": "depth", "metric": "mae_smooth", "effect": 1.0}
    third["verdict"] = "does_not"
    return pd.DataFrame([first | more, second, third])


def test_the_forest_is_in_units_of_the_band_and_says_the_verdict(figures, tmp_path):
    dots = [("att", True, 6.5), ("att", True, 5.5), ("att", False, -0.3), ("conv", True, 9.0)]
    runs = pd.DataFrame(dots, columns=["component", "on", "improvement"])
    rows = [("att", "depth", 3.0, 0.01), ("depth", "att", -6.0, 0.2), ("conv", "att", 9.0, 0.01)]
    pairs = pd.DataFrame(rows, columns=["component", "other", "improvement", "q"])
    analysis.forest_figure(verdicts_of(), runs, pairs, COMPONENTS, tmp_path / "verdicts")
    forest, beside, table, _ = figures["verdicts"].axes
    drawn = {}
    for line in forest.lines:
        drawn.setdefault(line.get_label(), []).append(list(line.get_xdata()))
    assert [x for (x,) in drawn["effect, 95 % interval"]] == pytest.approx([2, -1 / 3])
    assert drawn["run with it"][0] == pytest.approx([6.5 / 3, 5.5 / 3])
    assert drawn["run without it"][0] == pytest.approx([-0.1])
    assert drawn["with Holm's correction"][0] == pytest.approx([1.3, 2.5])
    (band,) = forest.patches
    assert (band.get_x(), band.get_width()) == (-1, 2)
    assert forest.get_yticklabels()[0].get_text() == "attenuation map\nShadow contrast error"
    words = [text.get_text() for text in beside.texts]
    assert words[3:] == ["earns", "+1.3", "−2k", "does not", "+1.3", "−2k"]
    assert [text.get_text() for text in table.texts] == ["+1.0*", "−2.0"]
    assert table.images[0].get_array().filled(0).tolist() == pytest.approx(np.array([[0, 1], [-2, 0]]))
    assert legend_of(figures["verdicts"])[0] == "too small to matter"


def test_a_forest_of_one_run_a_side_has_no_interval_and_none_without_an_effect(figures, tmp_path):
    alone = verdicts_of(
        lower=np.nan, upper=np.nan, least=np.nan, most=np.nan, ms_per_frame=np.nan, verdict="undecided"
    ).iloc[:2]
    assert analysis.forest_figure(alone, NOTHING, NOTHING, COMPONENTS, tmp_path / "verdicts")
    forest, beside = figures["verdicts"].axes
    assert not [line for line in forest.lines if line.get_linewidth() > 2 and np.isfinite(line.get_xdata()).any()]
    assert [text.get_text() for text in beside.texts][3:] == ["undecided", "–", "−2k"]
    assert analysis.forest_figure(alone.iloc[1:], NOTHING, NOTHING, COMPONENTS, tmp_path / "none") == []


@pytest.mark.parametrize(("predictions", "frames"), [(1, 4), (6, 4), (7, 2), (13, 2), (14, 1)])
def test_a_page_holds_fewer_frames_of_more_variants(predictions, frames, pictures, figures, tmp_path):
    assert analysis.frames_a_page(predictions) == frames
    names = [f"v{k}" for k in range(predictions)]
    frame = replace(pictures, predictions=dict.fromkeys(names, pictures.target))
    analysis.qualitative_figure([frame] * frames, tmp_path / "grid")
    shown = [axes for axes in figures["grid"].axes if axes.images]
    assert len(shown) == frames * (predictions + 1), "every variant of every frame"
    figures["grid"].draw_without_rendering()
    width, height = figures["grid"].get_size_inches()
    if predictions <= 13:
        assert width <= 7.17
        assert height <= 9.6
        assert min(axes.get_position().width * width for axes in shown) > 1.5, "inches: narrower, speckle is lost"


def test_long_names_of_rows_stay_beside_their_pictures(pictures, figures, tmp_path):
    names = [RESIMULATION, "sa2h", "sa2h.attenuation-compound", "sa2h.concat-input.upsampling-transposed.depth-6"]
    frame = replace(pictures, predictions=dict.fromkeys(names, pictures.target))
    analysis.qualitative_figure([frame] * 4, tmp_path / "grid")
    figure = figures["grid"]
    figure.draw_without_rendering()
    told = [axes for axes in figure.axes if axes.get_ylabel()]
    assert len(told) == len(names) + 1
    for axes in told:
        name, picture = axes.yaxis.label.get_window_extent(), axes.get_window_extent()
        assert name.height <= picture.height * 1.02, axes.get_ylabel()
        assert name.y0 >= 0


def test_chi2_maps_of_eleven_networks_fit_a_page(pictures, figures, tmp_path):
    names = [RESIMULATION, "sa2h", "sa2h.encoding-arbitrary", *(f"v{k}" for k in range(9))]
    many = replace(pictures, predictions=dict.fromkeys(names, pictures.predictions["sa2h"]))
    analysis.chi2_maps_figure(many, tmp_path / "maps", COMPONENTS)
    figure = figures["maps"]
    assert tuple(figure.get_size_inches() <= (7.17, 9.6)) == (True, True)
    maps = [image for axes in figure.axes for image in axes.images if image.get_cmap().name == "inferno"]
    assert len(maps) == len(names)
    assert {image.get_clim() for image in maps} == {(0, 1)}
    expected = patch_chi2(pictures.predictions["sa2h"], pictures.target)
    np.testing.assert_array_equal(maps[0].get_array().data, expected)
    titles = [axes.get_title() for axes in figure.axes if axes.get_title()]
    assert titles[-2].startswith("sa2h + arbitrary"), "what was changed beside a variant comes last"
    assert titles[-1] == "target"


@pytest.mark.parametrize(
    ("label", "shown"),
    [
        ("sa2h", "sa2h"),
        ("sa2h-att.encoding-arbitrary", "sa2h-att + arbitrary"),
        ("sa2h.attenuation-none.concat-input.depth-6.noise-input", "sa2h −att −concat depth 6 −noise"),
        ("sa2h.noise-inject.noise_start-0.3", "sa2h + noise-inject + noise_start-0.3"),
    ],
)
def test_labels_are_short_on_figures(label, shown):
    assert shown_name(label, COMPONENTS) == shown


def test_captions_tell_a_floor_from_a_level():
    for figure in ("boxplots", "error_vs_runtime"):
        text = analysis.caption(figure, ["psnr", "pchi2"])
        assert "floor for pχ²" in text
        assert "level of a perfect stochastic renderer for PSNR" in text
    assert "frame 3" in analysis.caption("pchi2_maps", frame="frame 3")
    assert analysis.caption("verdicts", design=None).endswith("the parameters of the network.")


def drawn_of(results, folder):
    """What `draw_figures` gives, as (file, section)."""
    return [(figure.path.name, str(figure.section)) for figure in analysis.draw_figures(results, folder)]


@pytest.mark.usefixtures("figures")
def test_all_figures_for_which_there_are_numbers_or_pictures_are_drawn(study, pictures, tmp_path):
    frames = [replace(pictures, name=f"frame {k}") for k in (7, 9)]
    times = [(name, 0, "ms_per_frame", 5.0, 4.0, 6.0) for name in ("sa2h", "nsa2h")]
    scalars = pd.DataFrame(times, columns=["variant", "seed", "metric", "value", "lower", "upper"])
    whole = analysis.StudyResults(per_image=study, scalars=scalars, pictures=frames)
    assert drawn_of(whole, tmp_path) == [
        ("qualitative_0", "figures"),
        ("boxplots", "figures"),
        ("boxplot_psnr", "folded"),
        ("boxplot_pchi2", "folded"),
        ("pchi2_maps_0", "figures"),
        ("pchi2_maps_1", "folded"),
        ("error_vs_runtime", "figures"),
    ]
    captions = {figure.path.name: figure.caption for figure in analysis.draw_figures(whole, tmp_path)}
    assert all(captions.values())
    assert "(frame 9)" in captions["pchi2_maps_1"]
    alone = analysis.StudyResults(per_image=study[study["variant"] == "sa2h"])
    assert drawn_of(alone, tmp_path) == []
    identical = study[study["metric"] == "psnr"].assign(value=np.inf)
    assert drawn_of(analysis.StudyResults(per_image=identical, scalars=scalars), tmp_path) == [], "no finite error"


NEW_FIGURE = """
from ablate.analysis.figures.study_figure import Drawing, Section, StudyFigure

def draw(results, folder):
    path = folder / "own.png"
    path.write_bytes(str(len(results.per_image)).encode())
    yield Drawing([path], metrics=["psnr"])

OWN = StudyFigure(name="boxplots", section=Section.verdicts, draw=draw, place=0)
"""


@pytest.mark.usefixtures("figures")
def test_a_new_figure_is_found_by_its_module(study, tmp_path, monkeypatch):
    (tmp_path / "own_figure.py").write_text(NEW_FIGURE, "utf-8")
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    drawn = analysis.draw_figures(analysis.StudyResults(per_image=study), tmp_path)
    del sys.modules["ablate.analysis.figures.own_figure"]
    assert (drawn[0].path.name, str(drawn[0].section)) == ("own.png", "verdicts")
    assert drawn[0].path.read_bytes() == str(len(study)).encode()
    assert drawn[0].caption.startswith("Paired differences")


def test_a_map_without_a_patch_has_no_number(pictures, figures, tmp_path):
    analysis.chi2_maps_figure(replace(pictures, mask=np.zeros_like(pictures.mask)), tmp_path / "none")
    titles = [axes.get_title() for axes in figures["none"].axes]
    assert "sa2h\n–" in titles
    assert not any("0.000" in title for title in titles)


def test_captions_are_silent_about_what_pairs_lack():
    for figure in ("boxplots", "qualitative", "pchi2_maps", "error_vs_runtime"):
        more = {"frame": "frame 3"} if figure == "pchi2_maps" else {}
        assert "re-simulation" in analysis.caption(figure, ["psnr"], **more).lower()
        assert "re-simulation" not in analysis.caption(figure, ["psnr"], resimulated=False, **more).lower()
    assert "attenuation A" in analysis.caption("qualitative")
    assert "attenuation A" not in analysis.caption("qualitative", attenuation=False)
