"""A new metric is a function and one entry: every table, figure, caption and statistic shows it."""

import re
import sys
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from ablate import analysis
from ablate.analysis import RESIMULATION
from ablate.metrics import (
    METRICS,
    Direction,
    Group,
    Metric,
    Pair,
    Resimulation,
    Shown,
    choose_metrics,
    evaluate_image,
    metric_of,
    registry,
    shown_in,
)

VARIANTS = {"sa2h": (0, 0), "sa2h-att": (1, 0), "sa2h-noise": (0, 1), "sa2h-att-noise": (1, 1)}
SAID = {"att": "attenuation", "noise": "noise"}


def brightness(pair):
    return abs(float(pair.prediction.mean()) - float(pair.target.mean()))


NEW = Metric(
    name="brightness",
    label="Brightness error",
    unit="grey levels",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.pixel,
    decimals=1,
    shown=Shown.everywhere,
    of_image=brightness,
)


@pytest.fixture(params=["of the package", "of a user"])
def chosen(request, monkeypatch):
    """The metric among all others: as an entry of the registry, or behind a dotted path."""
    monkeypatch.setattr(registry, "_OWN", {})
    if request.param == "of the package":
        monkeypatch.setitem(METRICS, NEW.name, NEW)
        return [*choose_metrics(["psnr"]).values(), METRICS[NEW.name]]
    module = ModuleType("of_a_user")
    module.brightness_error = NEW
    monkeypatch.setitem(sys.modules, "of_a_user", module)
    return list(choose_metrics(["psnr", "of_a_user.brightness_error"]).values())


def scored(metrics):
    """Two components, three seeds, 12 frames of 6 sites; noise makes images brighter."""
    rng = np.random.default_rng(0)
    rows = []
    for variant, (att, noise) in {RESIMULATION: (0, 0), **VARIANTS}.items():
        for seed in (0,) if variant == RESIMULATION else (0, 1, 2):
            for frame in range(12):
                target = rng.integers(0, 200, (20, 20)).astype(np.uint8)
                image = target + np.uint8(3 * att + 12 * noise + seed + rng.integers(0, 4))
                values = evaluate_image(Pair(image, target, np.ones((20, 20), bool)), metrics)
                rows += [(variant, seed, frame, frame % 6, name, value) for name, value in values.items()]
    return pd.DataFrame(rows, columns=["variant", "seed", "frame", "site", "metric", "value"])


def test_a_function_that_a_user_names_is_a_column_of_the_screen_before_all_that_do_not_fit(monkeypatch):
    monkeypatch.setattr(registry, "_OWN", {})
    module = ModuleType("of_a_user")
    module.bias = brightness
    monkeypatch.setitem(sys.modules, "of_a_user", module)
    monkeypatch.setattr(registry, "code_digest", lambda _: "")
    chosen = choose_metrics(["all", "of_a_user.bias"])
    assert "bias" in shown_in(Shown.screen)
    assert "bias" in shown_in(Shown.report)
    shown = [name for name in shown_in(Shown.screen) if name in chosen]
    rows = [("sa2h", 0, frame, frame, name, 1.0 + frame) for name in shown for frame in range(4)]
    per_image = pd.DataFrame(rows, columns=["variant", "seed", "frame", "site", "metric", "value"])
    columns, *_ = analysis.to_text(analysis.comparison_table(per_image), 60).split("-----")
    assert "bias" in columns


def test_a_new_metric_is_everywhere_by_its_one_entry(chosen, tmp_path, monkeypatch):
    name = "ablate.analysis.figures.boxplot_figure.save_figure"
    monkeypatch.setattr(name, lambda _figure, stem: [stem.with_suffix(".png")])  # it is laid out, not written
    assert metric_of("brightness") is NEW
    assert all("brightness" in shown_in(place) for place in Shown.everywhere)
    per_image = scored(chosen)

    table = analysis.comparison_table(per_image)
    assert set(table["metric"]) == {"psnr", "brightness"}
    best = table[table["best"] & (table["metric"] == "brightness")]
    assert best["variant"].tolist() == ["sa2h"], "lower is better"
    assert "Brightness error (grey levels) ↓" in analysis.to_markdown(table)
    assert re.search(r"Brightness\n.*error\n.*\(grey\) ↓\n-+\n", analysis.to_text(table))
    assert "the floor for Brightness error" in " ".join(analysis.to_text(table).split())
    assert r"Brightness error (grey levels) $\downarrow$" in analysis.to_latex(table)
    assert "brightness_mean" in analysis.wide_table(table)

    paired, claims = analysis.paired_table(per_image, resamples=50), analysis.seed_claims(per_image)
    assert set(paired["metric"]) == set(claims["metric"]) == {"psnr", "brightness"}
    components = {label: dict(zip(SAID.values(), levels, strict=True)) for label, levels in VARIANTS.items()}
    design = analysis.find_design(components, tuple(SAID.values()))
    effects = analysis.effects_table(analysis.run_means(per_image, None, design), design)
    assert effects.set_index(["metric", "effect"]).loc[("brightness", "noise"), "estimate"] == pytest.approx(12, abs=2)

    assert analysis.boxplot_panels(per_image, ["brightness"], tmp_path / "boxplot_brightness", paired=paired)
    assert "Brightness error" in analysis.caption("boxplots", ["brightness"])
    results = analysis.StudyResults(per_image=per_image)
    page = analysis.write_report(tmp_path / "report.html", results, "new").read_text("utf-8")
    shown = page.partition("<details>")[0]
    assert "Brightness error (grey levels)" in shown, "it is among those that are not folded"


def test_a_metric_without_an_entry_is_shown_under_its_name_and_not_judged():
    unknown = metric_of("never_seen")
    assert (unknown.title, unknown.better, unknown.resimulation) == ("never_seen", Direction.none, Resimulation.none)
    assert np.isnan(unknown.badness(1.0))
