"""Compose the jobs of a command line, each once. What cannot be composed is refused in one line."""

import dataclasses
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from shutil import which
from typing import get_type_hints

from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException

from ablate.config import ConfigurationError, StudySettings, Task
from ablate.studies.jobs import hydra_internals
from ablate.studies.jobs.conf_folder import configuration_dir
from ablate.studies.jobs.hydra_internals import Override
from ablate.studies.jobs.job import Job, label_of
from ablate.studies.jobs.launch import ComposedJob, Launch
from ablate.studies.jobs.schema import register, settings
from ablate.ultrasound.probe_kinds import PROBE_KEYS, Probe
from ablate.validation import shown

_CELLS = "cells"
_SLURM = "ablate.studies.jobs.slurm.QueueLauncher"


@dataclass(frozen=True)
class CommandLine:
    """The jobs of a command line, at least one, and what starts them."""

    jobs: list[Job]
    launch: Launch


def jobs_of(arguments: Sequence[str]) -> list[Job]:
    """The jobs of a command line; see `read_command_line`."""
    command = read_command_line(arguments)
    assert command is not None, "a question to Hydra has no jobs"
    return command.jobs


def read_command_line(arguments: Sequence[str]) -> CommandLine | None:
    """Compose every job of a command line, given as the words after `python -m ablate`.

    Without `-m` (or a study group) there is one job, with it the product of all swept values. A question to Hydra
    (`--help`, `--cfg job`, ...) is answered and gives None. What cannot be run is a ConfigurationError: an unknown
    key or choice, a value of a wrong type or outside its range in any job, two jobs that would share a place on
    disk, SLURM on a machine without it.
    """
    register()
    parsed = hydra_internals.parse_arguments(arguments)
    if hydra_internals.is_question(parsed):
        hydra_internals.answer(configuration_dir())
        return None
    for name in ("config_path", "config_name", "config_dir"):
        if getattr(parsed, name):
            flag = name.replace("_", "-")
            raise ConfigurationError(f"--{flag}: not taken; add 'hydra.searchpath=[file:///a/folder]'")
    with hydra_internals.composing(configuration_dir()):
        overrides = [_parsed(line) for line in parsed.overrides]
        fixed = [str(o.input_line) for o in overrides if not o.is_sweep_override()]
        master = _compose(fixed)
        multirun = parsed.multirun or str(master.hydra.mode or "").rpartition(".")[2] == "MULTIRUN"
        if multirun:
            made = [_composed_job(line, _compose(line)) for line in _expand(master, overrides)]
        else:
            _check_single(master, overrides)
            made = [_composed_job(fixed, master)]
        path = hydra_internals.search_path()
    if not made:
        empty = [str(o.input_line) for o in overrides if o.is_sweep_override()]
        raise ConfigurationError(
            f"{', '.join(empty)}: a sweep without a job; allowed is at least one value of each key"
        )
    if made[0].job.settings.task is not Task.simulate:  # jobs that read the same pairs fill them side by side
        made = _without_repetitions(made)
    return CommandLine(
        [m.job for m in made], Launch(tuple(made), master if multirun else None, path, _cluster_folder(master))
    )


def _expand(master: DictConfig, overrides: Sequence[Override]) -> list[list[str]]:
    """The overrides of each job of a sweep: the product of its swept keys, for each of its cells.

    `hydra.sweeper.params.cells` may list cells that are no product, such as those of a fraction of a factorial. A cell
    is a line of overrides.
    """
    sweeper = master.hydra.runtime.choices["hydra/sweeper"]
    if sweeper != "basic":
        known = "the jobs of a study are known before it starts"
        raise ConfigurationError(f"hydra/sweeper={sweeper}: allowed is basic; {known}")
    # Not resolved: `${levels:8}` is that of each job's own frame.
    params = OmegaConf.to_container(master.hydra.sweeper.params or OmegaConf.create(), resolve=False)
    assert isinstance(params, dict)
    cells = str(params.pop(_CELLS, "")).splitlines() or [""]
    swept = [f"{k!s}={v}" for k, v in params.items()]
    with _in_one_line():
        each = [hydra_internals.parse_overrides([*swept, *cell.split()]) for cell in cells]
        return [job for cell in each for job in hydra_internals.product([*cell, *overrides])]


def _parsed(line: str) -> Override:
    """One word of the command line; what Hydra cannot read is named, with what helps."""
    try:
        return hydra_internals.parse_overrides([line])[0]
    except HydraException as error:
        key, is_given, value = line.partition("=")
        if not is_given or value.startswith(("'", '"')):
            raise ConfigurationError(_one_line(error)) from error
        hint = "without the comma at its end" if value.endswith(",") else f"in quotes: \"{key}='...'\""
        raise ConfigurationError(f"{key}: Hydra cannot read the value {shown(value)}; give it {hint}") from error


