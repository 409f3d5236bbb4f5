"""Error against run time, of a tiny simulator and of tiny networks, measured, interrupted and refused."""

import math
import shutil
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch
from mlflow import MlflowClient
from scipy import stats

from ablate.anatomy import Scene, load_tissues
from ablate.command.compose import jobs_of
from ablate.dataset import Part, label_values, network_inputs
from ablate.metrics import mae, psnr
from ablate.networks import Space
from ablate.networks.spec import OF_SURFACES
from ablate.numerics.precision import bench, generated
from ablate.numerics.precision import task as module
from ablate.numerics.precision.bench import bench_of
from ablate.numerics.precision.errors import (
    Frames,
    envelope_rms,
    mean_errors,
    relative_change,
    with_histogram_of,
    worse_than,
)
from ablate.numerics.precision.figures import renderers
from ablate.numerics.precision.worth import worth
from ablate.pretrained import load
from ablate.publish import default_uri
from ablate.settings.study import ConfigurationError
from ablate.sources.prepare import prepare_data
from ablate.sources.source import source_of
from ablate.storage import digest, read_json, write_json
from ablate.study.work import do
from ablate.training import Engine, TrainingPrecision, generate, load_generator, open_engine
from ablate.ultrasound import ConvexProbe, Simulator, SimulatorSettings, fan_mask, scan_converter
from support.studies import run as run_command

TINY = ("preset=tiny", "training.steps=2", "evaluation.pictures=1")


def run(*arguments: str) -> int:
    return run_command("task=precision", *TINY, *arguments)


