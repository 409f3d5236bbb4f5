"""From the command line to the list of jobs, composed and checked before anything starts."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from shutil import which

from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra._internal.utils import get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException
from omegaconf import DictConfig, OmegaConf, open_dict
from omegaconf.errors import OmegaConfBaseException

import ablate
from ablate.config import StudySettings, Task, register, settings


class ConfigurationError(ValueError):
    """What the user asked for cannot be run; the message is one line and says what is allowed."""


@dataclass(frozen=True)
class Job:
    """One cell of a sweep.

    Attributes
    ----------
    settings : StudySettings
    label : str
        The variant, plus what else was changed of its components or of `encoding` (`sa2h.depth-8`).
    """

    settings: StudySettings
    label: str

    @property
    def name(self) -> str:
        return f"{self.label}/seed{self.settings.seed}"

    @property
    def folder(self) -> Path:
        return self.settings.study_dir / self.label / f"seed{self.settings.seed}"


def configuration_dir() -> Path:
    """The folder conf/: inside the installed package, or beside src/ in a checkout."""
    package = Path(ablate.__file__).parent
    inside = package / "conf"
    return inside if inside.is_dir() else package.parents[1] / "conf"


def label_of(variant: str, overrides: Sequence[str]) -> str:
    """A run's label from its variant and the overrides it was composed with.

    The width is a size of the whole study, like the number of steps, and no part of it.
    """
    own = {"encoding": "echogenicity", **_model_of(variant)}
    changed = {name: value for override in _parse(list(overrides)) for name, value in _components(override)}
    named = [f"{name}-{value}" for name, value in sorted(changed.items()) if str(own.get(name)) != str(value)]
    return ".".join([variant, *(re.sub(r"[^A-Za-z0-9.+_-]", "_", name) for name in named)])


def _components(override: Override) -> Iterator[tuple[str, object]]:
    """What an override says of the components: `model.depth=8`, `model={depth:8,noise:input}` or `encoding=...`."""
    key, value = override.key_or_group, override.value()
    if key == "model" and isinstance(value, dict):
        yield from ((str(name), v) for name, v in value.items() if name != "width")
    elif key == "encoding" or (key.startswith("model.") and key != "model.width"):
        yield key.removeprefix("model."), value


def _model_of(variant: str) -> dict[str, object]:
    """What conf/variant says of the model; nothing for a variant from a folder of the user's."""
    path = configuration_dir() / "variant" / f"{variant}.yaml"
    if not path.exists():
        return {}
    own = OmegaConf.to_container(OmegaConf.load(path))
    assert isinstance(own, dict)
    inherited = [_model_of(str(parent)) for parent in own.get("defaults", [])]
    return {k: v for model in (*inherited, own.get("model", {})) for k, v in model.items()}


def asks_hydra(arguments: Sequence[str]) -> bool:
    """Whether a command line is a question to Hydra (`--help`, `--cfg job`, `--info`, ...) and starts no task."""
    parsed = get_args_parser().parse_args(list(arguments))
    questions = ("help", "hydra_help", "cfg", "info", "shell_completion")
    return any(getattr(parsed, name) not in (None, False) for name in questions)


def jobs_of(arguments: Sequence[str]) -> list[Job]:
    """Every job that a command line stands for.

    Parameters
    ----------
    arguments : sequence of str
        As after `python -m ablate`, Hydra's flags included.

    Returns
    -------
    list of Job
        One without `-m` (or a study group); the product of all swept values with it.

    Raises
    ------
    ConfigurationError
        For an unknown key, group entry or variant, a value of a wrong type or outside its range, in any of the
        jobs, and for two jobs that would share a place on disk.
    """
    parsed = get_args_parser().parse_args(list(arguments))
    for name in ("config_path", "config_name", "config_dir"):
        if getattr(parsed, name):
            raise ConfigurationError(
                f"--{name.replace('_', '-')}: not taken; add 'hydra.searchpath=[file:///a/folder]'"
            )
    register()
    with initialize_config_dir(str(configuration_dir()), version_base="1.3", job_name="ablate"):
        lists = _expand(parsed.overrides, multirun=bool(parsed.multirun))
        jobs = [_job(overrides) for overrides in lists]
    if jobs[0].settings.task is Task.simulate:
        return jobs  # as many as were asked for: those that read the same pairs fill them side by side
    places: dict[Path, Job] = {}
    for job in jobs:
        if places.setdefault(job.folder, job).settings != job.settings:
            raise ConfigurationError(
                f"two jobs of this sweep share the place {job.folder}; sweep variant, seed, encoding or model.*, "
                "or give each value a study_name of its own"
            )
    return list({job.folder: job for job in jobs}.values())


