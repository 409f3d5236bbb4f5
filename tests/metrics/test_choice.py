"""Metrics by name, by the name of a set, by a path; the page on metrics says what is there, and its example works."""

import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ablate import user_code
from ablate.metrics import METRIC_SETS, METRICS, Pair, choose_metrics, evaluate_image
from ablate.user_code import code_digest

PAGE = (Path(__file__).parents[2] / "docs" / "metrics.md").read_text()


def test_names_sets_and_lists():
    assert choose_metrics().keys() == METRICS.keys() - {"envelope_rms", "ms_per_frame", "parameters"}
    paper = choose_metrics("paper")
    assert {name for name, metric in paper.items() if metric.of_image} == {"psnr", "mae", "pchi2"}
    assert {name for name, metric in paper.items() if metric.of_set} == {"fid", "fd_speckle"}
    assert choose_metrics(["mae", "paper", "mae"]).keys() == paper.keys()
    assert choose_metrics(["noise_sd"])["noise_sd"].of_draws is not None


def test_two_of_one_name_are_refused(monkeypatch, tmp_path):
    for module in ("first_of_two", "second_of_two"):
        code = "def sharpness(pair):\n    return 0.0\n\n\nmae = floor_mae = error_upper = sharpness\n"
        (tmp_path / f"{module}.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    assert choose_metrics(["first_of_two.sharpness"] * 2).keys() == {"sharpness"}
    with pytest.raises(ValueError, match="two of them are called sharpness"):
        choose_metrics(["first_of_two.sharpness", "second_of_two.sharpness"])
    with pytest.raises(ValueError, match="mae is the name of another metric"):
        choose_metrics(["first_of_two.mae"])
    with pytest.raises(ValueError, match="floor_mae is the name of another metric"):  # what re-simulation scores
        choose_metrics(["first_of_two.floor_mae"])
    with pytest.raises(ValueError, match=r"error_upper is the name of .* an end of an interval"):
        choose_metrics(["first_of_two.error_upper"])


def test_the_code_of_a_metric_is_that_of_the_moment_when_it_was_chosen(monkeypatch, tmp_path):
    (tmp_path / "edit_later.py").write_text("def bias(pair):\n    return 1.0\n")
    monkeypatch.syspath_prepend(tmp_path)
    choose_metrics(["edit_later.bias"])
    (tmp_path / "edit_later.py").write_text("def bias(pair):\n    return 2.0\n")
    scored_by = code_digest("edit_later.bias")
    user_code._digest.cache_clear()
    assert scored_by != code_digest("edit_later.bias")


def test_no_column_of_a_table_stands_for_two(monkeypatch, tmp_path):
    code = "import ablate\n\nnear = ablate.metrics.Metric('near', label='PSNR', unit='dB', of_image=lambda pair: 5.0)\n"
    (tmp_path / "of_columns.py").write_text(code + "def seed(pair):\n    return 0.0\n\n\ndata = seed\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=r"two of them have the title PSNR \(dB\)"):
        choose_metrics(["of_columns.near"])
    for name in ("seed", "data"):
        with pytest.raises(ValueError, match=rf"{name} is the name of .* a column of runs\.csv"):
            choose_metrics([f"of_columns.{name}"])


def test_a_metric_of_the_draws_alone_is_measured_where_there_are_draws(monkeypatch, tmp_path, make_frame):
    code = "import ablate\n\nspread = ablate.metrics.Metric('spread', of_draws=lambda pair: pair.draws.std())\n"
    (tmp_path / "of_draws.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    chosen = choose_metrics(["of_draws.spread"])
    frame = make_frame(0)
    pair = Pair(frame.image, frame.image, frame.mask)
    assert evaluate_image(pair, chosen.values()) == {}
    draws = np.stack([frame.image, frame.image // 2])
    assert evaluate_image(replace(pair, draws=draws), chosen.values()) == {"spread": pytest.approx(draws.std())}


def test_the_page_names_every_metric_and_no_other():
    described = set(re.findall(r"`(\w+)`", PAGE))
    assert set(METRIC_SETS["all"]) <= described
    rows = re.findall(r"^\| `(\w+)` \|", PAGE, re.M)
    fans = {"psnr_fan", "mae_fan", "pchi2_fan", "pchi2_tissue"}
    kernels = {"kid", "kd_speckle"}  # beside the Frechet distance of the same features
    assert set(rows) | fans | kernels == set(METRIC_SETS["all"])


def test_the_example_of_the_page_works(monkeypatch, tmp_path, make_frame):
    (example,) = re.findall(r"```python\n# (\w+)\.py\n(.*?)```", PAGE, re.S)
    (asked,) = re.findall(r"'metrics=\[([\w.,]+)\]'\n\nIt is imported", PAGE)
    (tmp_path / f"{example[0]}.py").write_text(example[1])
    monkeypatch.syspath_prepend(tmp_path)
    chosen = choose_metrics(asked.split(","))
    assert chosen.keys() == {*METRIC_SETS["all"], "bias"}
    frame = make_frame(0)
    brighter = np.where(frame.mask, np.minimum(frame.image, 200) + 7, 0).astype(np.uint8)
    values = evaluate_image(Pair(brighter, frame.image, frame.mask), chosen.values())
    expected = np.mean(brighter[frame.mask].astype(float) - frame.image[frame.mask])
    assert values["bias"] == pytest.approx(expected)
    sys.modules.pop(example[0])
