"""Figures are written whole, in both formats, and show what they say."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.image import imread

from ablate.analysis import (
    FramePictures,
    chi2_maps_figure,
    error_vs_runtime,
    paired_boxplots,
    paired_table,
    pareto_front,
    qualitative_figure,
)
from ablate.analysis.figure_style import COLOURS


def assert_written(paths):
    assert [path.suffix for path in paths] == [".png", ".pdf"]
    picture = imread(paths[0])
    assert picture.shape[1] >= 600
    assert picture[..., :3].std() > 0.01, "a blank page"
    assert paths[1].read_bytes().startswith(b"%PDF")
    return picture


def test_boxplots_one_a_metric(study, tmp_path):
    written = paired_boxplots(study, tmp_path, paired=paired_table(study, resamples=50))
    assert set(written) == {"psnr", "pchi2"}
    assert {path.name for path in tmp_path.iterdir()} >= {"boxplot_psnr.png", "boxplot_pchi2.pdf"}
    for paths in written.values():
        assert_written(paths)


def test_boxplots_without_pairs_draw_nothing(study_of, tmp_path):
    assert paired_boxplots(study_of(variants=("sa2h",)), tmp_path) == {}
    assert paired_boxplots(study_of(variants=("nsa2h", "sa2h-att")), tmp_path) == {}


def test_qualitative_grid_with_and_without_everything(pictures, tmp_path):
    bare = FramePictures("frame 8", pictures.target, {"sa2h": pictures.target})
    assert_written(qualitative_figure([pictures, bare], tmp_path / "qualitative_0"))
    assert_written(qualitative_figure([bare], tmp_path / "deep" / "qualitative_1"))
    with pytest.raises(ValueError, match="no frame"):
        qualitative_figure([], tmp_path / "none")


def test_chi2_maps(pictures, tmp_path):
    assert_written(chi2_maps_figure(pictures, tmp_path / "pchi2_maps_0"))
    with pytest.raises(ValueError, match="no prediction"):
        chi2_maps_figure(FramePictures("empty", pictures.target), tmp_path / "none")


def test_pareto_front_against_brute_force():
    rng = np.random.default_rng(0)
    for n in (0, 1, 30):
        ms, error = rng.integers(1, 12, (2, n)).astype(float)
        points = set(zip(ms, error, strict=True))
        expected = {p for p in points if not any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points)}
        front = pareto_front(ms, error)
        assert {(ms[k], error[k]) for k in front} == expected
        assert len(front) == len(expected)


def test_error_against_runtime(tmp_path):
    rows = [("simulator, rays", r, 10.0 * r, metric, 1 / r) for r in (1, 2, 4) for metric in ("mae", "psnr")]
    rows += [("sa2h", "fp32", 5.0, "mae", 0.4), ("sa2h", "bf16", 3.0, "mae", np.inf), ("sa2h", "int8", 0.0, "mae", 1)]
    points = pd.DataFrame(rows, columns=["series", "setting", "ms", "metric", "error"])
    assert_written(error_vs_runtime(points, tmp_path / "error_vs_runtime", {"mae": 0.2}, "a test"))
    with pytest.raises(ValueError, match="lack the columns"):
        error_vs_runtime(points.drop(columns="ms"), tmp_path / "none")
    with pytest.raises(ValueError, match="no finite point"):
        error_vs_runtime(points[points["ms"] == 0], tmp_path / "none")


def test_neighbouring_colours_differ_in_grey():
    grey = [np.dot([int(c[k : k + 2], 16) for k in (1, 3, 5)], [0.299, 0.587, 0.114]) for c in COLOURS[:4]]
    assert min(abs(np.diff(grey))) > 8