def cluster_folder(arguments: Sequence[str]) -> Path | None:
    """Where the jobs print that a command line hands to SLURM; None where they run on this machine.

    Raises
    ------
    ConfigurationError
        Where it does, and SLURM's commands are not on this machine.
    """
    overrides = _parse(get_args_parser().parse_args(list(arguments)).overrides)
    register()
    with initialize_config_dir(str(configuration_dir()), version_base="1.3", job_name="ablate"):
        plain = [o.input_line or "" for o in overrides if not o.is_sweep_override()]
        launcher = _compose(plain, with_hydra=True).hydra.launcher
    if not str(launcher._target_).endswith(".SlurmLauncher"):
        return None
    if which("srun") is None:
        raise ConfigurationError("hydra/launcher=slurm: there is no srun here; start it on a login node")
    return Path(launcher.submitit_folder).parent


def _expand(overrides: list[str], multirun: bool) -> list[list[str]]:
    plain = [o for o in _parse(overrides) if not o.is_sweep_override()]
    hydra = _compose([o.input_line or "" for o in plain], with_hydra=True).hydra
    params = [f"{k}={v}" for k, v in (hydra.sweeper.params or {}).items()]
    if not multirun and str(hydra.mode or "").rpartition(".")[2] != "MULTIRUN":
        swept = [o.input_line for o in _parse(overrides) if o.is_sweep_override()]
        if swept:
            raise ConfigurationError(f"'{swept[0]}' asks for several jobs: add -m")
        launcher = hydra.runtime.choices["hydra/launcher"]
        if launcher != "basic":
            raise ConfigurationError(f"hydra/launcher={launcher} starts the jobs of a sweep: add -m")
        return [overrides]
    try:
        return BasicSweeper.split_arguments(_parse([*params, *overrides]), None)[0]
    except HydraException as error:
        raise ConfigurationError(_one_line(error)) from error


def _parse(overrides: list[str]) -> list[Override]:
    try:
        return OverridesParser.create().parse_overrides(overrides)
    except HydraException as error:
        raise ConfigurationError(_one_line(error)) from error


def _job(overrides: list[str]) -> Job:
    config = _compose(overrides)
    try:
        made = settings(config)
    except OmegaConfBaseException as error:
        key = error.full_key or "a value"
        raise ConfigurationError(f"{key} must be given: {key}=...") from error
    except ValueError as error:
        raise ConfigurationError(_one_line(error)) from error
    return Job(made, label_of(made.variant, overrides))


def _compose(overrides: list[str], with_hydra: bool = False) -> DictConfig:
    try:
        return compose("config", overrides, return_hydra_config=with_hydra)
    except (HydraException, OmegaConfBaseException) as error:
        raise ConfigurationError(_explain(error)) from error


def _explain(error: Exception) -> str:
    """Hydra's message on one line, with what is allowed where a key or a choice is unknown."""
    choice = re.search(
        r"Could not find '(.+)/([^/]+)'\s+Available options in '.+?':(.*?)\n\s*Config search", str(error), re.S
    )
    if choice:
        return f"{choice[1]}={choice[2]}: allowed are {', '.join(choice[3].split())}"
    cause = error.__cause__ if isinstance(error.__cause__, OmegaConfBaseException) else error
    text = _one_line(error).partition("; Config search path")[0]
    text = text if cause is error else f"{text}: {_one_line(cause)}"
    key = getattr(cause, "full_key", None)
    unknown = re.search(r"(?:Key|key) '([^']+)' (?:is not in struct|not in '\w+')", f"{text} {_one_line(cause)}")
    if unknown and key:
        parent, _, last = str(key).rpartition(".")
        node = OmegaConf.select(compose("config"), parent) if parent else compose("config")
        if OmegaConf.is_dict(node):
            names = sorted(str(k) for k in node)
            close = get_close_matches(last, names, n=1)
            hint = f"; did you mean '{close[0]}'?" if close else ""
            return f"unknown key '{key}'{hint} allowed{' in ' + parent if parent else ''}: {', '.join(names)}"
    return text.removeprefix("Error merging override ")


def _one_line(error: BaseException) -> str:
    lines = [line.strip() for line in str(error).splitlines()]
    lines = [
        x
        for x in lines
        if x and not x.startswith(("full_key:", "object_type=", "reference_type=", "To append to your config"))
    ]
    return "; ".join(lines)


def job_from_hydra(config: DictConfig, overrides: Sequence[str]) -> Job:
    """The job that Hydra composed inside a launched process."""
    with open_dict(config):
        config.pop("hydra", None)
    made = settings(config)
    return Job(made, label_of(made.variant, overrides))