@pytest.fixture(scope="module", autouse=True)
def _small() -> Iterator[None]:
    """Few rays; eager only, because exporting takes long."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "RAYS", (1, 2, 4))
        patch.setattr(bench, "REFERENCE_RAYS", 32)
        patch.setattr(bench, "LAYERS", (1, 2))
        patch.setattr(generated, "missing_for", lambda e, _: None if e is Engine.eager else "what a test has not")
        yield


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory, _small: None) -> Path:
    """A finished run, one of other pairs, one without its weights, and the outcome of the task beside them."""
    runs = tmp_path_factory.mktemp("runs")
    (job,) = jobs_of([f"runs_dir={runs}", *TINY])
    do(job)
    about = read_json(job.folder / "training.json")
    about["identity"]["data"]["dataset"]["seed"] = 1
    about["hash"] = digest(about["identity"])
    elsewhere = runs / "elsewhere" / f"{job.label}-seed0-{about['hash'][:8]}"
    shutil.copytree(job.folder, elsewhere)
    write_json(elsewhere / "training.json", about)
    shutil.copytree(job.folder, runs / "bare" / job.folder.name, ignore=shutil.ignore_patterns("*.ckpt"))
    with (runs / "printed.txt").open("w") as file, redirect_stdout(file):
        assert run(f"runs_dir={runs}") == 0
    return runs


def test_simulator_and_runs_are_measured(trained: Path) -> None:
    printed = (trained / "printed.txt").read_text()
    assert "1 trained run; 1 left out, they learned from other data; 1 left out, without a checkpoint" in printed
    assert "left out, engine exported: needs what a test has not." in printed
    assert "With half of its" in printed
    points = pd.read_csv(trained / "precision" / "precision.csv", dtype={"setting": str})
    assert list(points.columns) == ["series", "setting", "ms", "metric", "error", "worse_lower", "worse_upper"]
    assert (points["ms"] > 0).all()
    assert not points["error"].isna().any()
    assert not points.duplicated(["series", "setting", "metric"]).any()
    rays = points[points["series"] == "simulator, rays"]
    assert list(dict.fromkeys(rays["setting"])) == ["1", "2", "4"]
    assert set(rays["metric"]) == {"envelope_rms", "mae", "psnr", "pchi2", "mae_smooth"}
    scanlines = points[points["series"] == "simulator, scanlines"]
    assert list(dict.fromkeys(scanlines["setting"])) == ["8", "16", "32", "64"]
    assert set(scanlines[scanlines["metric"] == "envelope_rms"]["setting"]) == {"32"}, "one grid has the reference's"
    network = points[points["series"] == "sa2h"]
    assert "width 0.05, fp32, eager, seed 0" in set(network["setting"])
    assert "envelope_rms" not in set(network["metric"])

    details = pd.read_csv(trained / "precision" / "details.csv", dtype=str)
    stages = details[(details["table"] == "stage") & (details["setting"] == "width 0.05, fp32, eager, seed 0")]
    paid = stages.set_index("quantity")["value"].astype(float)
    assert set(paid.index) == {"segmentation", "attenuation", "grain", "network"}
    whole = network[network["setting"] == "width 0.05, fp32, eager, seed 0"]["ms"].iloc[0]
    assert paid.sum() == pytest.approx(whole), "all maps are paid for"
    assert {"reference", "convergence", "limit", "stage"} == set(details["table"])
    assert all((trained / "precision" / f"{name}.png").exists() for name in ("precision", "renderers"))
    combined = points[points["setting"] == "rays 2, layers 1"]
    assert set(combined["series"]) == {"simulator, combined", "simulator, other scatterers"}
    of_frames = pd.read_csv(trained / "precision" / "frames.csv", dtype={"setting": str})
    means = of_frames[of_frames["metric"] == "mae"].groupby(["series", "setting"])["error"].mean()
    mae_of = points[points["metric"] == "mae"].set_index(["series", "setting"])["error"]
    assert {series for series, _ in means.index} == {"simulator, other scatterers", "formula", "sa2h"}
    pd.testing.assert_series_equal(means, mae_of[means.index], check_names=False)

    client = MlflowClient(default_uri(trained))
    (recorded,) = client.search_runs(["1"], "attributes.run_name = 'precision'")
    assert recorded.info.status == "FINISHED"
    assert recorded.data.tags["scene"] == "fetal"
    assert recorded.data.metrics["order/envelope_rms"] > 0
    kept = {a.path for a in client.list_artifacts(recorded.info.run_id)}
    assert kept >= {"precision.csv", "details.csv", "summary.txt", "precision.png", "vector"}


def test_errors_are_to_the_reference_on_the_test_frames(trained: Path) -> None:
    (job,) = jobs_of([f"runs_dir={trained}", *TINY])
    s = job.settings
    pairs = job.data.pairs
    frames = pairs.frames(Part.test)[[0, -1]]
    scene, _ = source_of(s).scene()
    exact, coarse = (
        Simulator(scene, s.probe, replace(s.simulator, rays=rays, time_gain_db=job.data.time_gain_db))
        for rays in (32, 4)
    )
    targets = [exact.render(pairs.poses[f], s.dataset.seed).image for f in frames]
    points = pd.read_csv(trained / "precision" / "precision.csv", dtype={"setting": str})
    errors = points.set_index(["series", "setting", "metric"])["error"]
    images = [coarse.render(pairs.poses[f], s.dataset.seed).image for f in frames]
    assert errors["simulator, rays", "4", "psnr"] == pytest.approx(np.mean([*map(psnr, images, targets)]))
    assert errors["simulator, rays", "4", "mae"] == pytest.approx(np.mean([*map(mae, images, targets)]))
    other = [coarse.render(pairs.poses[f], s.dataset.seed + 1).image for f in frames]
    assert errors["simulator, other scatterers", "rays 4", "mae"] == pytest.approx(np.mean([*map(mae, other, targets)]))

    generator = load_generator(job.folder / "last.ckpt")
    beams = [exact.render(pairs.poses[f], s.dataset.seed + 1).beam for f in frames]  # grain is not that of the target
    stacked = {name: np.stack([getattr(b, name) for b in beams]) for name in ("segmentation", "attenuation", "grain")}
    stacked |= {name: np.stack([value] * 2) for name, value in pairs.positions(Space.beam).items()}
    everywhere = np.ones(s.simulator.beam_shape, bool)
    inputs = network_inputs(stacked, label_values(scene.tissues, s.encoding), everywhere)
    converter = scan_converter(s.probe, s.simulator.beam_shape, s.simulator.image_shape)
    given = torch.from_numpy(everywhere), torch.from_numpy(frames), TrainingPrecision.fp32, converter
    made = generate(generator, inputs, *given)
    label = "sa2h", "width 0.05, fp32, eager, seed 0"
    assert errors[*label, "psnr"] == pytest.approx(np.mean([*map(psnr, made, targets)]))


def test_inputs_are_the_maps_of_the_pairs(trained: Path) -> None:
    (job,) = jobs_of([f"runs_dir={trained}", *TINY])
    prepare_data(job.settings, job.data, job.identity["data"], OF_SURFACES)
    chosen, names = bench_of(job), ("segmentation", *sorted(OF_SURFACES), "depth", "lateral", "grain")
    maps, ms = generated.make_inputs(chosen, names, Space.beam)
    assert set(maps) == set(names)
    for name in names:
        stored = job.data.pairs.read(name, chosen.frames, Space.beam)
        np.testing.assert_allclose(maps[name], stored, atol=0.51 / 255 if name in OF_SURFACES else 0)
        assert len(np.unique(stored)) > 3
    assert set(ms) == {"segmentation", "grain", *OF_SURFACES}
    of_image, paid = generated.make_inputs(chosen, ("segmentation", "compensated"), Space.image)
    assert of_image["compensated"].shape[1:] == job.settings.simulator.image_shape
    assert (of_image["compensated"] > 0).mean() > 0.2
    assert set(paid) == {"segmentation", "compensated"}


@pytest.mark.parametrize(("working", "failing"), [("fp32", "bf16"), ("bf16", "fp32")])
def test_an_engine_that_fails_costs_its_points_alone(
    trained: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, working: str, failing: str
) -> None:
    def fails(*arguments: Any) -> Any:
        if arguments[-2] != working:
            raise RuntimeError("no such kernel")
        return open_engine(*arguments)

    monkeypatch.setattr(generated, "open_engine", fails)
    monkeypatch.setattr(generated, "chosen_precision", lambda *_: TrainingPrecision.bf16)
    (job,) = jobs_of([f"runs_dir={trained}", *TINY])
    chosen = bench_of(job)
    ((reference,), _) = bench.render_all(chosen, [chosen.simulator], (chosen.seed,), "reference")[0]
    planned = generated.schedule_of(generated.comparable_runs(job)[0], job.settings)
    planned.append(planned[-1])  # a second one in bf16, as an engine is
    found = generated.measure_generators(chosen, planned, job.settings, reference)
    points, details = found.points, found.details
    assert f"left out, sa2h, width 0.05, {failing}, eager, seed 0: no such kernel" in caplog.text
    assert {row[1] for row in points if "eager" in row[1]} == {f"width 0.05, {working}, eager, seed 0"}
    limits = [row for row in details if row[0] == "limit"]
    assert working == "fp32" or not limits, "nothing is compared with fp32 where fp32 has failed"


def test_without_a_trained_run_the_simulator_is_measured_alone_also_after_an_interruption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    arguments = f"runs_dir={tmp_path}", "evaluation.timed_frames=1"
    with monkeypatch.context() as patch:
        patch.setattr(module, "measure_simulator", stopped)
        with pytest.raises(SystemExit, match="interrupted; the same command measures everything again"):
            run(*arguments)
    client = MlflowClient(default_uri(tmp_path))
    (recorded,) = client.search_runs(["1"], "attributes.run_name = 'precision'")
    assert recorded.info.status == "KILLED"
    assert run(*arguments) == 0
    assert f"no trained run in {tmp_path}: the simulator alone" in capsys.readouterr().out
    points = pd.read_csv(tmp_path / "precision" / "precision.csv")
    assert set(points["series"][~points["series"].str.startswith("simulator")]) == {"formula"}
    assert not (tmp_path / "data" / "fetal").exists(), "no pair is simulated for it"


def test_shipped_networks_are_named_and_so_is_what_they_lack(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A default frame is such as they were trained on: without a run of one's own they are measured all the same."""

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    shipped = generated.Candidate("shipped sa2h", ("width 0.25",), "sa2h", lambda _: pytest.fail("is not yet run"))
    monkeypatch.setattr(module, "shipped_candidates", lambda _: [shipped])
    monkeypatch.setattr(module, "measure_simulator", stopped)
    with pytest.raises(SystemExit):
        run(f"runs_dir={tmp_path}", "evaluation.timed_frames=1")
    printed = capsys.readouterr().out
    assert f"no trained run in {tmp_path}; shipped sa2h." in printed
    assert "left out, engine exported: needs what a test has not." in printed


