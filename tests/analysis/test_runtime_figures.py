"""Error against time in figures: what is drawn where, and what it is called."""

import numpy as np
import pandas as pd
import pytest

from ablate import analysis
from ablate.analysis.figures.convergence_figure import named_setting
from ablate.analysis.figures.point_names import write_names
from ablate.analysis.figures.style import new_figure
from ablate.metrics import Direction, Metric
from support.runtime import measured_points


def test_points_without_a_time_are_refused(tmp_path):
    points = measured_points()
    with pytest.raises(ValueError, match="no finite point"):
        analysis.error_vs_runtime(points[points["ms"] == 0], tmp_path / "none")
    with pytest.raises(ValueError, match="no finite point"):
        analysis.convergence_figure(points[points["series"] == "sa2h"], tmp_path / "none")


def test_renderers_are_drawn_above_the_re_simulation_with_names_and_intervals(figures, tmp_path):
    """Of the PSNR, what is worse is smaller; axes are linear, and a metric without the re-simulation stays as it is."""
    names = ["sa2h", "nsa2h", "formula"]
    rows = [
        (name, "bf16", 5.0 * k, metric, e * k)
        for k, name in enumerate(names, 1)
        for metric, e in (("mae", 2), ("psnr", 3))
    ]
    points = pd.DataFrame(rows, columns=["series", "setting", "ms", "metric", "error"])
    points = points.assign(worse_lower=0.5, worse_upper=1.5).replace({"setting": {"fp32": ""}})
    analysis.error_vs_runtime(points, tmp_path / "both", {"psnr": 10.0})
    mae, psnr = figures["both"].axes

    def at(panel):
        return [tuple(line.get_xydata()[0]) for line in panel.lines if line.get_marker() == "o"]

    assert at(mae) == [(5, 2), (10, 4), (15, 6)]
    assert at(psnr) == [(5, 7), (10, 4), (15, 1)]
    assert [text.get_text() for text in psnr.texts] == [f"{name}, bf16" for name in names]
    assert {panel.get_xscale() + panel.get_yscale() for panel in (mae, psnr)} == {"linearlinear"}
    bars = [list(line.get_ydata()) for line in psnr.lines if list(line.get_xdata()) == [5.0, 5.0]]
    assert bars == [[0.5, 1.5]]
    assert psnr.get_ylabel() == "PSNR below re-simulation (dB)"
    boxes = [text.get_window_extent() for text in psnr.texts]
    assert not any(one.overlaps(other) for k, one in enumerate(boxes) for other in boxes[:k])


def test_a_renderer_far_worse_than_the_simulator_is_told_in_words(figures, tmp_path):
    """It would leave no room to tell the others apart."""
    rows = [("simulator, other", "1 ray", 5.0, "mae", 12.0), ("simulator, other", "re-simulation", 9.0, "mae", 10.0)]
    rows += [("sa2h", "bf16", 6.0, "mae", 14.0), ("sa2h-att", "bf16", 6.0, "mae", 16.0)]
    points = pd.DataFrame(rows, columns=["series", "setting", "ms", "metric", "error"])
    analysis.error_vs_runtime(points, tmp_path / "far", {"mae": 10.0})
    (panel,) = figures["far"].axes
    assert [text.get_text() for text in panel.texts] == ["1 ray", "sa2h, bf16", "re-simulation"]
    assert panel.get_title() == "beyond the axis: sa2h-att, bf16: +6.00"
    assert panel.get_ylim()[1] < 6


def test_a_simulator_that_is_better_than_re_simulation_is_on_the_axis(figures, tmp_path):
    """By chance, or because few rays blur; everything was beyond an axis that ended below zero."""
    rows = [("simulator, other", "1 ray", 5.0, "mae", 9.5), ("simulator, other", "re-simulation", 9.0, "mae", 9.9)]
    rows += [("sa2h", "bf16", 6.0, "mae", 9.7), ("sa2h-att", "bf16", 6.0, "mae", 16.0)]
    points = pd.DataFrame(rows, columns=["series", "setting", "ms", "metric", "error"])
    analysis.error_vs_runtime(points, tmp_path / "better", {"mae": 10.0})
    (panel,) = figures["better"].axes
    assert {text.get_text() for text in panel.texts} == {"1 ray", "re-simulation", "sa2h, bf16"}
    assert panel.get_title() == "beyond the axis: sa2h-att, bf16: +6.00"


