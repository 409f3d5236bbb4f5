"""Any key is a component: what a sweep gives several values is one study with effects, interactions and verdicts."""

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ablate.analysis import RESIMULATION, StudyResults
from ablate.command.compose import jobs_of
from ablate.metrics import METRICS_VERSION
from ablate.study.comparable import ComparableRuns, comparable_runs, with_earlier
from ablate.study.compare import compare_study
from ablate.study.job import Job, trainings_of
from ablate.study.reading import results_of, scored_frames, table_of_runs
from ablate.study.run import COMPARISON, Run, RunList, listed_runs, write_list
from ablate.study.scores import ScoreKey, by_metric, write_score
from support.finished_runs import PIXELS, finish, scores_of


def swept(runs: Path, *words: str) -> list[Job]:
    return jobs_of(["-m", "preset=tiny", *words, "seed=0,1,2", "metrics=[psnr,mae,shadow_contrast,crps]",
                    f"runs_dir={runs}"])  # fmt: skip


def usable(jobs: Sequence[Job]) -> ComparableRuns:
    return comparable_runs(listed_runs(trainings_of(jobs)))


def answered(jobs: Sequence[Job]) -> tuple[StudyResults, tuple[Run, ...]]:
    """The answers of a study whose runs score 20 by default, and 1 more a changed key."""
    for number, job in enumerate(jobs):
        value = 20 + len(job.changed) + 0.01 * (number % 3) + 1e-9 * number
        finish(job, dict.fromkeys(("psnr", "mae", "shadow_contrast", "crps"), value))
    runs = usable(jobs)
    return results_of(runs), runs.all