def test_what_has_no_scene_to_measure_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match="task=precision: pairs made elsewhere have no scene"):
        run(f"runs_dir={tmp_path}", "scene=pairs", f"scene.folder={tmp_path}")

    def broken(_: object) -> None:
        raise ValueError("liver.obj: a hole of 12 mm")

    monkeypatch.setattr(module, "bench_of", broken)
    with pytest.raises(ConfigurationError, match=r"liver\.obj: a hole of 12 mm"):
        run(f"runs_dir={tmp_path}")
    assert not (tmp_path / "precision").exists()


def test_the_error_of_an_envelope_is_relative() -> None:
    random = np.random.default_rng(0)
    reference = random.rayleigh(size=(40, 30)).astype(np.float32)
    assert envelope_rms(1.25 * reference, reference) == pytest.approx(0.25, rel=1e-6)
    noise = random.normal(size=reference.shape)
    expected = np.linalg.norm(noise) / np.linalg.norm(reference)
    assert envelope_rms(reference + noise, reference) == pytest.approx(expected, rel=1e-6)
    silent = np.zeros_like(reference)
    assert envelope_rms(silent, silent) == 0
    assert envelope_rms(reference, silent) == math.inf


def test_mean_errors_of_identical_and_of_incomparable_frames() -> None:
    random = np.random.default_rng(0)
    images = random.integers(0, 256, (3, 60, 80), dtype=np.uint8)
    envelopes = random.random((3, 20, 10), np.float32)
    probe = ConvexProbe()
    same = mean_errors(Frames(images, envelopes), Frames(images, envelopes), probe)
    assert same == {"envelope_rms": 0, "mae": 0, "psnr": math.inf, "pchi2": 0, "mae_smooth": 0}
    other = images.copy()
    other[0] ^= 1
    one = mean_errors(Frames(other), Frames(images, envelopes), probe)
    assert "envelope_rms" not in one
    assert one["mae"] == pytest.approx(1 / 3)
    assert one["psnr"] == pytest.approx(20 * math.log10(255)), "identical frames are left out of its mean"
    assert "envelope_rms" not in mean_errors(Frames(images, envelopes[:, :10]), Frames(images, envelopes), probe)


