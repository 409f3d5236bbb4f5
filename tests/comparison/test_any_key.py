"""Any key is a component: what a sweep gives several values is one study with effects, interactions and verdicts."""

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from ablate.analysis import RESIMULATION
from ablate.comparison.reading import Answers, answers, scored_frames
from ablate.comparison.usable_runs import check_alike, usable_runs
from ablate.jobs.compose import jobs_of
from ablate.metrics.metric import RESIMULATED
from ablate.runs.job import Job
from ablate.runs.place import check_place, sources_of
from ablate.runs.run import Run
from ablate.settings.study import ConfigurationError
from support.finished_runs import PARAMETERS, finish


def swept(runs: Path, *words: str) -> list[Job]:
    return jobs_of(["-m", "preset=tiny", *words, "seed=0,1,2", f"runs_dir={runs}"])


def answered(jobs: Sequence[Job]) -> tuple[Answers, tuple[Run, ...]]:
    """The answers of a study whose runs score 20 by default, and 1 more a changed key."""
    for number, job in enumerate(jobs):
        value = 20 + len(job.changed) + 0.01 * (number % 3)
        metrics = dict.fromkeys(("psnr", "mae", "shadow_contrast", "crps"), value)
        finish(job, metrics, data=job.data.name)
    usable = usable_runs(jobs[0].settings.study_dir)
    return answers(usable.all), usable.all


@pytest.mark.parametrize(
    ("word", "labels"),
    [
        ("training.reconstruction=crps,l1", ["sa2h", "sa2h.reconstruction-l1"]),
        ("training.learning_rate=1e-3,1e-4", ["sa2h", "sa2h.learning_rate-0.0001"]),
        ("dataset.frames=12,10", ["sa2h", "sa2h.frames-10"]),
    ],
)
def test_a_key_that_nobody_declared_has_effects_and_no_verdict(tmp_path: Path, word: str, labels: list[str]) -> None:
    jobs = swept(tmp_path, word)
    assert sorted({job.label for job in jobs}) == sorted(labels)
    assert len({job.folder for job in jobs}) == 6
    judged, runs = answered(jobs)
    key = word.partition("=")[0]
    assert judged.design is not None
    assert (judged.design.factors, len(runs)) == ([key], 6)
    effects = judged.effects.set_index("metric")
    assert abs(effects.loc["psnr", "estimate"]) == pytest.approx(1.0)
    verdict = judged.verdicts.set_index("component").loc[key.rpartition(".")[2]]
    assert (verdict["verdict"], pd.isna(verdict["band"])) == ("undecided", True)
    assert "declared" in verdict["why"]


def test_an_order_of_labels_that_follows_the_seed_is_no_component(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "encoding=arbitrary", "variant=sa2h,sa2h-att")[:-1]  # the last one has not finished
    judged, runs = answered(jobs)
    assert judged.design is not None
    assert (judged.design.factors, len(runs)) == (["model.attenuation"], 5)


def test_a_swept_order_of_labels_has_its_seed_in_the_table_of_runs(tmp_path: Path) -> None:
    judged, _ = answered(swept(tmp_path, "encoding=arbitrary", "encoding_seed=0,1"))
    of_labels = judged.runs.set_index("variant")["encoding_seed"].to_dict()
    assert sorted(of_labels.values()) == [0, 1]


def test_what_some_labels_tell_is_said_of_the_others(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "training.steps=4,5")
    answered(jobs)
    assert not any("training.steps" in note for note in usable_runs(jobs[0].settings.study_dir).notes)
    answered(swept(tmp_path, "variant=nsa2h", "training.steps=2"))
    assert "training.steps is 2 in nsa2h." in usable_runs(jobs[0].settings.study_dir).notes


def test_one_training_on_the_same_frames_under_two_keys_is_named(tmp_path: Path) -> None:
    """As where a scene has fewer poses than either of two numbers of frames."""
    jobs = swept(tmp_path, "dataset.frames=12,24")
    for job in jobs:
        scalars = PARAMETERS | {"test/psnr": 20.0 + job.settings.seed}
        finish(job, {"psnr": scalars["test/psnr"]}, scalars=scalars, data=job.data.name)
    notes = usable_runs(jobs[0].settings.study_dir).notes
    assert "sa2h/seed1 and sa2h.frames-24/seed1 have the same frames and scores, and count twice: remove one." in notes


def test_a_key_that_some_runs_lack_is_compared_where_it_is(tmp_path: Path) -> None:
    """Without a discriminator nothing has its width."""
    jobs = swept(tmp_path, "training.discriminator_width=0.5,0.7") + swept(tmp_path, "training.loss=none")
    for job in jobs:
        finish(job)
    usable = usable_runs(jobs[0].settings.study_dir)
    assert len(usable.all) == 9
    assert not any("discriminator_width" in note for note in usable.notes)


def test_a_key_that_decides_nothing_is_no_component(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="share the place"):
        swept(tmp_path, "training.threads=1,2")


