"""From words of a command line to jobs: what Hydra composes of them, as frozen settings with a label.

A label is the variant and what was changed beside it, such as `sa2h.depth-8`.
"""

import itertools
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from copy import deepcopy
from functools import cache
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, OverrideType, ValueType
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ablate.jobs.refusals import in_one_line
from ablate.jobs.schema import register, settings
from ablate.networks import GeneratorSpec
from ablate.runs.job import Job
from ablate.setting import flat, plain
from ablate.settings.conf import CUSTOM, components, conf_folder, keys
from ablate.settings.study import ConfigurationError, StudySettings, Task

CONFIG = "config"
VERSION_BASE = "1.3"
_CELLS = "cells"
_MULTIRUN = ("-m", "--multirun")
# Seeds and variants have places of their own.
_IN_NO_LABEL = frozenset({"model.target", "seed", "training.seed"})
_LIKE_A_COMPONENT = ("training.loss",)
_SIZE = "model.width"  # of all networks of a study alike, unless it is swept


def composed(overrides: Sequence[str]) -> DictConfig:
    """The whole configuration of one job, its node `hydra` included; what cannot be composed is refused in one line.

    Hydra takes long to read files: it composes the words that choose them once, and plain values are given to a copy.
    """
    register()
    with in_one_line(overrides), ExitStack() as stack:
        if not GlobalHydra.instance().is_initialized():  # as the command line does it
            folder = str(conf_folder())
            stack.enter_context(initialize_config_dir(folder, version_base=VERSION_BASE, job_name="ablate"))
        searched = GlobalHydra.instance().config_loader().get_search_path().get_path()
        files = {path: path.stat().st_mtime_ns for path in sorted(conf_folder().rglob("*.yaml"))}
        groups = {path.parent.name for path in files}
        words = [(override, _kind(override, groups)) for override in parsed(overrides)]
        alone = "command-line" not in {each.provider for each in searched}  # without --config-dir
        if alone and all(kind for _, kind in words):
            chosen = tuple(str(override.input_line) for override, kind in words if kind == "file")
            config = deepcopy(_of_files(chosen, tuple(files.items())))
            with suppress(OmegaConfBaseException):  # which Hydra explains
                for override in (override for override, kind in words if kind == "value"):
                    OmegaConf.update(config, override.key_or_group, override.value(), merge=True)
                return config
        return compose(CONFIG, list(overrides), return_hydra_config=True)


@cache
def _of_files(words: tuple[str, ...], _state: object) -> DictConfig:
    return compose(CONFIG, list(words), return_hydra_config=True)


def _kind(override: Override, groups: Collection[str]) -> str | None:
    """Whether a word chooses a file of conf/, or is for Hydra itself; whether it gives a value; None for others."""
    key = override.key_or_group
    if override.is_sweep_override() or override.package is not None or key == "hydra.searchpath":
        return None
    chooses = key in groups and isinstance(override.value(), str)
    if override.type in (OverrideType.CHANGE, OverrideType.ADD) and (chooses or key.startswith(("hydra.", "hydra/"))):
        return "file"
    gives = key not in groups or isinstance(override.value(), dict)
    return "value" if override.type is OverrideType.CHANGE and gives else None


def parsed(words: Sequence[str]) -> list[Override]:
    """Words `key=value`, read by Hydra's grammar."""
    return OverridesParser.create().parse_overrides(list(words))


def quoted(path: object) -> str:
    """A path as Hydra reads it in `key=value`, with blanks, commas, brackets and quotes."""
    return "'" + str(path).replace("'", "\\'") + "'"


def job_of(
    words: Sequence[str], swept: Collection[str] = (), fixed: Sequence[str] = (), config: DictConfig | None = None
) -> Job:
    """The job that the words `key=value` of a command line stand for.

    `swept` are the keys that a sweep gives several values: they are part of the label. `fixed` are words for Hydra
    itself, such as its search path. `config` is what Hydra has composed of all of them, where it has.
    """
    config = composed([*fixed, *words]) if config is None else config
    with in_one_line():
        made = settings(config)
        changed = changed_keys(parsed(words), made, {*swept, *(c.key for c in components())}, fixed)
        return Job(made, label_of(made, changed), tuple(sorted(changed.items())))


def variant_model(name: str) -> GeneratorSpec:
    """The generator of a variant in the paper."""
    return job_of(["preset=paper", f"variant={name}"]).settings.model


