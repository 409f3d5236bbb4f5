"""A run is known by what decides its result, and two results never share a place."""

import json
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
import torch

from ablate.jobs.compose import jobs_of
from ablate.jobs.preflight import check
from ablate.metrics import METRICS_VERSION
from ablate.runs import identity
from ablate.runs.data import about_data
from ablate.runs.identity import check_place, claim_place, config_hash, finished, with_earlier_metrics
from ablate.runs.job import Job
from ablate.settings.study import ConfigurationError
from ablate.storage import read_json, write_json
from ablate.training import TRAINING_VERSION
from ablate.ultrasound import SimulatorSettings
from support.studies import study_group


def job(runs: Path, *arguments: str) -> Job:
    return jobs_of([f"runs_dir={runs}", *arguments])[0]


@pytest.fixture(scope="module")
def plain_hash(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The hash of the default job, in a folder of its own."""
    return config_hash(job(tmp_path_factory.mktemp("plain")).settings)


@pytest.mark.parametrize(
    "incidental",
    [
        "training.device=cpu",
        "frame=3",
        "training.threads=2",
        "training.checkpoint_every=7",
        "crops.workers=3",
        "simulator.device=cuda",
        "simulator.plan=full",
        "dataset.workers=5",
        "tracking.experiment=other",
        "study_name=other",
        "evaluation.pictures=9",
        "evaluation.inception=some/file",
        "metrics=paper",
    ],
)
def test_where_and_how_a_job_runs_does_not_count(tmp_path: Path, plain_hash: str, incidental: str) -> None:
    assert config_hash(job(tmp_path, incidental).settings) == plain_hash


def test_a_setting_that_came_later_and_is_off_does_not_count(tmp_path: Path) -> None:
    """Else every data set from before it would be simulated again."""
    about = about_data(job(tmp_path).settings)["simulator"]
    assert about.keys() == {field.name for field in fields(SimulatorSettings)} - {"device", "plan", "tolerance"}


@pytest.mark.parametrize(
    "semantic",
    [
        "seed=1",
        "training.steps=7",
        "model.depth=5",
        "encoding=arbitrary",
        "simulator.rays=3",
        "simulator.tolerance=0.1",
        "dataset.frames=7",
        "dataset.seed=2",
        "probe.depth_mm=100",
        "scene.triangles=7000",
        "scene.anatomy_seed=3",
        "crops.flip=false",
        "training.precision=bf16",
        "training.loss=none",
        "training.reconstruction=l1",
        "training.schedule=constant",
        "evaluation.noise_draws=5",
    ],
)
def test_what_decides_the_result_counts(tmp_path: Path, plain_hash: str, semantic: str) -> None:
    assert config_hash(job(tmp_path, semantic).settings) != plain_hash


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
    assert config_hash(automatic.settings) == config_hash(named.settings)
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
    mine, beside = job(tmp_path), job(tmp_path, "variant=nsa2h")
    claim_place(mine)
    monkeypatch.setattr(identity, "TRAINING_VERSION", TRAINING_VERSION + 1)
    versions = f"training_version: {TRAINING_VERSION} there, {TRAINING_VERSION + 1} here"
    for each in (mine, beside):
        with pytest.raises(ConfigurationError, match=rf"\({versions}\).*study_name"):
            claim_place(each)
    there = json.loads((mine.folder / "spec.json").read_text())["hash"]
    assert config_hash(mine.settings) != there


def test_runs_stored_before_there_was_a_version_of_the_training_are_known_by_the_same_hash() -> None:
    kept = Path(__file__).parents[2] / "docs" / "results" / "answer"
    of_study = {job.name: job for name in ("answer", "answer_beside") for job in study_group(name)}
    found = {f"{path.parts[-3]}/{path.parts[-2]}": read_json(path) for path in kept.glob("*/seed*/spec.json")}
    assert found
    for name, spec in found.items():
        same = spec["semantic"].get("training_version", 1) == TRAINING_VERSION
        assert (config_hash(of_study[name].settings) == spec["hash"]) == same


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
    with pytest.raises(ConfigurationError, match=r"data\.scene\.seed: 0 there, 1 here"):
        claim_place(job(tmp_path, "scene.anatomy_seed=1"))
    with pytest.raises(ConfigurationError, match=r"data\.scene\.triangles: \d+ there, 7000 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "scene.triangles=7000", "scene.anatomy_seed=1"))
    claim_place(job(tmp_path, "variant=sa2h-gan"))
    claim_place(job(tmp_path, "training.loss=minimax"))
    with pytest.raises(ConfigurationError, match=r"training\.steps: \d+ there, 7 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "training.steps=7"))
    with pytest.raises(ConfigurationError, match=r"training\.reconstruction: crps there, l1 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "training.reconstruction=l1"))
    with pytest.raises(ConfigurationError, match=r"data\.dataset\.frames: \d+ there, 99 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "dataset.frames=99"))
    with pytest.raises(ConfigurationError, match=r"model\.width: 0\.25 there, 0\.5 here"):
        claim_place(job(tmp_path, "variant=lsa2h", "model.width=0.5"))


def whole_result(job: Job) -> dict[str, Any]:
    """A result as a run writes it, and the values of its frames on disk."""
    pd.DataFrame({"metric": []}).to_parquet(job.folder / "per_image.parquet")
    about = {
        "hash": config_hash(job.settings),
        "label": job.label,
        "seed": 0,
        "data": "fetal-0",
        "mlflow_run_id": "none",
    }
    scored_by = {"metrics": ["all"], "metrics_version": METRICS_VERSION, "inception": None}
    return {**about, **scored_by, "notes": [], "scalars": {"parameters_generator": 1, "parameters_discriminator": 1}}


def test_only_the_result_of_this_configuration_counts_as_finished(tmp_path: Path) -> None:
    mine = job(tmp_path)
    claim_place(mine)
    assert finished(mine) is None
    write_json(mine.folder / "result.json", {"hash": "of another"})
    assert finished(mine) is None
    result = whole_result(mine)
    write_json(mine.folder / "result.json", {k: v for k, v in result.items() if k != "metrics_version"})
    assert finished(mine) is None, "the first version of the metrics was not stored"
    write_json(mine.folder / "result.json", {**result, "metrics_version": METRICS_VERSION + 1})
    assert finished(mine) is None
    write_json(mine.folder / "result.json", result)
    assert finished(mine) == result
    (mine.folder / "per_image.parquet").write_bytes(b"")
    assert finished(mine) is None, "the values of frames are lost, and are made again from the checkpoint"
    assert json.loads((mine.folder / "spec.json").read_text())["hash"] == config_hash(mine.settings)


@pytest.mark.parametrize(
    "damage",
    [
        "",
        "{",
        "[]",
        '{"hash": 1}',
        "metrics: 5",
        'metrics: [{"all": 1}]',
        "scalars: null",
        'scalars: {"seconds": 1}',
        'metrics_version: "two"',
    ],
)
def test_a_damaged_result_is_not_finished_and_stops_nothing(tmp_path: Path, damage: str) -> None:
    mine = job(tmp_path)
    claim_place(mine)
    key, _, value = damage.partition(": ")
    changed = json.dumps(whole_result(mine) | {key: json.loads(value)}) if value and key.isidentifier() else damage
    (mine.folder / "result.json").write_text(changed)
    assert finished(mine) is None
    assert with_earlier_metrics(mine).metrics


@pytest.mark.parametrize("key", ["metrics", "metrics_version", "inception", "notes"])
def test_a_result_without_a_key_that_came_later_is_read(tmp_path: Path, key: str) -> None:
    mine = job(tmp_path)
    claim_place(mine)
    kept = {name: value for name, value in whole_result(mine).items() if name != key}
    write_json(mine.folder / "result.json", kept)
    finished(mine)
    assert with_earlier_metrics(mine).metrics


def test_names_in_a_result_are_data(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A result may come from anybody, and a module of a user's own metric may be gone."""
    mine = job(tmp_path)
    claim_place(mine)
    (tmp_path / "evil_metric.py").write_text("raise SystemExit('imported')\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    result = whole_result(mine) | {"metrics": ["all", "evil_metric.f", "gone.f"]}
    write_json(mine.folder / "result.json", result)
    assert finished(mine) == result
    assert not {"evil_metric.f", "gone.f"} & set(with_earlier_metrics(mine).metrics)
    assert "evil_metric" not in sys.modules


def test_a_damaged_spec_of_another_run_stops_nothing_and_ones_own_only_before_training_goes_on(tmp_path: Path) -> None:
    mine, other = job(tmp_path), job(tmp_path, "variant=nsa2h")
    for each in (mine, other):
        claim_place(each)
        (each.folder / "spec.json").write_text("")
    check_place(mine)
    (mine.folder / "last.ckpt").touch()
    with pytest.raises(ConfigurationError, match=r"spec\.json is damaged .* remove .*seed0 to start again"):
        claim_place(mine)
    write_json(mine.folder / "result.json", whole_result(mine))  # it names the configuration as well
    claim_place(mine)
    assert json.loads((mine.folder / "spec.json").read_text())["hash"] == config_hash(mine.settings)
