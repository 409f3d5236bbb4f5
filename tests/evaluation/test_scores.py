"""Scores of a run: chosen metrics, FID by a file, what is left out in words, re-simulation computed once."""

import hashlib
import math
import shutil
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from ablate.anatomy import load_tissues
from ablate.command.checks import check
from ablate.command.compose import jobs_of
from ablate.dataset import Part
from ablate.evaluation import (
    ImageSource,
    Scorer,
    Scores,
    averaged,
    baselines,
    joined,
    resimulation_images,
    score_run,
    tissue_labels,
)
from ablate.evaluation.scorer import _distances
from ablate.evaluation.scores import not_computed
from ablate.metrics import (
    METRICS,
    FeatureKind,
    Metric,
    Pair,
    SetDistance,
    choose_metrics,
    crps,
    features,
    frechet_distance,
    load_inception,
    mae,
    noise_sd,
    speckle_features,
)
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.sources.data_set import DataSet as Data
from ablate.sources.data_set import maps_needed
from ablate.sources.prepare import prepare_data
from ablate.study.job import Job
from ablate.study.run import run_of
from ablate.study.work import do, scorer
from ablate.threads import torch_threads

TINY = ["preset=tiny", "simulator.image_shape=[512,710]", "dataset.test=0.4", "training.steps=2", "training.crop=32"]
TINY += ["training.validate_every=0"]


def job(runs: Path, *more: str) -> Job:
    return jobs_of([f"runs_dir={runs}", *TINY, *more])[0]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("runs")