def changed_keys(
    overrides: Sequence[Override], made: StudySettings, named: Collection[str], fixed: Sequence[str] = ()
) -> dict[str, Any]:
    """The dotted keys that a command line changes beside the variant, with their values.

    These are the keys of the network and of other declared components, and those in `named`, if their value is another
    than without them; `fixed` are words for Hydra itself. Keys that decide no result are left out. Of groups of conf/,
    a swept probe is named, and presets and scenes are where they share the name of a study.
    """
    deciding = {key for key, one in keys().items() if not one.declared.incidental} - _IN_NO_LABEL
    wanted = {*named, *_LIKE_A_COMPONENT, *(key for key in deciding - {_SIZE} if key.startswith("model."))}
    groups = {"probe"} if made.study_name is None else {"probe", "preset", "scene"}
    changed = {o.key_or_group: o.value() for o in overrides if o.key_or_group in groups & set(named)}

    def changes(override: Override) -> set[str]:
        key, value = override.key_or_group, override.value()
        own = {f"{key}.{name}" for name in value} if isinstance(value, dict) else {key}  # `model={depth:8,noise:input}`
        return {key for key in own & deciding if key in wanted or key.partition(".")[0] in wanted}

    if candidates := {key for override in overrides for key in changes(override)}:
        kept = [str(o.input_line) for o in overrides if not changes(o) and o.key_or_group not in _IN_NO_LABEL]
        if made.variant == CUSTOM:  # which is nothing without its class
            kept.append(f"model.target={made.model.target}")
        without = settings(composed([*fixed, *kept]))
        before, after = dict(flat(plain(without))), dict(flat(plain(made)))
        changed |= {key: after[key] for key in candidates if before.get(key) != after.get(key)}
    return changed


def label_of(settings: StudySettings, changed: Mapping[str, Any]) -> str:
    """The variant, then the last part of each changed key with its value; a custom network has its class name."""
    variant = settings.variant
    if variant == CUSTOM:
        variant = str(settings.model.target).rpartition(".")[2]
    named = sorted(f"{key.rpartition('.')[2]}-{value}" for key, value in changed.items())
    return ".".join([variant, *(re.sub(r"[^A-Za-z0-9.+_-]", "_", name) for name in named)])


def jobs_of(arguments: Sequence[str]) -> list[Job]:
    """The jobs of a command line, given as the words after `python -m ablate`; nothing is started."""
    words = [word for word in arguments if word not in _MULTIRUN]
    with in_one_line():
        overrides = parsed(words)
    fixed = [str(o.input_line) for o in overrides if not o.is_sweep_override()]
    master = composed(fixed)
    if len(words) == len(arguments) and str(master.hydra.mode or "").rpartition(".")[2] != "MULTIRUN":
        return [job_of(words, config=master if len(fixed) == len(words) else None)]
    lines = cells(master.hydra.sweeper.params, words)
    swept = swept_keys(lines, words)
    return without_repetitions([job_of(line, swept) for line in lines])


def cells(params: DictConfig | Mapping[str, Any] | None, words: Sequence[str]) -> list[list[str]]:
    """The words of each job of a sweep: the product of its swept keys, for each of its cells.

    `params`, which is `hydra.sweeper.params`, may list `cells` that are no product, such as those of a fraction of a
    factorial: a cell is a line of words. Where the command line sets a key too, its value counts.
    """
    if several := [o.input_line for o in parsed(words) if o.key_or_group == "study" and o.is_sweep_override()]:
        raise ConfigurationError(f"{several[0]}: allowed is one study a command, as each has a sweep of its own")
    # Not resolved: `${levels:8}` is that of each job's own frame.
    given = OmegaConf.to_container(params, resolve=False) if isinstance(params, DictConfig) else dict(params or {})
    assert isinstance(given, dict)
    lines = str(given.pop(_CELLS, "")).splitlines() or [""]
    swept = [f"{key!s}={value}" for key, value in given.items()]
    with in_one_line():
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
        elif override.is_discrete_sweep() and override.value_type is not ValueType.GLOB_CHOICE_SWEEP:
            values[key] = [f"{key}={value}" for value in override.sweep_string_iterator()]
        else:
            raise ValueError(f"{override.input_line}: allowed are lists and ranges, as variant=sa2h,nsa2h")
    for combination in itertools.product(*values.values()):
        yield list(combination)


def swept_keys(lines: Sequence[Sequence[str]], words: Sequence[str]) -> set[str]:
    """The keys of jobs' words that the command line does not fix to one value."""
    fixed = {o.key_or_group for o in parsed([w for w in words if "=" in w]) if not o.is_sweep_override()}
    return {o.key_or_group for line in lines for o in parsed(line)} - fixed


def without_repetitions(jobs: Sequence[Job]) -> list[Job]:
    """Every job once; jobs that differ must not share a place. Jobs that simulate alone may: they fill the same pairs.

    Jobs that differ in keys that are no part of a label, such as `training.device`, are a ConfigurationError.
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
