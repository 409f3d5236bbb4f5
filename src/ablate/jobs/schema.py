"""The frozen settings of `ablate.settings.study` as the typed schema that Hydra composes it into."""

import dataclasses
from dataclasses import MISSING, field
from functools import cache
from typing import Any, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from ablate.jobs.scale import register_resolvers
from ablate.settings.study import StudySettings
from ablate.settings.values import build
from ablate.ultrasound.probe_kinds import PROBE_KEYS, Probe, ProbeKind


def register() -> None:
    """Make the schema known to Hydra as `schema`, the first entry of conf/config.yaml, and conf/'s resolvers."""
    register_resolvers()
    ConfigStore.instance().store(name="schema", node=_study_schema())


@cache
def _study_schema() -> type:
    return _schema(StudySettings)


def _schema(cls: type) -> type:
    """A mutable dataclass with the fields of a frozen one, as OmegaConf needs it for typed configurations."""
    hints = get_type_hints(cls)
    fields: list[tuple[str, Any, Any]] = []
    for f in dataclasses.fields(cls):
        hint = hints[f.name]
        if hint == Probe or (dataclasses.is_dataclass(hint) and isinstance(hint, type)):
            made = _probe_schema() if hint == Probe else _schema(hint)
            fields.append((f.name, made, field(default_factory=made)))
        elif f.default is not MISSING:
            fields.append((f.name, hint, field(default_factory=_constant(f.default))))
        else:
            fields.append((f.name, hint, field(default="???")))
    return dataclasses.make_dataclass(cls.__name__, fields)


def _probe_schema() -> type:
    """A mutable dataclass with the values of all kinds of probe; null where a kind has none."""
    own: list[tuple[str, Any, Any]] = [
        (name, float | None if default is None else float, field(default=default))
        for name, default in PROBE_KEYS.items()
    ]
    return dataclasses.make_dataclass("Probe", [("kind", ProbeKind, field(default=ProbeKind.convex)), *own])


def _constant(value: Any) -> Any:
    return lambda: list(value) if isinstance(value, tuple) else value


def settings(config: DictConfig) -> StudySettings:
    """The frozen values behind a composed configuration, without Hydra's own node.

    A value outside its allowed range is a ValueError that names it.
    """
    own = OmegaConf.masked_copy(config, [str(key) for key in config if key != "hydra"])
    values = OmegaConf.to_container(own, resolve=True, throw_on_missing=True)
    assert isinstance(values, dict)
    return build(StudySettings, {str(k): v for k, v in values.items()})