def test_the_interval_of_how_much_worse_a_renderer_is_is_the_paired_t_test_s() -> None:
    rng = np.random.default_rng(0)
    here, there = rng.normal(9, 1, 8), rng.normal(8, 1, 8)
    rows = [
        (series, "", metric, frame, sign * value)
        for metric, sign in (("mae", 1), ("psnr", -1))  # of which larger is better
        for series, values in (("mine", here), ("other", there))
        for frame, value in enumerate(values)
    ]
    told = worse_than(pd.DataFrame(rows, columns=module.OF_FRAMES), "other", "").set_index(["series", "metric"])
    ends = stats.ttest_rel(here, there).confidence_interval()
    for metric in ("mae", "psnr"):
        assert told.loc[("mine", metric), "worse"] == pytest.approx(np.mean(here - there))
        assert tuple(told.loc[("mine", metric), ["worse_lower", "worse_upper"]]) == pytest.approx(tuple(ends))
        assert tuple(told.loc[("other", metric)])[1:] == (0, 0, 0)


def test_the_renderers_of_the_figure_are_named_and_those_that_know_the_scatterers_are_not_among_them() -> None:
    points = [
        *(("simulator, rays", f"{n}", 10.0 + n, 1 / n) for n in (1, 2, 16)),
        ("simulator, combined", "rays 2, layers 1", 11.0, 0.4),
        *(("simulator, other scatterers", f"rays {n}", 10.0 + n, 2 + 1 / n) for n in (1, 2, 16, 64)),
        ("simulator, other scatterers", "layers 3", 25.9, 2 + 1 / 16),  # the data set's own, once more
        ("simulator, other scatterers", "layers 1", 15.0, 3.0),
        ("simulator, other scatterers", "rays 2, layers 1", 11.0, 3.5),
        ("formula", "segmentation, attenuation", 7.0, 6.0),
        ("sa2h", "width 0.25, bf16, eager, seed 0", 30.0, 4.1),
        ("sa2h", "width 0.25, bf16, exported, seed 0", 19.0, 4.1),
        ("sa2h", "width 0.25, bf16, exported, seed 1", 18.0, 4.2),
        ("sa2h", "width 0.25, fp32, exported, seed 0, image-space", 40.0, 5.0),
        ("shipped sa2h", "width 0.25, bf16, exported", 19.0, 3.9),
    ]
    errors = pd.DataFrame([(s, t, ms, "mae", e) for s, t, ms, e in points], columns=module.POINTS)
    rows = [(s, t, "mae", frame, e + frame) for s, t, _, e in points for frame in range(3)]
    worse = worse_than(pd.DataFrame(rows, columns=module.OF_FRAMES), "simulator, other scatterers", "rays 16")
    shown = renderers(errors.merge(worse.drop(columns="worse"), "left", ["series", "setting", "metric"]), "rays 16")
    names = (shown["series"] + " " + shown["setting"]).str.removeprefix("simulator, other scatterers ").str.strip()
    simulated = ["re-simulation", "1 ray", "2 rays", "1 layer", "2 rays, 1 layer"]
    assert names.tolist() == [*simulated, "formula", "sa2h bf16", "sa2h fp32", "shipped sa2h bf16"]
    assert shown.set_index("setting").loc["bf16", "ms"].tolist() == [19.0, 19.0], "the fastest engine of the first seed"
    assert shown.loc[0, ["worse_lower", "worse_upper"]].tolist() == [0, 0]
    assert shown.loc[1, "worse_lower"] == pytest.approx(1 - 1 / 16)


