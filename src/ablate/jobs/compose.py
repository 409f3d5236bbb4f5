"""From words of a command line to jobs: what Hydra composes of them, as frozen settings with a label."""

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cache
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf

from ablate.jobs.labels import changed_keys, label_of
from ablate.jobs.refusals import in_one_line
from ablate.jobs.schema import register, settings
from ablate.runs.job import Job
from ablate.settings.components import components
from ablate.settings.conf_folder import conf_folder
from ablate.settings.study import ConfigurationError, StudySettings, Task

CONFIG = "config"
VERSION_BASE = "1.3"
_CELLS = "cells"
_MULTIRUN = ("-m", "--multirun")


def composed(overrides: Sequence[str]) -> DictConfig:
    """The whole configuration of one job, its node `hydra` included; what cannot be composed is refused in one line."""
    register()
    with in_one_line(overrides), _initialised():
        return compose(CONFIG, list(overrides), return_hydra_config=True)


def _initialised() -> AbstractContextManager[object]:
    """Hydra as the command line has initialised it, or else with the folder conf/."""
    if GlobalHydra.instance().is_initialized():
        return nullcontext()
    return initialize_config_dir(str(conf_folder()), version_base=VERSION_BASE, job_name="ablate")


def parsed(words: Sequence[str]) -> list[Override]:
    """Words `key=value`, read by Hydra's grammar."""
    return OverridesParser.create().parse_overrides(list(words))


def job_of(words: Sequence[str], swept: Collection[str] = (), fixed: Sequence[str] = ()) -> Job:
    """The job that the words `key=value` of a command line stand for.

    `swept` are the keys that a sweep gives several values: they are part of the label. `fixed` are words for Hydra
    itself, such as its search path.
    """
    config = composed([*fixed, *words])
    with in_one_line(words):
        made = settings(config)
        declared = {component.key for component in components()}
        changed = changed_keys(parsed(words), made, {*swept, *declared}, _base_of(tuple(fixed)))
        return Job(made, label_of(made, changed), tuple(sorted(changed.items())))


def _base_of(fixed: tuple[str, ...]) -> Callable[[tuple[str, ...]], StudySettings]:
    """A function that gives the settings without the words that change a component."""
    return lambda words: _settings_of((*fixed, *words))


@cache
def _settings_of(words: tuple[str, ...]) -> StudySettings:
    """Composed once for all jobs of a sweep, which mostly share what their labels are told from."""
    return settings(composed(words))


def jobs_of(arguments: Sequence[str]) -> list[Job]:
    """The jobs of a command line, given as the words after `python -m ablate`; nothing is started.

    Examples
    --------
    >>> [job.name for job in jobs_of(["-m", "variant=sa2h,nsa2h"])]
    ['sa2h/seed0', 'nsa2h/seed0']
    """
    words = [word for word in arguments if word not in _MULTIRUN]
    with in_one_line(words):
        overrides = parsed(words)
    fixed = [str(o.input_line) for o in overrides if not o.is_sweep_override()]
    master = composed(fixed)
    if len(words) == len(arguments) and str(master.hydra.mode or "").rpartition(".")[2] != "MULTIRUN":
        return [job_of(words)]
    lines = cells(master.hydra.sweeper.params, words)
    swept = swept_keys(lines, words)
    return without_repetitions([job_of(line, swept) for line in lines])


def cells(params: DictConfig | Mapping[str, Any] | None, words: Sequence[str]) -> list[list[str]]:
    """The words of each job of a sweep: the product of its swept keys, for each of its cells.

    `params`, which is `hydra.sweeper.params`, may list `cells` that are no product, such as those of a fraction of a
    factorial: a cell is a line of words. Where the command line sets a key too, its value counts.
    """
    # Not resolved: `${levels:8}` is that of each job's own frame.
    given = OmegaConf.to_container(params, resolve=False) if isinstance(params, DictConfig) else dict(params or {})
    assert isinstance(given, dict)
    lines = str(given.pop(_CELLS, "")).splitlines() or [""]
    swept = [f"{key!s}={value}" for key, value in given.items()]
    with in_one_line(words):
        jobs = [job for line in lines for job in _product(parsed([*swept, *line.split(), *words]))]
    if not jobs:
        empty = ", ".join(word for word in words if parsed([word])[0].is_sweep_override())
        raise ConfigurationError(f"{empty}: a sweep without a job; allowed is at least one value of each key")
    return jobs


def _product(overrides: Sequence[Override]) -> Iterator[list[str]]:
    """Every combination of the values of swept keys, the last key running fastest."""
    values: dict[str, list[str]] = {}
    for override in overrides:
        key = override.get_key_element()
        if not override.is_sweep_override():
            values[key] = [f"{key}={override.get_value_element_as_str()}"]
        elif override.is_discrete_sweep():
            values[key] = [f"{key}={value}" for value in override.sweep_string_iterator()]
        else:
            raise ValueError(f"{override.input_line}: allowed are lists and ranges; an interval needs its own sweeper")
    for combination in itertools.product(*values.values()):
        yield list(combination)


def swept_keys(lines: Sequence[Sequence[str]], words: Sequence[str]) -> set[str]:
    """The keys of jobs' words that the command line does not fix to one value."""
    fixed = {o.key_or_group for o in parsed([w for w in words if "=" in w]) if not o.is_sweep_override()}
    return {o.key_or_group for line in lines for o in parsed(line)} - fixed


def without_repetitions(jobs: Sequence[Job]) -> list[Job]:
    """Every job once; jobs that differ must not share a place. Jobs that simulate alone may: they fill the same pairs.

    Raises
    ------
    ConfigurationError
        Where two jobs differ in keys that are no part of a label, such as `training.device`.
    """
    if jobs and jobs[0].settings.task is Task.simulate:
        return list(jobs)
    places: dict[object, Job] = {}
    for job in jobs:
        if places.setdefault(job.folder, job).settings != job.settings:
            raise ConfigurationError(
                f"two jobs of this sweep share the place {job.folder}; "
                "sweep a key that decides a result, or give each value a study_name of its own"
            )
    return list(places.values())