def test_a_re_simulation_without_a_finite_value_is_no_level(figures, tmp_path):
    """Its PSNR is infinite where nothing scatters; the panel was empty."""
    points = pd.DataFrame({"series": ["sa2h"], "setting": "", "ms": 5.0, "metric": "psnr", "error": 20.0})
    analysis.error_vs_runtime(points, tmp_path / "none", {"psnr": np.nan})
    (panel,) = figures["none"].axes
    assert [tuple(line.get_xydata()[0]) for line in panel.lines if line.get_marker() == "o"] == [(5.0, 20.0)]
    assert (panel.get_ylabel(), panel.get_title()) == ("PSNR (dB)", "")


@pytest.mark.parametrize(("slowest_ms", "scale"), [(400.0, "linear"), (55000.0, "log")])
def test_times_of_several_decades_are_on_a_logarithmic_axis(slowest_ms, scale, figures, tmp_path):
    rows = [
        ("simulator, other", "re-simulation", slowest_ms, "mae", 10.0),
        ("simulator, other", "1 ray", 5.0, "mae", 12),
    ]
    points = pd.DataFrame(rows, columns=["series", "setting", "ms", "metric", "error"])
    analysis.error_vs_runtime(points, tmp_path / "times", {"mae": 10.0})
    axes = figures["times"].axes[0]
    assert axes.get_xscale() == scale
    assert all(set(label.get_text()) <= set("0123456789,") for label in axes.get_xticklabels())


def test_names_have_room_where_points_are_dense():
    figure = new_figure(4.0, 3.0)
    axes = figure.add_subplot()
    random = np.random.default_rng(0)
    x, y = random.normal(0, 1, (2, 14))
    axes.plot(x, y, "o", ms=4)
    axes.margins(0.2)
    figure.draw_without_rendering()
    write_names(axes, [f"{k} rays, layer" for k in range(14)], x, y)
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in axes.texts]
    shared = sum(bool(one.overlaps(other)) for k, one in enumerate(boxes) for other in boxes[:k])
    assert len(boxes) == 14
    assert shared == 0


@pytest.mark.parametrize(
    ("series", "setting", "name"),
    [
        ("simulator, rays", "1", "1 ray"),
        ("simulator, axial samples", "384", "384 axial samples"),
        ("simulator, other scatterers", "axial samples 384", "384 axial samples"),
        ("simulator, combined", "rays 2, layers 1", "2 rays, 1 layer"),
        ("simulator, combined", "layers 1, compound angles 1", "1 layer, 1 angle"),
        ("simulator, compound angles", "5", "5 angles"),
    ],
)
def test_settings_are_named_as_one_says_them(series, setting, name):
    assert named_setting(series, setting) == name


@pytest.mark.parametrize(("better", "front"), [(Direction.zero, [-0.5, 0.1]), (Direction.none, None)])
def test_a_metric_of_both_signs_has_its_own_front_and_a_linear_axis(better, front, figures, tmp_path, monkeypatch):
    points = pd.DataFrame({"series": list("abcd"), "ms": [1.0, 2.0, 3.0, 4.0], "error": [-0.5, 0.1, -9.0, 2.0]})
    points = points.assign(setting="", metric="signed")
    monkeypatch.setattr(analysis.figures.runtime_figure, "metric_of", lambda name: Metric(name, better=better))
    analysis.error_vs_runtime(points, tmp_path / "signed")
    axes = figures["signed"].axes[0]
    assert axes.get_yscale() == "linear", "a logarithm hides what is below 0"
    fronts = [list(line.get_ydata()) for line in axes.lines if line.get_label() == "Pareto front"]
    assert fronts == ([front] if front else [])
