"""A training is known by what decides its weights, and lies at an address with that hash."""

import json
import sys
from pathlib import Path

import pytest
import torch

from ablate.command.checks import check
from ablate.command.compose import jobs_of
from ablate.settings.study import ConfigurationError
from ablate.study.job import Job, claim, trainings_of
from ablate.study.run import listed_runs
from ablate.study.scores import names_of, wanted_scores
from ablate.study.training import State, Training
from ablate.training import TRAINING_VERSION
from support.finished_runs import PIXELS, WHOLE, finish
from support.scene_folders import ball_folder


def job(runs: Path, *arguments: str) -> Job:
    return jobs_of([f"runs_dir={runs}", *arguments])[0]


@pytest.fixture(scope="module")
def plain_hash(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The hash of the default job, in a folder of its own."""
    return job(tmp_path_factory.mktemp("plain")).hash


def test_where_and_how_a_job_runs_and_is_scored_does_not_count(tmp_path: Path, plain_hash: str) -> None:
    incidental = ["training.device=cpu", "frame=3", "training.checkpoint_every=7", "simulator.plan=full"]
    incidental += ["dataset.workers=5", "tracking.experiment=other", "study_name=other", "evaluation.pictures=9"]
    incidental += ["evaluation.inception=some/file", "metrics=paper", "simulator.device=cuda", "crops.workers=3"]
    incidental += ["dataset.format=dicom", "evaluation.noise_draws=5"]
    assert job(tmp_path, *incidental).hash == plain_hash


@pytest.mark.parametrize(
    "semantic",
    ["seed=1", "training.steps=7", "model.depth=5", "encoding=arbitrary", "simulator.rays=3", "dataset.frames=7",
     "probe.depth_mm=100", "scene.anatomy_seed=3", "crops.flip=false", "training.precision=bf16",
     "training.loss=none"],
)  # fmt: skip
def test_what_decides_the_weights_counts(tmp_path: Path, plain_hash: str, semantic: str) -> None:
    assert job(tmp_path, semantic).hash != plain_hash


def test_identity_is_computed_once_a_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With scene=folder every mesh is read for it."""
    computed = []
    monkeypatch.setattr(
        "ablate.sources.kinds.fetal.BuiltInAnatomy.identity", lambda s: computed.append(s) or {"scene": {}}
    )
    mine = job(tmp_path)
    claim(mine)
    assert not mine.finished
    assert mine.data.folder.name == mine.data.folder.name
    assert len(computed) == 1


@pytest.mark.parametrize("fast", ["fp32", "bf16"])
def test_automatic_precision_is_the_one_of_the_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fast: str
) -> None:
    """So that a training that began in one does not go on in the other."""
    for probe in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"):
        monkeypatch.setattr(torch.cpu, probe, lambda: fast == "bf16", raising=False)
    automatic, other = (
        job(tmp_path, "training.device=cpu", f"training.precision={precision}")
        for precision in ("auto", {"fp32": "bf16", "bf16": "fp32"}[fast])
    )
    named = job(tmp_path, "training.device=cpu", f"training.precision={fast}")
    assert automatic.hash == named.hash != other.hash


def test_on_a_cluster_the_precision_is_named(tmp_path: Path) -> None:
    automatic = [job(tmp_path, "training.precision=auto")]
    check(automatic)
    with pytest.raises(ConfigurationError, match=r"^training\.precision=auto: .*on a cluster are fp32 and bf16"):
        check(automatic, elsewhere=True)
    check([job(tmp_path)], elsewhere=True)


def test_no_configuration_stands_in_the_way_of_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [[], ["training.steps=7"], ["variant=lsa2h", "scene.triangles=7000"], ["dataset.frames=99"], ["seed=3"]]
    places = [claim(job(tmp_path, *each)).folder for each in words]
    monkeypatch.setattr("ablate.study.job.TRAINING_VERSION", TRAINING_VERSION + 1)
    places.append(claim(job(tmp_path)).folder)
    assert len(set(places)) == len(words) + 1
    assert {place.parent for place in places} == {job(tmp_path).settings.study_dir}
    assert places[0].name == f"sa2h-seed0-{Training(places[0]).hash[:8]}"


def test_one_training_has_one_place_whatever_its_label(tmp_path: Path) -> None:
    """`sa2h-att`, and in a later command `model.attenuation=none`: the same network is no further replicate."""
    first = job(tmp_path, "variant=sa2h-att")
    second = job(tmp_path, "model.attenuation=none")
    assert first.label != second.label
    assert claim(first).folder == claim(second).folder
    assert [one.label for one in trainings_of([first, second])] == ["sa2h-att"]
    finish(first)
    assert second.finished


