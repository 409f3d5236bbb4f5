"""From words of a command line to jobs: what Hydra composes of them, as frozen settings with a label; and sweeps."""

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override, ValueType
from omegaconf import DictConfig, OmegaConf

from ablate.command.composed import CONFIG, composed, parsed, read_own_components
from ablate.command.labels import changed_keys, changes_of, label_of
from ablate.command.refusals import in_one_line
from ablate.command.schema import settings
from ablate.command.words import MULTIRUN, readable
from ablate.networks import GeneratorSpec
from ablate.settings.components import components
from ablate.settings.study import ConfigurationError
from ablate.study.job import Job, differences

_CELLS = "cells"


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
    hydra = config.hydra if "hydra" in config else HydraConfig.get()
    if hydra.job.chdir:
        allowed = "allowed is false, as paths begin where the command is typed and results lie in runs_dir"
        raise ConfigurationError(f"hydra.job.chdir=true: {allowed}")
    read_own_components(hydra)
    with in_one_line():
        chosen = settings(config)
        named = {*swept, *(component.key for component in components())}
        changed = changed_keys(parsed(words), config, chosen, named, fixed)
        return Job(chosen, label_of(chosen, changed), tuple(sorted(changed.items())), (*fixed, *words))


def variant_model(name: str) -> GeneratorSpec:
    """The generator of a variant in the paper."""
    words = ["preset=paper", f"variant={name}"]
    return job_of(words, config=composed(words, CONFIG)).settings.model


def jobs_of(arguments: Sequence[str]) -> list[Job]:
    """The jobs of a command line, given as the words after `python -m ablate`; nothing is started."""
    words = [word for word in readable(arguments) if word not in MULTIRUN]
    with in_one_line(words):
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
    values: dict[tuple[str, int], list[str]] = {}
    for number, override in enumerate(overrides):
        key = override.get_key_element()
        if not override.is_sweep_override():
            several, words = [override.value()], [f"{key}={override.get_value_element_as_str()}"]
        elif override.is_discrete_sweep() and override.value_type is not ValueType.GLOB_CHOICE_SWEEP:
            several = list(override.sweep_iterator())
            words = [f"{key}={value}" for value in override.sweep_string_iterator()]
        else:
            raise ValueError(f"{override.input_line}: allowed are lists and ranges, as variant=sa2h,nsa2h")
        # Of two values of a key the last counts, and is set last; two of a group, model={...}, are both set.
        is_group = all(isinstance(value, dict) for value in several)
        if not is_group:
            values.pop((key, 0), None)
        values[key, number + 1 if is_group else 0] = words
    for combination in itertools.product(*values.values()):
        yield list(combination)


def swept_keys(lines: Sequence[Sequence[str]], words: Sequence[str]) -> set[str]:
    """The keys of jobs' words that the command line does not fix to one value; of a group, model={...}, each key."""
    fixed = {k for o in parsed([w for w in words if "=" in w]) if not o.is_sweep_override() for k in changes_of(o)}
    return {key for line in lines for override in parsed(line) for key in changes_of(override)} - fixed


def refuse_other_launcher(master: DictConfig, job: DictConfig, words: Sequence[str]) -> None:
    """Refuse a job whose files choose a launcher or a sweeper: these start all jobs, and are those of the command.

    `words` are those of the job that are swept.
    """
    for node in ("launcher", "sweeper"):
        theirs, ours = (OmegaConf.to_container(config.hydra[node], resolve=False) for config in (job, master))
        assert isinstance(theirs, dict)
        assert isinstance(ours, dict)
        of_jobs = {"swept": None, "source": None}
        if {**theirs, **of_jobs} != {**ours, **of_jobs}:
            chosen = f"hydra/{node} ({job.hydra.runtime.choices[f'hydra/{node}']}) or its settings"
            reason = f"one {node} is for all jobs of a sweep: type both beside -m"
            raise ConfigurationError(f"{' '.join(words)}: a file chooses {chosen}; {reason}")


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