def test_a_shipped_network_is_measured_on_frames_such_as_it_was_trained_on() -> None:
    shipped = load("sa2h")
    nothing = np.empty(0)
    scene = Scene((), load_tissues()["liver"], "liver alone")
    frames = bench.Bench(scene, shipped.probe, shipped.simulator, nothing, nothing, seed=0)
    compounded = replace(frames, simulator=replace(shipped.simulator, compound_angles=3))
    assert [c.series for c in generated.shipped_candidates(frames)] == ["shipped full", "shipped sa2h"]
    assert generated.shipped_candidates(compounded) == []
    assert generated.shipped_candidates(replace(frames, target="my_simulators.blurred")) == []


def test_what_a_curve_of_grey_levels_mends_does_not_count_against_ablates_simulator() -> None:
    """Frames of twice the grey level become the reference; black outside the fan stays."""
    probe = ConvexProbe()
    mask = fan_mask(probe, (32, 48))
    levels = np.random.default_rng(0).integers(0, 128, (3, 32, 48), np.uint8) * mask
    brighter = with_histogram_of(Frames(2 * levels), Frames(levels), probe)
    np.testing.assert_array_equal(brighter.images, levels)


def test_every_ladder_holds_the_data_sets_own_setting() -> None:
    base = SimulatorSettings(rays=3, layers=2, scanlines=6, axial_samples=1)
    ladders = bench.ladders(base)
    values = {"rays": [1, 2, 3, 4], "layers": [1, 2], "scanlines": [2, 3, 6, 12], "axial_samples": [1, 2]}
    assert {name: list(ladder) for name, ladder in ladders.items()} == values
    assert all(ladder[getattr(base, name)] == base for name, ladder in ladders.items())
    of_rows = bench.ladders(SimulatorSettings(axial_samples=1000, samples_per_row=4))["axial_samples"]
    assert list(of_rows) == [248, 500, 1000, 2000], "the nearest multiples of the samples of a row"