def test_what_only_scores_trains_nothing_and_counts_once(tmp_path: Path) -> None:
    """Swept `evaluation.noise_draws` once trained the same network again, and counted it as another replicate."""
    jobs = jobs_of(["-m", "evaluation.noise_draws=2,3", "seed=0,1", f"runs_dir={tmp_path}", "preset=tiny"])
    assert len(jobs) == 4
    assert {one.label for one in jobs} == {"sa2h"}
    assert len({one.folder for one in jobs}) == 2
    finish(jobs[0])
    assert [one.finished for one in jobs] == [True, False, False, False], "three draws are another score"
    for one in jobs:
        finish(one)
    asked = listed_runs(trainings_of(jobs))
    assert [run.name for run in asked.runs] == ["sa2h/seed0", "sa2h/seed1"]
    assert len(jobs[0].training.score_files()) == 2 * len(jobs[0].wanted)


def test_a_job_is_finished_when_it_is_trained_and_every_score_is_there(tmp_path: Path) -> None:
    mine = job(tmp_path, "metrics=[psnr,mae]")
    assert mine.training.state is State.missing
    claim(mine)
    assert not mine.finished
    finish(mine)
    assert mine.finished
    assert job(tmp_path, "metrics=psnr").finished
    more = job(tmp_path, "metrics=[psnr,crps]")
    assert [key.metric for key in more.training.lacking(more.wanted)] == ["crps"]
    (mine.training.scores / mine.wanted[0].file_name).write_bytes(b"PAR1 and no more")
    assert [key.metric for key in mine.training.lacking(mine.wanted)] == ["psnr"], "what is damaged is computed again"
    assert mine.training.is_trained, "a score takes nothing back"


def test_another_version_or_edited_code_of_a_metric_is_another_score(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a_metric_of_ones_own.py").write_text("def bias(pair):\n    return 1.0\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    mine = job(tmp_path, "metrics=[psnr,a_metric_of_ones_own.bias]")
    finish(mine)
    assert mine.finished
    monkeypatch.setattr("ablate.study.scores.METRICS_VERSION", 99)
    assert [key.metric for key in mine.training.lacking(mine.wanted)] == ["psnr"]
    monkeypatch.setattr("ablate.study.scores.code_digest", lambda _: "0123456789")
    assert [key.metric for key in mine.training.lacking(mine.wanted)] == ["psnr", "bias"]


def test_scores_are_known_by_the_frames_that_they_are_of(tmp_path: Path) -> None:
    """Two processors round otherwise, so one recipe can give two data sets."""
    mine = job(tmp_path)
    finish(mine)
    mine.data.folder.mkdir(parents=True)
    mine.data.kept_digest.write_text(json.dumps({"test_frames": 16 * "1"}))
    assert not mine.finished
    mine.data.kept_digest.write_text(json.dumps({"test_frames": PIXELS}))
    assert mine.finished


def test_without_weights_no_distance_of_inceptions_features_is_wanted(tmp_path: Path) -> None:
    plain, given = job(tmp_path), job(tmp_path, "evaluation.inception=download")
    names = [{key.metric for key in wanted_scores("all", one.settings.evaluation, PIXELS)} for one in (plain, given)]
    assert names[1] - names[0] == {"fid", "kid"}
    assert names_of(["paper", "psnr", "psnr"]).count("psnr") == 1


@pytest.mark.parametrize("damage", ["", "{", "[]", '{"scalars": 1}', json.dumps({**WHOLE, "pixels": "../x"})])
def test_a_damaged_result_is_not_finished_and_stops_nothing(tmp_path: Path, damage: str) -> None:
    mine = job(tmp_path)
    finish(mine)
    (mine.folder / "trained.json").write_text(damage)
    assert not mine.finished
    assert mine.training.why.startswith("without a usable ")
    assert mine.wanted


@pytest.mark.parametrize("name", [".hidden", "+1", "with a blank "])
def test_the_folder_of_a_scene_may_have_any_name(tmp_path: Path, name: str) -> None:
    folder = ball_folder(tmp_path / name, {"heights": [-15, 0, 15], "angles": [-40, 0, 40], "axis": [0, 0, 1]})
    mine = job(tmp_path / "runs", "scene=folder", f"scene.folder='{folder}'", "dataset.grid=null")
    finish(mine)
    assert (mine.finished, mine.training.why) == (True, "")


def test_a_damaged_description_is_written_again_but_not_beside_weights(tmp_path: Path) -> None:
    mine = job(tmp_path)
    training = claim(mine)
    about = training.folder / "training.json"
    whole = about.read_text()
    about.write_text("")
    claim(mine)
    assert about.read_text() == whole
    about.write_text("")
    training.checkpoint.touch()
    with pytest.raises(ConfigurationError, match=r"training\.json is missing or damaged: what was trained is"):
        claim(mine)


def test_names_in_a_folder_are_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder may come from anybody: what it names is not imported."""
    mine = job(tmp_path)
    (tmp_path / "evil_network.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    finish(mine)
    about = json.loads((mine.folder / "training.json").read_text())
    about["settings"]["metrics"] = ["evil_network.f"]
    (mine.folder / "training.json").write_text(json.dumps(about))
    assert mine.training.settings.metrics == ["evil_network.f"]
    assert mine.finished
    assert "evil_network" not in sys.modules
