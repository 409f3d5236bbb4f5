"""What cannot be trained is refused before anything is simulated."""

import re
from pathlib import Path

import pytest
from ablate.jobs.compose import jobs_of
from ablate.jobs.preflight import check

from ablate.settings.study import ConfigurationError
from support.scene_folders import ball_folder


def test_a_key_that_decides_nothing_does_not_count_a_run_twice(tmp_path: Path) -> None:
    sites = {"heights": [-15, 0, 15], "angles": [-40, -10, 10, 40], "axis": [0, 0, 1]}
    folder = ball_folder(tmp_path / "ball", sites)
    words = ["-m", "preset=tiny", "scene=folder", f"scene.folder={folder}", f"runs_dir={tmp_path / 'runs'}"]
    with pytest.raises(
        ConfigurationError, match=r"^scene\.anatomy_seed: decides nothing here, sa2h.* are the same run"
    ):
        check(jobs_of([*words, "scene.anatomy_seed=0,4"]))
    check(jobs_of([*words, "seed=0,4"]))
    check(jobs_of([*words, "study_name=one,another"]))


@pytest.mark.parametrize(
    "words", ["crops.fan_fraction=0,0.5", "training.loss=none training.discriminator_width=0.2,0.4"]
)
def test_a_key_of_what_is_not_there_is_no_component(tmp_path: Path, words: str) -> None:
    """Whole frames are no crops, and without a discriminator nothing has its width: the networks would be the same."""
    key = words.split()[-1].partition("=")[0]
    jobs = jobs_of(["-m", "preset=quick", *words.split(), f"runs_dir={tmp_path}"])
    with pytest.raises(ConfigurationError, match=f"^{key}: decides nothing here"):
        check(jobs)


def test_a_sweep_that_is_no_study_is_refused_before_its_first_training(tmp_path: Path) -> None:
    words = ["-m", "preset=quick", f"runs_dir={tmp_path}", "model.space=beam,image"]
    with pytest.raises(ConfigurationError, match=r"cannot be one study: .*training\.crop: 0 there, 128 here"):
        check(jobs_of(words))
    check(jobs_of([*words, "task=simulate"]))
    check(jobs_of([*words, "training.crop=0"]))
    check(jobs_of([*words[:3], "probe=convex,linear"]))


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