def test_a_metric_of_ones_own_is_never_asked_in_two_threads(
    data: Data, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    code = (
        "import threading\n\nseen = set()\n\n\ndef mine(pair):\n    seen.add(threading.get_ident())\n    return 0.0\n"
    )
    (tmp_path / "of_threads.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    settings = StudySettings()
    of_mine = Scorer(data.pairs, data.tissues, settings.probe, settings.evaluation, choose_metrics("of_threads.mine"))
    with torch_threads(4):
        of_mine.score(Part.test, lambda frames, _: data.pairs.read("target", frames), draws_noise=False)
    assert len(sys.modules["of_threads"].seen) == 1


@pytest.fixture(scope="module")
def data(runs: Path) -> Data:
    tiny = job(runs)
    return prepare_data(tiny.settings, tiny.data, tiny.identity["data"], maps_needed([tiny.settings.model]))


@pytest.fixture
def network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A small network that passes for Inception."""

    class Means(torch.nn.Module):
        def forward(self, x: torch.Tensor, return_features: bool = False) -> torch.Tensor:  # noqa: ARG002
            return torch.nn.functional.adaptive_avg_pool2d(x[:, :1].float(), (2, 2)).flatten(1)

    path = tmp_path / "net.pt"
    with pytest.warns(DeprecationWarning, match="torch.jit"):
        torch.jit.save(torch.jit.script(Means()), str(path))
    monkeypatch.setattr(features, "INCEPTION_SHA256", hashlib.sha256(path.read_bytes()).hexdigest())
    return path


def scored(data: Data, job: Job, images_of: ImageSource, *names: str) -> Scores:
    chosen = Scorer(
        data.pairs, data.tissues, job.settings.probe, job.settings.evaluation, choose_metrics(names or "all")
    )
    return chosen.score(Part.test, images_of, draws_noise=False)


def score(settings: StudySettings, data: Data) -> Scores:
    chosen = scorer(settings, data)
    beside = baselines(chosen, settings.model)[:1]  # re-simulation
    return score_run(chosen, resimulation_images(data.pairs), draws_noise=True, beside=beside)


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> list[Part]:
    """The parts that were scored, once for each time."""
    parts: list[Part] = []
    whole = Scorer.score

    def counted(self: Scorer, part: Part, *of: Any, **more: Any) -> Scores:
        parts.append(part)
        return whole(self, part, *of, **more)

    monkeypatch.setattr(Scorer, "score", counted)
    return parts


def test_values_are_those_of_each_frame_alone_however_many_threads(runs: Path, data: Data) -> None:
    again, frames = resimulation_images(data.pairs), data.pairs.frames(Part.test)
    scores = scored(data, job(runs), again)
    threads = torch.get_num_threads()
    torch.set_num_threads(4)
    try:
        pd.testing.assert_frame_equal(scores.per_image, scored(data, job(runs), again).per_image)
    finally:
        torch.set_num_threads(threads)
    images, targets = (data.pairs.read(name, frames) for name in ("resimulation", "target"))
    of_mae = scores.per_image[scores.per_image["metric"] == "mae"]
    assert of_mae["frame"].tolist() == frames.tolist()
    assert of_mae["value"].tolist() == [mae(a, b) for a, b in zip(images, targets, strict=True)]
    described = [speckle_features(pictures, data.pairs.mask()) for pictures in (images, targets)]
    assert scores.scalars["fd_speckle"] == pytest.approx(frechet_distance(*described))
    assert scores.scalars["fd_speckle_lower"] < scores.scalars["fd_speckle"] < scores.scalars["fd_speckle_upper"]


def test_tissue_is_all_but_fluid_and_gas() -> None:
    table = load_tissues()
    labels = tissue_labels(tuple(table.values()))
    fluid_or_gas = {"coupling_gel", "amniotic_fluid", "urine", "bile", "csf", "blood", "gas"}
    assert [name in fluid_or_gas for name in table] == [k + 1 not in labels for k in range(len(table))]


def test_what_no_frame_has_a_value_for_is_named(runs: Path, data: Data) -> None:
    chosen, settings = choose_metrics(("mae", "thin_contrast", "pchi2_tissue")), job(runs).settings
    of_no_tissue = Scorer(data.pairs, (), settings.probe, settings.evaluation, chosen)
    scores = of_no_tissue.score(Part.test, resimulation_images(data.pairs), draws_noise=False)
    assert list(scores.scalars) == ["mae"]
    (note,) = scores.notes
    assert note.startswith("pchi2_tissue and thin_contrast: not computed, as no frame has what is needed (bone, ")


def test_identical_pictures_are_counted_and_left_out_of_the_mean(runs: Path, data: Data) -> None:
    first = int(data.pairs.frames(Part.test)[0])

    def mostly_right(frames: np.ndarray, _: int) -> np.ndarray:
        right = np.asarray(frames) != first
        images = [data.pairs.read(name, frames) for name in ("target", "resimulation")]
        return np.where(right[:, None, None], *images)

    scores = scored(data, job(runs), mostly_right, "psnr", "mae")
    others = len(data.pairs.frames(Part.test)) - 1
    assert np.isinf(scores.per_image["value"]).sum() == others
    images = [data.pairs.stored(name, first) for name in ("resimulation", "target")]
    squares = np.mean((images[0].astype(float) - images[1]) ** 2)
    assert scores.scalars["psnr"] == pytest.approx(10 * math.log10(255**2 / squares))
    perfect = scored(data, job(runs), lambda frames, _: data.pairs.read("target", frames), "psnr", "mae")
    assert perfect.scalars == {"mae": 0.0}


def brightest(pair: Pair) -> float:
    """A user's metric that has no value for a black picture."""
    return math.nan if pair.prediction.max() == 0 else float(pair.prediction.max())


def endless(pair: Pair) -> float:
    return math.inf if pair.prediction.max() == 0 else 1.0


def failing(pair: Pair) -> float:
    raise ZeroDivisionError(f"of {pair.target.shape}")


def test_a_metric_of_ones_own_may_be_nan_and_the_frame_is_named(
    runs: Path, data: Data, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    last = int(data.pairs.frames(Part.test)[-1])

    def dark(frames: np.ndarray, _: int) -> np.ndarray:
        return data.pairs.read("target", frames) * (np.asarray(frames) != last)[:, None, None].astype(np.uint8)

    monkeypatch.setitem(sys.modules, "of_mine", sys.modules[__name__])
    scores = scored(data, job(runs), dark, "of_mine.brightest")
    assert scores.per_image.loc[scores.per_image["value"].isna(), "frame"].tolist() == [last]
    assert caplog.messages == [f"brightest is NaN on test frame {last}: not in its mean"]
    assert scores.scalars["brightest"] > 0
    caplog.clear()
    assert scored(data, job(runs), dark, "of_mine.endless", "psnr").scalars["endless"] == 1.0
    assert caplog.messages == [f"endless is infinite on test frame {last}: not in its mean"]
    with pytest.raises(ZeroDivisionError) as raised:
        scored(data, job(runs), dark, "of_mine.failing")
    assert "by the metric failing" in raised.value.__notes__


UNREPEATED = """
import numpy as np
calls, seen = [], []

def draws_numbers(pair):
    return pair.prediction[np.random.randint(0, 500, 40), 300].mean()

def counts_calls(pair):
    calls.append(1)
    return len(calls) / 100

def compares_with_the_largest(pair):
    seen.append(pair.prediction.mean(dtype=float) * (1 + len(seen)))
    return pair.prediction.mean() / max(seen)

def rounds_otherwise(pair):
    calls.append(1)
    return 1 / 3 + 1e-12 * len(calls)

def nothing(pair):
    return None

def not_a_number(pair):
    return float("nan")
"""


def test_a_metric_that_gives_another_value_when_it_is_asked_again_is_noted(
    runs: Path, data: Data, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "of_chance.py").write_text(UNREPEATED)
    monkeypatch.syspath_prepend(tmp_path)
    unsteady = ["draws_numbers", "counts_calls", "compares_with_the_largest"]
    names = [f"of_chance.{name}" for name in (*unsteady, "rounds_otherwise", "nothing", "not_a_number")]
    of_mine = scorer(replace(job(runs).settings, metrics=[*names, "psnr"]), data)
    scores = score_run(of_mine, lambda frames, _: data.pairs.read("resimulation", frames), draws_noise=False)
    assert list(scores.unrepeated) == unsteady
    for name in unsteady:
        (note,) = scores.of_metric(name).notes
        assert note.startswith(f"{name}: ")
        assert "when it was asked again; it draws random numbers, or keeps what it has seen" in note
    assert not scores.of_metric("psnr").notes
    assert joined([scores.of_metric(name) for name in ("psnr", *unsteady)]).unrepeated == scores.unrepeated


def test_fid_is_computed_with_a_file_and_kept_with_its_interval(runs: Path, data: Data, network: Path) -> None:
    with_file = job(runs, f"evaluation.inception={network}", "metrics=[fid,kid,psnr]")
    check([with_file])
    scores = score(with_file.settings, data)
    for name in ("test/fid", "test/kid", "val/fid", "test/floor_fid"):
        assert np.isfinite(scores.scalars[name])
    assert scores.scalars["test/fid_lower"] < scores.scalars["test/fid"] < scores.scalars["test/fid_upper"]
    assert scores.scalars["test/fid"] == pytest.approx(scores.scalars["test/floor_fid"], rel=1e-9)
    assert scores.notes == ()
    features, frames = load_inception(network), data.pairs.frames(Part.test)
    seen = [features(data.pairs.read(name, frames)) for name in ("resimulation", "target")]
    assert scores.scalars["test/fid"] == pytest.approx(frechet_distance(*seen), rel=1e-9)


@pytest.mark.parametrize(
    ("shape", "fan", "frames", "with_network", "missing", "note"),
    [
        ((512, 600), slice(0, 200), 4, True, set(), ""),
        ((512, 600), slice(0, 200), 4, False, {"fid", "kid"}, "no Inception weights were given"),
        ((511, 600), slice(0, 200), 4, True, {"fid", "kid"}, "frames of 511 x 600 px are smaller than the 512 px"),
        ((512, 600), slice(0, 47), 4, True, {"fd_speckle", "kd_speckle"}, "fewer than two patches of 48 x 48 px"),
        ((512, 60), slice(0, 48), 1, True, {"fid", "kid", "fd_speckle", "kd_speckle"}, "frames of 512 x 60 px"),
    ],
)
def test_distances_that_frames_do_not_allow_are_left_out_in_words(
    shape: tuple[int, int], fan: slice, frames: int, with_network: bool, missing: set[str], note: str
) -> None:
    mask = np.zeros(shape, bool)
    mask[fan] = True
    reasons = not_computed(choose_metrics().values(), mask, frames, (lambda images: images) if with_network else None)
    assert reasons.keys() == missing
    assert note in " ".join(reasons.values())


def test_a_distance_of_ones_own_changes_no_feature_for_others() -> None:
    rng, sites = np.random.default_rng(0), np.arange(20) // 2

    def mine(rendered: np.ndarray, wanted: np.ndarray) -> float:
        torch.from_numpy(rendered).mul_(0)
        wanted -= wanted.mean(0)
        return 0.0

    own = Metric("mine", of_set=SetDistance(FeatureKind.speckle, mine))
    package = [METRICS[name] for name in ("fd_speckle", "kd_speckle")]
    batches = [(rng.normal(size=(40, 3)), rng.normal(1, size=(40, 3)))]
    alone = _distances(package, batches, sites)
    assert _distances([own, *package], batches, sites).items() >= alone.items()


def test_resimulation_is_scored_once_for_a_data_set(runs: Path, data: Data, calls: list[Part]) -> None:
    settings = job(runs, "metrics=[mae,noise_sd,psnr]").settings
    first = score(settings, data)
    assert len(calls) == 4, "two parts, a model and re-simulation each"
    second = score(settings, data)
    assert len(calls) == 6
    pd.testing.assert_frame_equal(first.per_image, second.per_image)
    assert first.scalars == second.scalars
    assert first.scalars["test/floor_noise_sd"] > 0
    score(job(runs, "metrics=mae").settings, data)
    assert len(calls) == 8, "what is known of a metric is known beside any others"
    more = score(job(runs, "metrics=[mae,mae_fan]").settings, data)
    assert len(calls) == 12, "another metric, other scores"
    assert more.scalars["test/floor_mae"] == first.scalars["test/floor_mae"]
    for kept in (data.pairs.folder / "baselines").glob("*.json"):
        kept.write_text("{")
    third = score(settings, data)
    assert len(calls) == 16, "damaged files are made again"
    assert third.scalars == first.scalars
    pd.testing.assert_frame_equal(third.per_image, first.per_image)


def reads_draws(pair: Pair) -> float:
    """A user's metric that is no metric of draws, but would read them where it finds them."""
    return float(pair.prediction.mean()) if pair.draws is None else -1.0


def test_no_score_depends_on_which_other_metrics_are_asked_for(
    runs: Path, data: Data, network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Values, intervals and floors of each metric alone, bit by bit, without what is kept of re-simulation."""
    monkeypatch.setitem(sys.modules, "of_mine", sys.modules[__name__])
    settings = job(runs, "evaluation.noise_draws=3").settings
    names = ["psnr", "crps", "noise_sd", "of_mine.reads_draws", "pchi2", "fd_speckle", "fid", "kd_speckle"]
    inception = load_inception(network)

    def images_of(frames: np.ndarray, draw: int) -> np.ndarray:
        noise = [np.random.default_rng([frame, draw]).integers(0, 60, data.pairs.shape) for frame in frames]
        return (data.pairs.read("resimulation", frames) // 2 + np.stack(noise)).astype(np.uint8)

    def scores_of(*asked: str) -> Scores:
        shutil.rmtree(data.pairs.folder / "baselines", ignore_errors=True)
        metrics = choose_metrics(asked)
        scorer = Scorer(data.pairs, data.tissues, settings.probe, settings.evaluation, metrics, inception)
        return score_run(scorer, images_of, draws_noise=True, beside=baselines(scorer, settings.model))

    together = scores_of(*names)
    alone = {name.rpartition(".")[2]: scores_of(name) for name in names}
    for name, scores in alone.items():
        of_metric = together.of_metric(name)
        assert of_metric.scalars == scores.scalars
        assert {f"test/{name}", f"val/{name}", f"test/floor_{name}", f"test/formula_{name}"} <= scores.scalars.keys()
        assert of_metric.per_image.to_dict("list") == scores.per_image.to_dict("list")
    assert alone["fid"].scalars.keys() >= {"test/fid_lower", "test/floor_fid_upper"}
    again = joined(list(alone.values()))
    assert again.scalars == together.scalars
    assert again.notes == together.notes
    pd.testing.assert_frame_equal(again.per_image, together.per_image)


def test_draws_are_rendered_once_for_all_metrics_and_scored_on_every_frame(runs: Path, data: Data) -> None:
    rendered: list[tuple[int, int]] = []

    def images_of(frames: np.ndarray, draw: int) -> np.ndarray:
        rendered.extend((int(frame), draw) for frame in frames)
        noise = [np.random.default_rng([frame, draw]).integers(0, 60, data.pairs.shape) for frame in frames]
        return (data.pairs.read("resimulation", frames) // 2 + np.stack(noise)).astype(np.uint8)

    settings = job(runs, "evaluation.noise_draws=4").settings
    frames, names = data.pairs.frames(Part.test), ("crps", "noise_sd", "mae", "nyquist_excess")
    scorer = Scorer(data.pairs, data.tissues, settings.probe, settings.evaluation, choose_metrics(names))
    scores = scorer.score(Part.test, images_of, draws_noise=True)
    assert sorted(rendered) == [(frame, draw) for frame in frames.tolist() for draw in range(4)]
    table = scores.per_image.pivot(index="frame", columns="metric", values="value")
    solid = tissue_labels(data.tissues)
    for frame in frames:
        draws = np.concatenate([images_of(np.array([frame]), draw) for draw in range(4)])
        target, tissue = data.pairs.stored("target", frame), np.isin(data.pairs.stored("segmentation", frame), solid)
        pair = Pair(draws[0], target, data.pairs.mask(), tissue, draws=draws)
        assert (table.loc[frame, "crps"], table.loc[frame, "noise_sd"]) == (crps(pair), noise_sd(pair))
        assert table.loc[frame, "mae"] == mae(draws[0], target), "of the first draw"
    assert scores.scalars["crps"] == pytest.approx(table["crps"].mean())

    rendered.clear()
    assert scorer.score(Part.test, images_of, draws_noise=False).scalars["noise_sd"] == 0
    assert sorted(rendered) == [(frame, 0) for frame in frames.tolist()]
    rendered.clear()
    replace(scorer, metrics=choose_metrics("mae")).score(Part.test, images_of, draws_noise=True)
    assert sorted(rendered) == [(frame, 0) for frame in frames.tolist()], "no metric reads draws"


def test_jobs_side_by_side_wait_for_the_one_that_scores_resimulation(runs: Path, data: Data, calls: list[Part]) -> None:
    settings = job(runs, "metrics=[mae_smooth]").settings
    with ThreadPoolExecutor(3) as pool:
        per_job = list(pool.map(lambda _: score(settings, data).scalars, range(3)))
    assert per_job[0] == per_job[1] == per_job[2]
    assert len(calls) == 3 * 2 + 2, "two parts of each job, and of re-simulation once"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("metrics=[psnr,no_such_module.metric]", r"no_such_module.metric: ModuleNotFoundError: No module"),
        ("metrics=[math.no_such]", r"math.no_such: AttributeError: module 'math' has no"),
        ("metrics=[math.pi]", r"math.pi: is no function"),
        ("metrics=[]", "none is named"),
        ("metrics=null", "metrics=None: allowed are all, paper, psnr"),
        ("evaluation.inception=/no/such/file", r"evaluation.inception=/no/such/file: no Inception weights"),
    ],
)
def test_what_cannot_be_computed_is_refused_first(tmp_path: Path, change: str, message: str) -> None:
    with pytest.raises(ConfigurationError, match=message) as raised:
        check([job(tmp_path, change)])
    assert "\n" not in str(raised.value)


@pytest.mark.usefixtures("data")
def test_metrics_added_later_are_computed_without_training(runs: Path, network: Path) -> None:
    few = job(runs, "metrics=[mae,psnr]")
    do(few)
    before = run_of(few).scalars
    assert {"test/mae", "test/psnr", "train/seconds"} <= before.keys()
    assert "test/pchi2" not in before
    files = {path: path.stat().st_mtime_ns for path in (few.training.checkpoint, *few.training.score_files())}

    more = job(runs, "metrics=[pchi2,kid,mae]", f"evaluation.inception={network}")
    assert more.folder == few.folder
    assert not more.finished
    do(more)
    assert more.finished
    assert few.finished
    assert {path: path.stat().st_mtime_ns for path in files} == files, "nothing is trained or scored again"
    after = run_of(more).scalars
    assert {"test/pchi2", "test/kid", "test/mae"} <= after.keys()
    assert (after["test/mae"], after["train/seconds"]) == (before["test/mae"], before["train/seconds"])
    assert set(run_of(more).scores["metric"]) == {"mae", "pchi2"}


def test_scores_of_several_snapshots_are_their_means() -> None:
    def scores(value: float, *frames: int) -> Scores:
        rows = [(frame, 0, "mae", value + frame, "model", "test") for frame in frames]
        columns = ["frame", "site", "metric", "value", "source", "split"]
        return Scores(pd.DataFrame(rows, columns=columns), {"test/mae": value}, about_output=(str(value),))

    mean = averaged([scores(1.0, 0, 1), scores(4.0, 0, 1, 2)])
    assert mean.per_image["value"].tolist() == [2.5, 3.5, 6.0]
    assert list(mean.per_image) == ["frame", "site", "metric", "value", "source", "split"]
    assert mean.scalars == {"test/mae": 2.5}
    assert mean.about_output == ("4.0",)
    one = scores(1.0, 0)
    assert averaged([one]) is one
