"""What a search came to: the best trial of a sweeper of Hydra's that optimises a score."""

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from omegaconf import DictConfig, OmegaConf

from ablate.command.compose import job_of
from ablate.command.composed import parsed

_RESULTS = "optimization_results.yaml"  # Hydra's sweepers write it into hydra.sweep.dir


def said_of_search(config: DictConfig) -> list[str]:
    """Lines that say which trial of a search was best, its score, and where it lies; none of another sweeper.

    `config` is that of the command, with its node `hydra`, when the search has ended.
    """
    results = Path(str(config.hydra.sweep.dir)) / _RESULTS
    name = str(OmegaConf.select(config, "hydra.sweeper._target_") or "").rpartition(".")[2].removesuffix("Sweeper")
    if name in ("Cell", "Basic", ""):
        return []
    try:
        found = yaml.safe_load(results.read_text("utf-8"))
    except (OSError, yaml.YAMLError):
        found = None
    if isinstance(found, Mapping) and isinstance(best := found.get("best_params"), Mapping) and "best_value" in found:
        return _said(config, {str(key): best_of_key for key, best_of_key in best.items()}, found["best_value"])
    return [f"Search  {results} has what {name} has found"] if results.exists() else []


def _said(config: DictConfig, best: Mapping[str, Any], score: object) -> list[str]:
    """The words of the best trial, which are also how it is asked for again, its score and its folder."""
    words = [f"{key}={str(value).lower() if isinstance(value, bool) else value}" for key, value in best.items()]
    given = OmegaConf.to_container(config.hydra.overrides, resolve=False)
    assert isinstance(given, dict)
    kept = [word for word in given["task"] if _key(word) not in best and not parsed([word])[0].is_sweep_override()]
    job = job_of([*kept, *words], tuple(best), given["hydra"])
    folder = job.folder
    shown = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
    named = [word for word in kept if _key(word) in _OF_STUDY]
    shown_score = f"{score:.5g}" if isinstance(score, float | int) else score
    return [
        f"Best    {' '.join(words)}   ({config.objective} {shown_score})",
        f"Trial   {shown}",
        f"Look    {shlex.join(['python', '-m', 'ablate', 'task=compare', *named])}",
    ]


#: Words that name a study, which compares all trials.
_OF_STUDY = ("preset", "scene", "scene.folder", "study_name", "runs_dir")


def _key(word: str) -> str:
    return word.partition("=")[0].lstrip("+")
