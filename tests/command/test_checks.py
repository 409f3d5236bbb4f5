"""What cannot be trained is refused before anything is simulated."""

import re
from collections.abc import Sequence
from pathlib import Path

import pytest

from ablate.analysis.components import Component
from ablate.command import checks
from ablate.command.checks import check
from ablate.command.compose import jobs_of
from ablate.settings.study import ConfigurationError
from ablate.study.comparable import untold_differences
from ablate.study.job import Job, trainings_of
from support.scene_folders import ball_folder


def names(jobs: Sequence[Job]) -> list[str]:
    """Of what is trained."""
    check(jobs)
    return [job.name for job in trainings_of(jobs)]


def test_a_key_that_decides_nothing_does_not_count_a_training_twice(tmp_path: Path) -> None:
    sites = {"heights": [-15, 0, 15], "angles": [-40, -10, 10, 40], "axis": [0, 0, 1]}
    folder = ball_folder(tmp_path / "ball", sites)
    words = ["-m", "preset=tiny", "scene=folder", f"scene.folder={folder}", f"runs_dir={tmp_path / 'runs'}"]
    assert names(jobs_of([*words, "scene.anatomy_seed=0,4"])) == ["sa2h/seed0"]
    assert names(jobs_of([*words, "training.threads=1,2"])) == ["sa2h/seed0"]
    assert names(jobs_of([*words, "seed=0,4"])) == ["sa2h/seed0", "sa2h/seed4"]
    assert len(names(jobs_of([*words, "study_name=one,another"]))) == 2


@pytest.mark.parametrize(
    "words", ["crops.fan_fraction=0,0.5", "training.loss=none training.discriminator_width=0.2,0.4"]
)
def test_a_key_of_what_is_not_there_trains_no_other_network(tmp_path: Path, words: str) -> None:
    """Whole frames are no crops, and without a discriminator nothing has its width."""
    assert len(names(jobs_of(["-m", "preset=quick", *words.split(), f"runs_dir={tmp_path}"]))) == 1


def test_what_networks_of_a_sweep_differ_in_beside_their_labels_is_said(tmp_path: Path) -> None:
    """Before the first training and in the report: the effect of a component is mixed with it."""
    words = ["-m", "preset=quick", f"runs_dir={tmp_path}", "model.space=beam,image"]
    assert untold_differences(jobs_of(words), "sa2h") == ["training.crop is 0 in sa2h, 128 in sa2h.space-image."]
    assert untold_differences(jobs_of([*words, "training.crop=0"]), "sa2h") == []
    assert untold_differences(jobs_of([*words[:3], "probe=convex,linear"]), "sa2h") == []


@pytest.mark.parametrize(
    "words",
    [
        "simulator.axial_samples=500,1000 simulator.samples_per_row=5",
        "dataset.validation=0.85 dataset.test=0.05,0.1",
        "variant=sa2h,sa2h-gan training.loss=none training.l1_weight=5,7",
    ],
)
def test_values_that_fit_together_may_be_swept(tmp_path: Path, words: str) -> None:
    """To name what is changed, the command line without it was once checked as if somebody had given it."""
    jobs = jobs_of(["-m", "preset=quick", *words.split(), "task=plan", f"runs_dir={tmp_path}"])
    assert len(jobs) >= 2
    assert len({job.label for job in jobs}) == len(jobs)


def test_one_job_of_values_that_fit_together_is_composed(tmp_path: Path) -> None:
    words = "variant=sa2h-gan training.loss=nonsaturating training.l1_weight=0 task=plan preset=tiny"
    (job,) = jobs_of([*words.split(), f"runs_dir={tmp_path}"])
    assert job.label == "sa2h-gan.loss-nonsaturating"


def test_a_batch_has_at_most_as_many_crops_as_there_are_training_frames(tmp_path: Path) -> None:
    def check_batch(size: int) -> None:
        check(jobs_of([f"runs_dir={tmp_path}", "dataset.frames=200", f"training.batch_size={size}"]))

    with pytest.raises(ConfigurationError, match=r"^training\.batch_size=200: more than the \d+ training") as refused:
        check_batch(200)
    (frames,) = (int(number) for number in re.findall(r"the (\d+) training", str(refused.value)))
    assert 100 < frames < 200
    check_batch(frames)
    with pytest.raises(ConfigurationError, match=f"batch_size={frames + 1}: more than the {frames} training frames"):
        check_batch(frames + 1)
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("task", ["plan", "study", "simulate"])
@pytest.mark.parametrize(("metric", "meant"), [("crsp", "; did you mean crps?"), ("my_metric", "")])
def test_a_component_is_judged_by_a_metric_that_there_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, task: str, metric: str, meant: str
) -> None:
    declared = (Component("mine", "model.noise", metric=metric, band=1.0),)
    monkeypatch.setattr(checks, "components", lambda: declared)
    jobs = jobs_of(["preset=tiny", f"task={task}", f"runs_dir={tmp_path}"])
    said = f"conf/component/mine.yaml: metric={metric}: allowed are psnr"
    with pytest.raises(ConfigurationError, match=f"^{re.escape(said)}.* metrics= names{re.escape(meant)}$"):
        check(jobs)
