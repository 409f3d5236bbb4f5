"""At the end of a search by a sweeper of Hydra's the best trial is named, with its score and its folder."""

import shlex
from pathlib import Path

import pytest
from omegaconf import DictConfig, open_dict

from ablate.command.compose import job_of, jobs_of
from ablate.command.composed import composed
from ablate.tasks.entry import Comparison

RATE = "training.learning_rate"
OPTUNA = "hydra_plugins.hydra_optuna_sweeper.optuna_sweeper.OptunaSweeper"


def search(folder: Path, target: str, *named: str) -> DictConfig:
    """What Hydra hands to a callback; the plugin, which composes it with this command line, need not be installed."""
    typed = ["preset=tiny", "objective=val/psnr_fan", f"runs_dir={folder}", *named]
    config = composed([*typed, f"hydra.sweep.dir={folder}/.hydra"])
    with open_dict(config):
        config.hydra.sweeper._target_ = target
        config.hydra.overrides.task = [*typed, f"{RATE}=tag(log,interval(1e-4,1e-2))", "seed=choice(0,1)"]
    (folder / ".hydra").mkdir()
    return config


# As hydra_optuna_sweeper 1.2 writes it.
FOUND = f"name: optuna\nbest_params:\n  {RATE}: 0.0015448048928672032\n  seed: 1\nbest_value: 23.61234\n"


def test_the_best_trial_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    config = search(tmp_path, OPTUNA, "study_name=rate")
    (tmp_path / ".hydra/optimization_results.yaml").write_text(FOUND)
    Comparison().on_multirun_end(config)
    words = ["preset=tiny", f"runs_dir={tmp_path}", "study_name=rate", f"{RATE}=0.0015448048928672032", "seed=1"]
    trial = job_of(words, [RATE, "seed"])
    assert capsys.readouterr().out.splitlines() == [
        f"Best    {RATE}=0.0015448048928672032 seed=1   (val/psnr_fan 23.612)",
        f"Trial   rate/sa2h.learning_rate-0.0015448048928672032-seed1-{trial.hash[:8]}",
        f"Look    python -m ablate task=compare preset=tiny runs_dir={tmp_path} study_name=rate",
    ]


def test_the_line_to_look_at_a_study_can_be_copied(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    config = search(tmp_path, OPTUNA, "study_name=my rate")
    (tmp_path / ".hydra/optimization_results.yaml").write_text(FOUND)
    Comparison().on_multirun_end(config)
    *_, trial, look = capsys.readouterr().out.splitlines()
    _, python, *words = shlex.split(look)
    assert (python, words[:2]) == ("python", ["-m", "ablate"])
    (job,) = jobs_of(words[2:])
    assert trial.startswith(f"Trial   {job.settings.study}/")


def test_nothing_is_said_of_a_search_that_was_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A file of an earlier search lies there."""
    config = search(tmp_path, "hydra_plugins.ablate_plugins.CellSweeper")
    (tmp_path / ".hydra/optimization_results.yaml").write_text(FOUND)
    Comparison().on_multirun_end(config)
    assert not capsys.readouterr().out


@pytest.mark.parametrize("text", ["name: optuna\nsolutions: []\n", "- odd\n", "a: ["])
def test_a_file_of_another_form_is_named(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = search(tmp_path, OPTUNA)
    file = tmp_path / ".hydra/optimization_results.yaml"
    file.write_text(text)
    Comparison().on_multirun_end(config)
    assert capsys.readouterr().out == f"Search  {file} has what Optuna has found\n"
