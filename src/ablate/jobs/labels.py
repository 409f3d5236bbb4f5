"""A run's label: its variant, and what was changed beside it, such as `sa2h.depth-8`."""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
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
    than without them; `base` gives the settings that words stand for. Keys that decide no result are left out. Of
    groups of conf/, a swept probe is named, and presets and scenes are where they share the name of a study.
    """
    deciding = {key.name for key in keys() if not key.setting.declared.incidental} - _IN_NO_LABEL
    wanted = {*named, *_LIKE_A_COMPONENT, *(key for key in deciding if key.startswith("model."))}
    groups = {"probe"} if settings.study_name is None else {"probe", "preset", "scene"}
    changed = {o.key_or_group: o.value() for o in overrides if o.key_or_group in groups & set(named)}

    def changes(override: Override) -> set[str]:
        own = _keys_of(override)
        return {key for key in own & deciding if key in wanted or key.partition(".")[0] in wanted}

    if candidates := {key for override in overrides for key in changes(override)}:
        kept = (o for o in overrides if not changes(o) and o.key_or_group not in _IN_NO_LABEL)
        without = base(tuple(str(o.input_line) for o in kept))
        before, after = dict(flat(plain(without))), dict(flat(plain(settings)))
        changed |= {key: after[key] for key in candidates if before.get(key) != after.get(key)}
    return changed


def _keys_of(override: Override) -> set[str]:
    """`model.depth=8` sets model.depth, and `model={depth:8,noise:input}` both of its keys."""
    key, value = override.key_or_group, override.value()
    return {f"{key}.{name}" for name in value} if isinstance(value, dict) else {key}


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