def _check_single(master: DictConfig, overrides: Sequence[Override]) -> None:
    """Refuse what asks for several jobs where `-m` is missing."""
    for override in overrides:
        if override.is_sweep_override():
            raise ConfigurationError(f"'{override.input_line}' asks for several jobs: add -m")
    launcher = master.hydra.runtime.choices["hydra/launcher"]
    if launcher != "basic":
        raise ConfigurationError(f"hydra/launcher={launcher} starts the jobs of a sweep: add -m")


def _composed_job(overrides: Sequence[str], config: DictConfig) -> ComposedJob:
    try:
        made = settings(config)
        return ComposedJob(Job(made, label_of(made, overrides)), tuple(overrides), config)
    except MissingMandatoryValue as error:
        key = error.full_key or "a value"
        raise ConfigurationError(f"{key} must be given: {key}=...") from error
    except OmegaConfBaseException as error:
        raise ConfigurationError(f"{error.full_key}: {_one_line(error)}") from error
    except ValueError as error:
        raise ConfigurationError(_one_line(error)) from error


def _without_repetitions(made: Sequence[ComposedJob]) -> list[ComposedJob]:
    """Every job once; jobs that differ must not share a place."""
    places: dict[Path, ComposedJob] = {}
    for one in made:
        place = one.job.folder
        if places.setdefault(place, one).job.settings != one.job.settings:
            raise ConfigurationError(
                f"two jobs of this sweep share the place {place}; sweep variant, seed, encoding or model.*, "
                "or give each value a study_name of its own"
            )
    return list(places.values())


def _cluster_folder(master: DictConfig) -> Path | None:
    """Where the jobs print that SLURM runs; None where they run on this machine."""
    if master.hydra.launcher["_target_"] != _SLURM:
        return None
    if which("srun") is None:
        raise ConfigurationError("hydra/launcher=slurm: there is no srun here; start it on a login node")
    return Path(master.hydra.launcher.submitit_folder).parent


@contextmanager
def _in_one_line() -> Iterator[None]:
    try:
        yield
    except HydraException as error:
        raise ConfigurationError(_one_line(error)) from error


def _compose(overrides: Sequence[str]) -> DictConfig:
    try:
        return hydra_internals.composed(overrides)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigurationError(_explain(error)) from error
    except (TypeError, ValueError) as error:  # Hydra's, where a file of conf/ is named by something that is no text
        for override in hydra_internals.parse_overrides(overrides):
            group = override.key_or_group
            if (configuration_dir() / group).is_dir() and not isinstance(override.value(), str):
                names = ", ".join(sorted(path.stem for path in (configuration_dir() / group).glob("*.yaml")))
                raise ConfigurationError(f"{override.input_line}: allowed are {names}") from error
        raise


def _explain(error: Exception) -> str:
    """Hydra's message on one line, with what is allowed where a key or a choice is unknown."""
    unknown_choice = r"Could not find '(.+)/([^/]+)'\s+Available options in '.+?':(.*?)\n\s*Config search"
    if choice := re.search(unknown_choice, str(error), re.S):
        return f"{choice[1]}={choice[2]}: allowed are {', '.join(choice[3].split())}"
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    text = _one_line(error).partition("; Config search path")[0]
    text = text if cause is error else f"{text}: {_one_line(cause)}"
    key = getattr(cause, "full_key", None)
    unknown = re.search(r"(?:Key|key) '([^']+)' (?:is not in struct|not in '\w+')", f"{text} {_one_line(cause)}")
    parent, _, last = str(key or "").rpartition(".")
    if unknown and key and (names := _keys(parent)):
        close = get_close_matches(last, names, n=1)
        hint = f"; did you mean '{close[0]}'?" if close else ""
        return f"unknown key '{key}'{hint} allowed{' in ' + parent if parent else ''}: {', '.join(names)}"
    return text.removeprefix("Error merging override ")


def _keys(group: str) -> list[str]:
    """The keys of a group of settings, such as `training`; of all settings for an empty name."""
    cls: type = StudySettings
    for name in group.split(".") if group else ():
        cls = get_type_hints(cls).get(name, object)
    if cls == Probe:
        return sorted(["kind", *PROBE_KEYS])
    return sorted(f.name for f in dataclasses.fields(cls)) if dataclasses.is_dataclass(cls) else []


def _one_line(error: BaseException) -> str:
    details = ("full_key:", "object_type=", "reference_type=", "To append to your config")
    lines = [line.strip() for line in str(error).splitlines()]
    return "; ".join(line for line in lines if line and not line.startswith(details))