def test_two_data_sets_of_one_recipe_are_never_mixed(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "variant=sa2h,nsa2h")
    runs = [finish(job, pixels="of one processor") for job in jobs]
    check_alike(runs)
    runs[-1] = finish(jobs[-1], pixels="of another processor")
    with pytest.raises(ConfigurationError, match=r"two data sets of one recipe.*remove one of the two"):
        usable_runs(jobs[0].settings.study_dir)


def test_different_code_of_one_metric_is_never_mixed(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "variant=sa2h,nsa2h")
    check_alike([finish(job, sources={"my.bias": "bias 1"} if job.label == "sa2h" else {}) for job in jobs])
    for name, source in (("my.bias", "bias 2"), ("yours.bias", "bias 1"), ("my.error", "bias 3")):
        finish(jobs[-1], sources={name: source})
        with pytest.raises(ConfigurationError, match=r"(bias|error) has scored .* by different code: repeat"):
            usable_runs(jobs[0].settings.study_dir)


def test_a_metric_is_known_by_the_name_that_its_values_have(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "from ablate.metrics import Direction, Metric\ndef bias(pair):\n    return 1.0\n"
    code += "error = Metric('bias', label='Bias', unit='share', better=Direction.lower, of_image=bias)\n"
    (tmp_path / "two_of_one_name.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    sources = sources_of(["psnr", "two_of_one_name.bias", "two_of_one_name.error"])
    assert [source.partition(" ")[0] for source in sources.values()] == ["bias", "bias"]


@pytest.mark.parametrize("words", [["preset=tiny"], ["-m", "preset=tiny,quick"]])
def test_runs_of_one_preset_share_their_training_also_where_another_preset_was_swept(
    tmp_path: Path, words: list[str]
) -> None:
    given = [f"runs_dir={tmp_path}", "study_name=s"]
    for job in jobs_of(["-m", "variant=sa2h", "preset=tiny,quick", *given]):
        finish(job)
    check_place(jobs_of([*words, "variant=nsa2h", *given])[0])
    with pytest.raises(ConfigurationError, match=r"training\.steps: .* there, 7 here"):
        check_place(jobs_of([*words, "variant=nsa2h", "training.steps=7", *given])[0])


def test_two_networks_under_one_label_are_never_averaged(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "variant=sa2h,nsa2h")
    for job in jobs[:-1]:
        finish(job)
    settings = replace(jobs[-1].settings, model=replace(jobs[-1].settings.model, depth=3))
    finish(replace(jobs[-1], settings=settings))
    with pytest.raises(ConfigurationError, match=r"have one label and differ in model\.depth: remove one"):
        usable_runs(jobs[0].settings.study_dir)
    settings = replace(jobs[-1].settings, training=replace(jobs[-1].settings.training, steps=12))
    elsewhere = finish(replace(jobs[-1], settings=replace(settings, study_name="other")))
    shutil.copytree(elsewhere.folder, jobs[-1].folder, dirs_exist_ok=True)
    with pytest.raises(ConfigurationError, match=r"have one label and differ in training\.steps: remove one"):
        usable_runs(jobs[0].settings.study_dir)


def test_one_run_under_two_labels_counts_once(tmp_path: Path) -> None:
    """`sa2h-att`, and in a later command `model.attenuation=none`: the same network is no further replicate."""
    jobs = [*swept(tmp_path, "variant=sa2h,sa2h-att"), *swept(tmp_path, "model.attenuation=none")]
    for job in jobs:
        finish(job)
    with pytest.raises(
        ConfigurationError, match=r"sa2h-att/seed\d and .*are the same run, which counts once: remove one"
    ):
        usable_runs(jobs[0].settings.study_dir)


def test_images_that_differ_between_levels_are_said(tmp_path: Path) -> None:
    design = answered(swept(tmp_path, "dataset.frames=12,10"))[0].design
    assert design is not None
    assert "Levels of dataset.frames were scored on different images; p does not count" in design.reading


def test_a_copy_of_a_run_is_no_further_training(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "variant=sa2h,nsa2h")
    for job in jobs:
        finish(job)
    shutil.copytree(jobs[0].folder, jobs[0].folder.with_name("seed0.bak"))
    shutil.copytree(jobs[0].folder.parent, jobs[0].settings.study_dir / "older")
    usable = usable_runs(jobs[0].settings.study_dir)
    assert sorted(run.folder for run in usable.runs) == sorted(job.folder for job in jobs)
    (note,) = usable.notes
    assert note.startswith("5 runs left aside, in a folder that was copied or renamed: ")


def test_the_floor_is_that_of_the_run_that_has_most_of_it(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "variant=sa2h,nsa2h")
    for number, job in enumerate(jobs):
        run = finish(job, {"psnr": 20.0, "mae": 10.0}, data=job.data.name)
        floors = run.scores.assign(source=RESIMULATED)
        floors = floors[floors["metric"] == "psnr"] if number == 0 else floors
        pd.concat([run.scores, floors]).to_parquet(run.scores_file)
    judged, _ = scored_frames([Run(job.folder) for job in jobs])
    assert set(judged.loc[judged["variant"] == RESIMULATION, "metric"]) == {"psnr", "mae"}
