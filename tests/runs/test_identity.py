"""A run is known by what decides its result, and two results never share a place."""

import json
import sys
from pathlib import Path

import pytest
import torch

from ablate.jobs.compose import jobs_of
from ablate.jobs.preflight import check
from ablate.metrics import METRICS_VERSION
from ablate.runs import place
from ablate.runs.job import Job
from ablate.runs.place import check_place, claim_place, finished_run, with_earlier_metrics
from ablate.runs.run import State
from ablate.settings.study import ConfigurationError
from ablate.storage import write_json
from ablate.training import TRAINING_VERSION
from support.finished_runs import finish, result_of


def job(runs: Path, *arguments: str) -> Job:
    return jobs_of([f"runs_dir={runs}", *arguments])[0]


@pytest.fixture(scope="module")
def plain_hash(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The hash of the default job, in a folder of its own."""
    return job(tmp_path_factory.mktemp("plain")).hash


def test_where_and_how_a_job_runs_does_not_count(tmp_path: Path, plain_hash: str) -> None:
    incidental = ["training.device=cpu", "frame=3", "training.checkpoint_every=7", "simulator.plan=full"]
    incidental += ["dataset.workers=5", "tracking.experiment=other", "study_name=other", "evaluation.pictures=9"]
    incidental += ["evaluation.inception=some/file", "metrics=paper", "simulator.device=cuda", "crops.workers=3"]
    incidental += ["dataset.format=dicom"]
    assert job(tmp_path, *incidental).hash == plain_hash


def test_identity_is_computed_once_a_job(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With scene=folder every mesh is read for it."""
    computed = []
    monkeypatch.setattr(
        "ablate.runs.data_set.about_data", lambda s: computed.append(s) or {"scene": {}, "pairs_version": 1}
    )
    mine = job(tmp_path)
    claim_place(mine)
    check_place(mine)
    assert finished_run(mine) is None
    assert (mine.data.folder.name, mine.run.hash) == (mine.data.folder.name, mine.hash)
    assert len(computed) == 1


@pytest.mark.parametrize(
    "semantic",
    ["seed=1", "training.steps=7", "model.depth=5", "encoding=arbitrary", "simulator.rays=3", "dataset.frames=7",
     "probe.depth_mm=100", "scene.anatomy_seed=3", "crops.flip=false", "training.precision=bf16",
     "training.loss=none", "evaluation.noise_draws=5"],
)  # fmt: skip
def test_what_decides_the_result_counts(tmp_path: Path, plain_hash: str, semantic: str) -> None:
    assert job(tmp_path, semantic).hash != plain_hash


@pytest.mark.parametrize("fast", ["fp32", "bf16"])
def test_automatic_precision_is_the_one_of_the_device(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fast: str
) -> None:
    """So that a run that began in one does not go on in the other."""
    for probe in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"):
        monkeypatch.setattr(torch.cpu, probe, lambda: fast == "bf16", raising=False)
    automatic, other = (
        job(tmp_path, "training.device=cpu", f"training.precision={precision}")
        for precision in ("auto", {"fp32": "bf16", "bf16": "fp32"}[fast])
    )
    named = job(tmp_path, "training.device=cpu", f"training.precision={fast}")
    assert automatic.hash == named.hash
    claim_place(automatic)
    with pytest.raises(ConfigurationError, match=rf"training\.precision: {fast} there, "):
        claim_place(other)


def test_on_a_cluster_the_precision_is_named(tmp_path: Path) -> None:
    automatic = [job(tmp_path, "training.precision=auto")]
    check(automatic)
    with pytest.raises(ConfigurationError, match=r"^training\.precision=auto: .*on a cluster are fp32 and bf16"):
        check(automatic, elsewhere=True)
    check([job(tmp_path)], elsewhere=True)


def test_another_version_of_the_training_is_another_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mine = job(tmp_path)
    claim_place(mine)
    monkeypatch.setattr("ablate.runs.job.TRAINING_VERSION", TRAINING_VERSION + 1)
    versions = f"training_version: {TRAINING_VERSION} there, {TRAINING_VERSION + 1} here"
    for variant in ("sa2h", "nsa2h"):
        with pytest.raises(ConfigurationError, match=rf"\({versions}\).*study_name"):
            claim_place(job(tmp_path, f"variant={variant}"))
    there = json.loads((mine.folder / "spec.json").read_text())["hash"]
    assert job(tmp_path).hash != there


def test_another_configuration_in_the_same_place_is_refused_with_the_difference(tmp_path: Path) -> None:
    claim_place(job(tmp_path))
    claim_place(job(tmp_path, "training.threads=2"))
    with pytest.raises(ConfigurationError, match=r"training\.steps: \d+ there, 7 here.*study_name"):
        claim_place(job(tmp_path, "training.steps=7"))


def test_a_study_is_one_configuration_but_for_what_its_labels_say(tmp_path: Path) -> None:
    claim_place(job(tmp_path))
    claim_place(job(tmp_path, "variant=nsa2h", "seed=3"))
    claim_place(job(tmp_path, "variant=sa2h-att", "encoding=arbitrary", "model.noise=none"))
    claim_place(job(tmp_path, "variant=sa2h-conv", "scene.anatomy_seed=1"))
    with pytest.raises(ConfigurationError, match=r"data\.scene\.triangles: \d+ there, 7000 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "scene.triangles=7000", "scene.anatomy_seed=1"))
    claim_place(job(tmp_path, "variant=sa2h-gan"))
    claim_place(job(tmp_path, "training.loss=minimax"))
    with pytest.raises(ConfigurationError, match=r"data\.dataset\.frames: \d+ there, 99 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "dataset.frames=99"))
    with pytest.raises(ConfigurationError, match=r"model\.width: 0\.25 there, 0\.5 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "model.width=0.5"))


def test_only_the_result_of_this_configuration_counts_as_finished(tmp_path: Path) -> None:
    mine = job(tmp_path)
    claim_place(mine)
    assert finished_run(mine) is None
    run = finish(mine)
    assert finished_run(mine) == run
    for change in ({"hash": "of another"}, {"metrics_version": 1}, {"metrics": ["psnr"]}, {"label": "nsa2h"}):
        write_json(mine.folder / "result.json", result_of(mine, **change))
        assert finished_run(mine) is None, change
    finish(mine)
    run.scores_file.write_bytes(b"")
    assert finished_run(mine) is None, "the values of frames are lost, and are made again from the checkpoint"
    assert mine.run.state is State.resumable


def test_a_result_of_a_newer_version_is_never_overwritten(tmp_path: Path) -> None:
    mine = job(tmp_path)
    run = finish(mine, metrics_version=METRICS_VERSION + 1)
    assert (run.state, finished_run(mine)) == (State.unusable, None)
    with pytest.raises(ConfigurationError, match=r"scored by version \d+ of the metrics.*newer.*remove it"):
        check_place(mine)


def test_a_metric_of_the_users_whose_code_was_edited_is_computed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(place, "load", lambda _: None)  # a function, whose name is in the path
    monkeypatch.setattr(place, "code_digest", lambda path: f"first code of {path}")
    mine = job(tmp_path, "metrics=[psnr,my_metrics.bias]")
    finish(mine, metrics=["psnr", "my_metrics.bias"], sources=place.sources_of(mine.settings.metrics))
    assert finished_run(mine) is not None
    monkeypatch.setattr(place, "code_digest", lambda path: f"second code of {path}")
    assert finished_run(mine) is None


@pytest.mark.parametrize(
    "damage", ["", "{", "[]", '{"hash": 1}', "metrics: 5", 'metrics: [{"all": 1}]', 'scalars: {"seconds": 1}']
)
def test_a_damaged_result_is_not_finished_and_stops_nothing(tmp_path: Path, damage: str) -> None:
    mine = job(tmp_path)
    claim_place(mine)
    key, _, value = damage.partition(": ")
    changed = json.dumps(result_of(mine) | {key: json.loads(value)}) if value and key.isidentifier() else damage
    (mine.folder / "result.json").write_text(changed)
    assert finished_run(mine) is None
    assert with_earlier_metrics(mine).metrics


def test_names_in_a_result_are_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A result may come from anybody, and a module of a user's own metric may be gone."""
    mine = job(tmp_path)
    (tmp_path / "evil_metric.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    finish(mine, metrics=["all", "evil_metric.f", "gone.f"])
    assert finished_run(mine) is not None
    assert not {"evil_metric.f", "gone.f"} & set(with_earlier_metrics(mine).metrics)
    assert "evil_metric" not in sys.modules


def test_a_damaged_spec_of_another_run_stops_nothing_and_ones_own_only_before_training_goes_on(tmp_path: Path) -> None:
    mine, other = job(tmp_path), job(tmp_path, "variant=nsa2h")
    for each in (mine, other):
        claim_place(each)
        (each.folder / "spec.json").write_text("")
    check_place(mine)
    (mine.folder / "last.ckpt").touch()
    with pytest.raises(ConfigurationError, match=r"spec\.json is damaged: .* remove .*seed0 to start again"):
        claim_place(mine)
    write_json(mine.folder / "result.json", result_of(mine))  # it names the configuration as well
    claim_place(mine)
    assert json.loads((mine.folder / "spec.json").read_text())["hash"] == mine.hash
