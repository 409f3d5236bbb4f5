"""The frozen settings of `ablate.settings.study` as the typed schema that Hydra composes it into."""

import dataclasses
from copy import copy
from dataclasses import field
from functools import cache, partial
from typing import Any, get_type_hints

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from ablate.command.scale import register_resolvers
from ablate.setting import is_group
from ablate.settings.conf import build
from ablate.settings.study import StudySettings
from ablate.ultrasound.settings import PROBE_KEYS, Probe, ProbeKind


@cache
def register() -> None:
    """Make the schema known to Hydra as `schema`, the first entry of conf/config.yaml, and conf/'s resolvers."""
    register_resolvers()
    node = OmegaConf.structured(_STUDY)
    OmegaConf.set_struct(node.model.settings, False)  # its keys are those of the user's network
    ConfigStore.instance().store(name="schema", node=node)


def _schema(cls: type) -> type:
    """A mutable dataclass with the fields of a frozen one, as OmegaConf needs it for typed configurations."""
    hints = get_type_hints(cls)
    fields: list[tuple[str, Any, Any]] = []
    for one in dataclasses.fields(cls):
        hint = hints[one.name]
        if hint == Probe:
            values = {"kind": ProbeKind.convex, **PROBE_KEYS}
            # Null where not all kinds have it.
            probe_fields = [(n, float | None if v is None else type(v), field(default=v)) for n, v in values.items()]
            fields.append((one.name, probe := _made("Probe", probe_fields), field(default_factory=probe)))
        elif is_group(hint):
            fields.append((one.name, group := _schema(hint), field(default_factory=group)))
        else:
            default = one.default if one.default_factory is dataclasses.MISSING else one.default_factory()
            default = list(default) if isinstance(default, tuple) else default
            fields.append((one.name, hint, field(default_factory=partial(copy, default))))
    return _made(cls.__name__, fields)


def _made(name: str, fields: list[tuple[str, Any, Any]]) -> type:
    """A dataclass that is an attribute of this module.

    Launchers pickle it, and take a class that a module has by its name. Of another one cloudpickle takes the contents,
    and writes them over the class of this process when a job's configuration comes back.
    """
    schema = dataclasses.make_dataclass(f"{name}Schema", fields)
    schema.__module__ = __name__
    globals()[schema.__name__] = schema
    return schema


_STUDY = _schema(StudySettings)


def settings(config: DictConfig) -> StudySettings:
    """The frozen values behind a composed configuration, without Hydra's own node.

    A value outside its allowed range is a ValueError that names it.
    """
    values = {str(key): config[key] for key in config if key != "hydra"}  # a text that ${oc.env:X} gives, as its type
    plain = {
        key: OmegaConf.to_container(value, resolve=True, throw_on_missing=True) if OmegaConf.is_config(value) else value
        for key, value in values.items()
    }
    return build(StudySettings, plain)