def test_frames_of_several_angles_are_compared_with_those_of_fewer() -> None:
    base = SimulatorSettings(compound_angles=5)
    assert list(bench.ladders(base)["compound_angles"]) == [1, 3, 5]
    assert bench.combined(base)[-1] == {"rays": 2, "layers": 1, "compound_angles": 1}


@pytest.mark.parametrize(
    ("metric", "error", "other", "moved"),
    [
        *(("mae", 2.0, 2.1, 0.05), ("mae", 2.0, 1.9, 0.05), ("mae", 0.0, 0.0, 0), ("psnr", math.inf, math.inf, 0)),
        ("psnr", 40.0, 40.0 - 20 * math.log10(1.05), 0.05),
    ],
)
def test_how_far_a_reference_moves_an_error(metric: str, error: float, other: float, moved: float) -> None:
    assert relative_change(metric, error, other) == pytest.approx(moved)


def test_each_row_of_a_table_has_its_own_time() -> None:
    """Rows are sorted as text, and times were once in the order in which they were measured."""
    timed = {("second: sa2h", "exported"): 30.0, ("first: sa2h", "exported"): 23.0, ("first: sa2h", "eager"): 20.0}
    rows = [(*where, ms, "mae", 5.0) for where, ms in timed.items()]
    errors = module.tables(pd.DataFrame(rows, columns=module.POINTS), "rays 16")
    shown = errors["Error to the reference"]["ms"]
    assert {where: float(shown.loc[where]) for where in timed} == timed


def test_what_a_network_is_worth_is_told_by_its_trainings_and_its_fastest_engine() -> None:
    points = [
        ("simulator, rays", "16", 26.0, 0.1),  # knows the scatterers
        ("simulator, other scatterers", "rays 16", 26.0, 8.0),
        ("simulator, other scatterers", "rays 2", 12.0, 9.0),
        ("simulator, other scatterers", "layers 1", 9.0, 11.0),
        ("simulator, other scatterers", "rays 2, layers 1", 6.0, 13.0),
        ("formula", "segmentation, attenuation", 7.0, 14.0),
        ("sa2h", "width 0.25, fp32, eager, seed 0", 30.0, 9.9),
        ("sa2h", "width 0.25, bf16, eager, seed 0", 20.0, 10.0),
        ("sa2h", "width 0.25, bf16, exported, seed 0", 10.0, 10.1),
        ("sa2h", "width 0.25, bf16, eager, seed 1", 21.0, 10.4),
        ("nsa2h", "width 0.25, bf16, eager, seed 0", 5.0, 7.5),
    ]
    errors = pd.DataFrame([(s, t, ms, "mae_smooth", e) for s, t, ms, e in points], columns=module.POINTS)
    told = worth(errors, "rays 16").droplevel("metric")
    assert told.loc["sa2h"].tolist() == ["10.0", "2.20", "1 layer, 9.0 ms", "3.00", "2 rays, 12.0 ms", "1.2"]
    cheapest = "2 rays, 1 layer, 6.0 ms"
    assert told.loc["formula"].tolist() == ["7.0", "6.00", cheapest, "5.00", cheapest, "0.9"]
    assert told.loc["nsa2h"].tolist() == ["5.0", "-0.50", "none", "none", "none", "none"]