@pytest.mark.parametrize(
    ("word", "labels"),
    [
        ("training.schedule=linear,constant", ["sa2h", "sa2h.schedule-constant"]),
        ("training.learning_rate=5e-4,1e-4", ["sa2h", "sa2h.learning_rate-0.0001"]),
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
    _, runs = answered(swept(tmp_path, "encoding=arbitrary", "encoding_seed=0,1"))
    of_labels = table_of_runs(runs).set_index("variant")["encoding_seed"].to_dict()
    assert sorted(of_labels.values()) == [0, 1]


def test_what_some_labels_tell_is_said_of_the_others(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "training.steps=4,5")
    answered(jobs)
    assert not any("training.steps" in note for note in usable(jobs).notes)
    more = swept(tmp_path, "variant=nsa2h", "training.steps=2")
    answered(more)
    assert "training.steps is 2 in nsa2h." in usable([*jobs, *more]).notes


def test_one_training_on_the_same_frames_under_two_keys_is_named(tmp_path: Path) -> None:
    """As where a scene has fewer poses than either of two numbers of frames."""
    jobs = swept(tmp_path, "dataset.frames=12,24")
    for job in jobs:
        finish(job, dict.fromkeys(("psnr", "mae", "shadow_contrast", "crps"), 20.0 + job.settings.seed))
    twice = "sa2h/seed1 and sa2h.frames-24/seed1 have the same frames and scores, and count twice: remove one."
    assert twice in usable(jobs).notes


def test_a_key_that_some_runs_lack_is_compared_where_it_is(tmp_path: Path) -> None:
    """Without a discriminator nothing has its width."""
    jobs = swept(tmp_path, "training.discriminator_width=0.5,0.7") + swept(tmp_path, "training.loss=none")
    _, runs = answered(jobs)
    assert len(runs) == 9
    assert not any("discriminator_width" in note for note in usable(jobs).notes)


def test_a_training_that_only_other_scores_are_asked_of_counts_once(tmp_path: Path) -> None:
    """Under the null, the same trainings under two numbers of draws gave p < 0.05 in 18.5 % of studies."""
    jobs = swept(tmp_path, "evaluation.noise_draws=2,3", "variant=sa2h,sa2h-att")
    judged, runs = answered(jobs)
    assert (len(jobs), len(runs)) == (12, 6)
    assert set(judged.effects["dof"]) == {4}, "six runs, two means"


def test_images_that_differ_between_levels_are_said(tmp_path: Path) -> None:
    design = answered(swept(tmp_path, "dataset.frames=12,10"))[0].design
    assert design is not None
    assert "Levels of dataset.frames were scored on different images; p does not count" in design.reading


def test_a_copy_of_a_folder_is_no_further_training(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "variant=sa2h,nsa2h")
    _, before = answered(jobs)
    for name in ("older", jobs[0].folder.name.replace("sa2h-seed0", "sa2h-seed9")):
        shutil.copytree(jobs[0].folder, jobs[0].settings.study_dir / name)
    assert [run.training.folder for run in usable(jobs).runs] == [run.training.folder for run in before]


def test_the_floor_is_that_of_the_run_that_has_most_of_it(tmp_path: Path) -> None:
    jobs = swept(tmp_path, "variant=sa2h,nsa2h")
    _, runs = answered(jobs)
    for number, run in enumerate(runs):
        for metric in ("psnr",) if number == 0 else ("psnr", "mae"):
            key = ScoreKey(metric, f"v{METRICS_VERSION}", 3, PIXELS)
            write_score(run.training.scores, key, by_metric(scores_of({metric: 20.0}, resimulated=True), [key])[key])
    frames, _ = scored_frames(usable(jobs).all)
    assert set(frames.loc[frames["variant"] == RESIMULATION, "metric"]) == {"psnr", "mae"}


def test_one_job_joins_the_comparison_of_its_study_and_a_sweep_is_one_of_its_own(tmp_path: Path) -> None:
    def asked(*words: str) -> RunList:
        jobs = jobs_of([*words, "preset=tiny", "metrics=[psnr,mae]", f"runs_dir={tmp_path}"])
        for number, job in enumerate(jobs):
            finish(job, {"psnr": 20.0 + number, "mae": 9.0})
        return with_earlier(listed_runs(jobs))

    def compared(*words: str) -> list[str]:
        together = asked(*words)
        (together.folder / COMPARISON).mkdir(exist_ok=True)
        write_list(together.folder / COMPARISON, together)
        return [run.name for run in together.runs]

    assert compared("variant=sa2h") == ["sa2h/seed0"]
    assert compared("variant=nsa2h") == ["sa2h/seed0", "nsa2h/seed0"]
    assert compared("variant=sa2h") == ["sa2h/seed0", "nsa2h/seed0"], "repeated"
    assert compared("variant=sa2h-att", "training.steps=7") == ["sa2h-att/seed0"], "no label tells the steps"
    assert compared("-m", "variant=sa2h,nsa2h") == ["sa2h/seed0", "nsa2h/seed0"]
    assert compared("-m", "variant=sa2h,sa2h-att") == ["sa2h/seed0", "sa2h-att/seed0"]


def test_scores_on_disk_are_compared_whatever_the_command_names(tmp_path: Path) -> None:
    """And only these: a metric by other code, on other frames, or that was never scored, stays without a value."""

    def asked(variant: str, metrics: str) -> list[Job]:
        return jobs_of([f"variant={variant}", f"metrics=[{metrics}]", "preset=tiny", f"runs_dir={tmp_path}"])

    def compared(variant: str, metrics: str) -> pd.DataFrame:
        study = compare_study(listed_runs(asked(variant, metrics)), "a study", time_here=False).study
        return study.table.pivot(index="variant", columns="metric", values="mean")

    for variant, mae in (("nsa2h", 8.0), ("sa2h", 9.0)):
        finish(asked(variant, "psnr,mae,pchi2")[0], {"psnr": 20.0, "mae": mae, "pchi2": 1.0})
    finish(asked("sa2h-att", "psnr")[0], {"psnr": 21.0})
    for file in asked("sa2h", "psnr")[0].training.scores.glob("pchi2@*"):
        file.rename(file.with_name(file.name.replace("@v", "@v9")))
    compared("nsa2h", "psnr,mae,pchi2")
    table = compared("sa2h", "psnr")
    assert table.loc["sa2h", ["psnr", "mae"]].tolist() == [20.0, 9.0]
    assert np.isnan(table.loc["sa2h", "pchi2"])
    table = compared("sa2h-att", "psnr")
    assert table["mae"].drop("sa2h-att").to_dict() == {"nsa2h": 8.0, "sa2h": 9.0}
    assert np.isnan(table.loc["sa2h-att", "mae"])
