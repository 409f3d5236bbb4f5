"""The label of a job: the variant, and what was changed beside it, such as `sa2h.depth-8`."""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cache, lru_cache
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Override
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ablate.command.composed import CONFIG, composed, parsed, primary_name
from ablate.setting import plain
from ablate.settings.components import OF_OWN_NETWORK
from ablate.settings.conf import CUSTOM, keys, variant_names
from ablate.settings.study import StudySettings

# Seeds and variants have places of their own.
_IN_NO_LABEL = frozenset({"model.target", "seed", "training.seed"})
_LIKE_A_COMPONENT = ("training.loss",)
_SIZE = "model.width"  # of all networks of a study alike, unless it is swept
_OF_SCORES = "evaluation."  # these settings decide scores, and no weights
_OF_FRAMES = ("scene.", "probe.", "simulator.", "dataset.seed", "dataset.press_mm")
_LONGEST_VALUE = 24  # in the name of a folder


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
    and scenes are where they share the name of a study. What a primary file of the user's changes counts as if it were
    typed.

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
    after = _plain(config)
    primary = primary_name()
    if primary != CONFIG and (groups_of_it := _groups(config, chosen, kept)):
        kept, primary = [*groups_of_it, *kept], CONFIG
        candidates |= {key for key in after if key in _wanted(named) and _decides(key)}
        candidates |= {key for key in after if key.startswith(OF_OWN_NETWORK)}
    if candidates:
        before = _values(tuple(kept), primary)
        changed |= {key: after.get(key) for key in candidates if before.get(key) != after.get(key)}
    return changed


def _names(override: Override, named: Collection[str]) -> set[str]:
    """The keys that a word changes and a label may name: one, or those of `model={depth:8,noise:input}`."""
    group, wanted = override.key_or_group, _wanted(named)
    deciding = {key for key in changes_of(override) if _decides(key)}
    return {key for key in deciding if key in wanted or group in wanted or key.startswith(OF_OWN_NETWORK)}


def changes_of(override: Override) -> set[str]:
    """The keys that a word with one value sets."""
    return set(_ends(override.key_or_group, override.value()))


def _ends(key: str, value: object) -> Iterator[str]:
    """The dotted keys below a key; a group that is empty changes none."""
    if not isinstance(value, dict):
        yield key
        return
    for name, inner in value.items():
        yield from _ends(f"{key}.{name}", inner)


def _wanted(named: Collection[str]) -> set[str]:
    """The keys that labels name."""
    network_keys = (key for key in _deciding() if key.startswith("model.") and key != _SIZE)
    return {*named, *_LIKE_A_COMPONENT, *network_keys}


def _groups(config: DictConfig, chosen: StudySettings, kept: Sequence[str]) -> list[str]:
    """The groups that a primary file of the user's comes to, as words; none where its network has no file in conf/.

    A file that was saved from `--cfg job` has chosen none, and has their values.
    """
    node = config.hydra if "hydra" in config else HydraConfig.get()
    choices = {
        str(group): choice for group, choice in node.runtime.choices.items() if not str(group).startswith("hydra")
    }
    choices = {"preset": chosen.preset, "variant": chosen.variant, "scene": chosen.scene.kind} | choices
    if choices["variant"] not in (*variant_names(), CUSTOM):
        return []
    typed = {override.key_or_group for override in parsed(kept)}
    usual = ("preset", "probe", "scene", "variant")
    return [f"{'' if g in usual else '+'}{g}={c}" for g, c in choices.items() if c is not None and g not in typed]


def _decides(key: str) -> bool:
    return key in _deciding() or key.startswith(OF_OWN_NETWORK)


@cache
def _deciding() -> frozenset[str]:
    """The keys that decide the weights of a training, but for seeds and what stands in the label anyway."""
    deciding = {key for key, one in keys().items() if not one.declared.incidental} - _IN_NO_LABEL
    return frozenset(key for key in deciding if not key.startswith(_OF_SCORES))


@lru_cache(maxsize=64)
def _values(words: tuple[str, ...], primary: str) -> dict[str, Any]:
    """Every value of the configuration of some words, by key; it need not be one that could be run."""
    return _plain(composed(words, primary))


def _plain(config: DictConfig) -> dict[str, Any]:
    """The values of a configuration by dotted key, as JSON has them; what cannot be resolved is left out."""
    without_hydra = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    return {key: plain(value) for key, value in _flat(without_hydra)}


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
    named = sorted(f"{_name_of(key)}-{value}" for key, value in changed.items())
    return ".".join([variant, *(re.sub(r"[^A-Za-z0-9.+_-]", "_", name) for name in named)])


def frame_words(words: Sequence[str]) -> str:
    """What words of a command line change of how a frame is made, for the name of its folder: `depth_mm-60.gain_db-6`.

    Long values, such as lists of many numbers, are left out.
    """
    changed = {o.key_or_group: o.get_value_element_as_str() for o in parsed(words) if o.key_or_group in _frame_keys()}
    named = {key: re.sub(r"[^A-Za-z0-9.+_-]+", "_", value).strip("_") for key, value in changed.items()}
    return ".".join(sorted(f"{_name_of(key)}-{value}" for key, value in named.items() if len(value) <= _LONGEST_VALUE))


@cache
def _frame_keys() -> frozenset[str]:
    """The keys and groups that decide a frame beside its scene's folder and its pose, which are named anyway."""
    own = (key for key in keys() if key.startswith(_OF_FRAMES) and key not in ("scene.kind", "scene.folder"))
    return frozenset(("preset", "probe", "gain_db", *own))


def _name_of(key: str) -> str:
    """The last part of a key; of one of the user's network all that is the user's, as two groups may end alike."""
    name = key.removeprefix(OF_OWN_NETWORK)
    return key.rpartition(".")[2] if name == key else name.replace(".", "_")
