"""A run's label: its variant, and what was changed beside it, such as `sa2h.depth-8`."""

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any

from hydra.core.override_parser.types import Override

from ablate.runs.job import CUSTOM
from ablate.setting import flat, plain
from ablate.settings.study import StudySettings
from ablate.settings.values import keys

# The width is a size of the whole study, like the number of steps; seeds and variants have places of their own.
_IN_NO_LABEL = frozenset({"model.width", "model.target", "seed", "training.seed"})
_LIKE_A_COMPONENT = ("training.loss",)


def changed_keys(
    overrides: Sequence[Override],
    settings: StudySettings,
    named: Collection[str],
    base: Callable[[tuple[str, ...]], StudySettings],
) -> dict[str, Any]:
    """The dotted keys that a command line changes beside the variant, with their values.

    These are the keys of the network and of other declared components, and those in `named`, if their value is another
    than without them; `base` gives the settings that words stand for. Keys that decide no result are left out.
    """
    deciding = {key.name for key in keys() if not key.setting.declared.incidental} - _IN_NO_LABEL
    wanted = {*named, *_LIKE_A_COMPONENT, *(key for key in deciding if key.startswith("model."))}

    def changes(override: Override) -> set[str]:
        return {key for key in _keys_of(override) if _is_named(key, wanted) and _group_or(key, deciding)}

    candidates = {key for override in overrides for key in changes(override)}
    if not candidates:
        return {}
    plain_words = tuple(str(o.input_line) for o in overrides if not changes(o))
    without = base(plain_words)
    before, after = dict(flat(plain(without))), dict(flat(plain(settings)))
    changed = {key: after[key] for key in candidates & after.keys() if before.get(key) != after[key]}
    groups = {key for key in candidates - after.keys() if settings.study_dir == without.study_dir}
    values = {o.key_or_group: o.value() for o in overrides}
    return changed | {key: values[key] for key in groups}


def _keys_of(override: Override) -> Iterator[str]:
    """`model.depth=8` sets model.depth, and `model={depth:8,noise:input}` both of its keys."""
    key, value = override.key_or_group, override.value()
    if isinstance(value, dict):
        yield from (f"{key}.{name}" for name in value)
    else:
        yield key


def _is_named(key: str, wanted: Collection[str]) -> bool:
    return key in wanted or key.partition(".")[0] in wanted


def _group_or(key: str, deciding: Collection[str]) -> bool:
    """Whether a key decides a result, or names a group of conf/ such as `probe`, which is no variant."""
    return key in deciding or key in ("probe", "scene", "preset")


def label_of(settings: StudySettings, changed: Mapping[str, Any]) -> str:
    """The variant, then the last part of each changed key with its value; a network of the user's has its class name.

    Examples
    --------
    >>> label_of(StudySettings(), {"model.depth": 8, "training.reconstruction": "crps"})
    'sa2h.depth-8.reconstruction-crps'
    """
    variant = settings.variant
    if variant == CUSTOM:
        variant = str(settings.model.target).rpartition(".")[2]
    named = sorted(f"{key.rpartition('.')[2]}-{value}" for key, value in changed.items())
    return ".".join([variant, *(re.sub(r"[^A-Za-z0-9.+_-]", "_", name) for name in named)])
