"""From words of a command line to jobs: what Hydra composes of them, as frozen settings with a label.

A label is the variant and what was changed beside it, such as `sa2h.depth-8`.
"""

import itertools
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, suppress
from functools import cache, lru_cache
from typing import Any

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, ValueType
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ablate.command.refusals import in_one_line
from ablate.command.schema import register, settings
from ablate.networks import GeneratorSpec
from ablate.setting import plain
from ablate.settings.conf import CUSTOM, components, conf_folder, keys
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.study.job import Job, differences

CONFIG = "config"
VERSION_BASE = "1.3"
_CELLS = "cells"
_MULTIRUN = ("-m", "--multirun")
# Seeds and variants have places of their own.
_IN_NO_LABEL = frozenset({"model.target", "seed", "training.seed"})
_LIKE_A_COMPONENT = ("training.loss",)
_SIZE = "model.width"  # of all networks of a study alike, unless it is swept
_OF_SCORES = "evaluation."  # these settings decide scores, and no weights


def composed(overrides: Sequence[str]) -> DictConfig:
    """The whole configuration of one job, its node `hydra` included; what cannot be composed is refused in one line."""
    register()
    with in_one_line(overrides), ExitStack() as stack:
        if not GlobalHydra.instance().is_initialized():  # as the command line does it
            folder = str(conf_folder())
            stack.enter_context(initialize_config_dir(folder, version_base=VERSION_BASE, job_name="ablate"))
        return compose(CONFIG, list(overrides), return_hydra_config=True)


def parsed(words: Sequence[str]) -> list[Override]:
    """Words `key=value`, read by Hydra's grammar."""
    return OverridesParser.create().parse_overrides(list(words))


def quoted(path: object) -> str:
    """A path as Hydra reads it in `key=value`, with blanks, commas, brackets and quotes."""
    return "'" + str(path).replace("'", "\\'") + "'"


def job_of(
    words: Sequence[str], swept: Collection[str] = (), fixed: Sequence[str] = (), config: DictConfig | None = None
) -> Job:
    """The job that some words of a command line stand for.

    Parameters
    ----------
    words : sequence of str
        `key=value`, one value each.
    swept : collection of str
        The keys that a sweep gives several values: they are part of the label.
    fixed : sequence of str
        Words for Hydra itself, such as its search path.
    config : DictConfig, optional
        What Hydra has composed of all of them, where it has.
    """
    config = composed([*fixed, *words]) if config is None else config
    with in_one_line():
        chosen = settings(config)
        named = {*swept, *(component.key for component in components())}
        changed = changed_keys(parsed(words), config, chosen, named, fixed)
        return Job(chosen, label_of(chosen, changed), tuple(sorted(changed.items())))


def variant_model(name: str) -> GeneratorSpec:
    """The generator of a variant in the paper."""
    return job_of(["preset=paper", f"variant={name}"]).settings.model


def changed_keys(
    overrides: Sequence[Override],
    config: DictConfig,
    chosen: StudySettings,
    named: Collection[str],
    fixed: Sequence[str] = (),
) -> dict[str, Any]:
    """The dotted keys that a command line changes beside the variant, with their values.

    These are the keys of the network and of other declared components, and those in `named`, if their value is another
    than without them. Keys that decide no weights are left out. Of groups of conf/, a swept probe is named, and presets
    and scenes are where they share the name of a study.

    Parameters
    ----------
    overrides : sequence of Override
        The words of the command line.
    config, chosen : DictConfig, StudySettings
        What is composed of them, and the settings behind it.
    named : collection of str
        Keys that are named whenever their value is changed.
    fixed : sequence of str
        Words for Hydra itself.
    """
    groups = {"probe"} if chosen.study_name is None else {"probe", "preset", "scene"}
    changed = {o.key_or_group: o.value() for o in overrides if o.key_or_group in groups & set(named)}
    candidates: set[str] = set()
    kept = list(fixed)
    for override in overrides:
        found = _names(override, named)
        candidates |= found
        if not found and override.key_or_group not in _IN_NO_LABEL:
            kept.append(str(override.input_line))
    if candidates:
        before, after = _values(tuple(kept)), _plain(config)
        changed |= {key: after[key] for key in candidates if before.get(key) != after.get(key)}
    return changed


def _names(override: Override, named: Collection[str]) -> set[str]:
    """The keys that a word changes and a label may name: one, or those of `model={depth:8,noise:input}`."""
    group, value = override.key_or_group, override.value()
    changes = {f"{group}.{name}" for name in value} if isinstance(value, dict) else {group}
    wanted = {*named, *_LIKE_A_COMPONENT, *(key for key in _deciding() if key.startswith("model.") and key != _SIZE)}
    return {key for key in changes & _deciding() if key in wanted or group in wanted}


@cache
def _deciding() -> frozenset[str]:
    """The keys that decide the weights of a training, but for seeds and what stands in the label anyway."""
    deciding = {key for key, one in keys().items() if not one.declared.incidental} - _IN_NO_LABEL
    return frozenset(key for key in deciding if not key.startswith(_OF_SCORES))


@lru_cache(maxsize=64)
def _values(words: tuple[str, ...]) -> dict[str, Any]:
    """Every value of the configuration of some words, by key; it need not be one that could be run."""
    return _plain(composed(words))


def _plain(config: DictConfig) -> dict[str, Any]:
    """The values of a configuration by dotted key, as JSON has them; what cannot be resolved is left out."""
    own = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    return {key: plain(value) for key, value in _flat(own)}


def _flat(node: DictConfig, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name in map(str, node):
        if OmegaConf.is_missing(node, name):
            continue
        with suppress(OmegaConfBaseException):
            value = node[name]
            if isinstance(value, DictConfig):
                yield from _flat(value, f"{prefix}{name}.")
            else:
                yield f"{prefix}{name}", OmegaConf.to_container(value) if OmegaConf.is_config(value) else value


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
    return [job_of(line, swept) for line in lines]


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
    """Every job once: of those that ask for one training and the same scores of it, the first.

    Two trainings of one name, which tables could not tell apart, are a ConfigurationError.
    """
    first: dict[object, Job] = {}
    named: dict[object, Job] = {}
    for job in jobs:
        place, settings = job.settings.study_dir, job.settings
        twin = named.setdefault((place, job.name), job)
        if twin.hash != job.hash:
            unlike = ", ".join(key for key, *_ in differences(twin.identity, job.identity))
            apart = "give each a study_name of its own"
            raise ConfigurationError(f"two jobs of this sweep are called {job.name} and differ in {unlike}; {apart}")
        scores = (str(settings.metrics), settings.evaluation.noise_draws, settings.evaluation.inception)
        first.setdefault((place, job.hash, scores), job)
    return list(first.values())
