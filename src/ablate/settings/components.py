"""The components that a study switches and judges, a file each: those of conf/, and those in folders of the user's.

What a study was registered with stands in conf/registered where the files say otherwise today.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from ablate.analysis.components import Component, Question
from ablate.networks.spec import ExtraInput, GeneratorSpec, Noise, inputs
from ablate.setting import checked_value, did_you_mean, naming, shown
from ablate.settings.conf import conf_folder, keys, nearest
from ablate.settings.study import ConfigurationError, refusing

# The order of tables and figures; components that are not listed follow by name.
_ORDER = (
    *("att", "concat", "conv", "noise", "lattice", "depth", "encoding", "properties", "space", "position"),
    *("interfaces", "grain"),
)
OF_OWN_NETWORK = "model.settings."  # begins the keys that a network of the user's has
#: Components that a network of the user's does not have, whatever its settings say.
NOT_OF_CUSTOM = frozenset({"model.concat", "model.upsampling", "model.depth", "model.grain"})
_OF_USER: list[Path] = []  # folders beside conf/
_READ_AS = {True: "on", False: "off"}  # by YAML


def read_components_from(folders: Iterable[Path]) -> None:
    """Let `components` read the folder `component` in these folders of the user's too, from now on in this process."""
    others = dict.fromkeys(folder.resolve() for folder in folders)
    _OF_USER[:] = [folder for folder in others if folder != conf_folder().resolve()]


def component_files() -> dict[str, Path]:
    """The files that declare components, by name: one of the user's takes the place of the package's of its name."""
    own: dict[str, Path] = {}
    for path in (path for folder in _OF_USER for path in sorted((folder / "component").glob("*.yaml"))):
        if (other := own.setdefault(path.stem, path)) != path:
            raise ConfigurationError(f"{_shown(path)}: {_shown(other)} has its name; allowed is one of them")
    return {path.stem: path for path in (conf_folder() / "component").glob("*.yaml")} | own


def said_of_components() -> list[str]:
    """A sentence for each component of the package that a file of the user's declares otherwise."""
    ours = conf_folder() / "component"
    return [
        f"The component {name} is that of {_shown(path)}, not that of the package."
        for name, path in component_files().items()
        if path.parent != ours and (same := ours / path.name).exists() and same.read_bytes() != path.read_bytes()
    ]


def components(study: str = "") -> tuple[Component, ...]:
    """The components as their files declare them now, or as they were registered for a study.

    A file `conf/registered/<study>.yaml` names what was different: by component, the values that are others today, or
    null where it was none.

    Raises
    ------
    ConfigurationError
        When a file declares no usable component; it names the file.
    """
    files = component_files()
    registered = conf_folder() / "registered" / f"{study}.yaml"
    changes = registered.read_bytes() if registered.is_file() else b"{}"
    names = [*(name for name in _ORDER if name in files), *sorted(files.keys() - set(_ORDER))]
    with refusing():
        content = [(name, _shown(files[name]), files[name].read_bytes()) for name in names]
        return _declared((f"conf/registered/{registered.name}", changes), *content)


def shown_file(component: str) -> str:
    """The file of a component as messages name it."""
    return _shown(component_files().get(component, conf_folder() / "component" / f"{component}.yaml"))


def _shown(path: Path) -> str:
    if path.parent == conf_folder() / "component":
        return f"conf/component/{path.name}"
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


@lru_cache(maxsize=8)
def _declared(registered: tuple[str, bytes], *files: tuple[str, str, bytes]) -> tuple[Component, ...]:
    """The components that files declare, each by its name, its file for messages and its content."""
    file = registered[0]
    with naming(f"{file}: ", (ValueError, yaml.YAMLError)):
        changes = _values(registered[1], "by component, what was registered")
    if unknown := sorted(changes.keys() - {name for name, *_ in files}):
        raise ValueError(f"{file}: {unknown[0]} is no file of conf/component")
    by_file: dict[str, Component] = {}
    for name, where, content in files:
        change = changes.get(name, {})
        if change is None:
            continue
        if not isinstance(change, dict):
            raise ValueError(f"{file}: {name}={shown(change)}: allowed are null and values as in conf/component")
        with naming(f"{file}: {name}: " if change else f"{where}: ", (ValueError, TypeError, yaml.YAMLError)):
            component = _component(name, _values(content, "key, on and off") | _named_levels(change))
            if twins := [other_file for other_file, other in by_file.items() if _compare_the_same(other, component)]:
                allowed = "allowed is one file for two levels of a key, and one of yours takes the place of its name"
                raise ValueError(f"key={component.key} is declared by {twins[0]} with the same levels; {allowed}")
        by_file[where] = component
    return tuple(by_file.values())


def _values(content: bytes, needed: str) -> dict[str, Any]:
    values = yaml.safe_load(content)
    if not isinstance(values, dict):
        raise ValueError(f"holds no keys; needed are {needed}")
    return _named_levels(values)


def _named_levels(values: Mapping[Any, Any]) -> dict[str, Any]:
    """The values with `on` and `off` as names, which YAML reads as true and false."""
    return {_READ_AS.get(key, str(key)): value for key, value in values.items()}


def _component(name: str, own: dict[str, Any]) -> Component:
    """The component that a file declares; a ValueError says what is wrong with it."""
    allowed = [one.name for one in dataclasses.fields(Component) if one.name != "name"]
    if unknown := [key for key in own if key not in allowed]:
        hint = did_you_mean(unknown[0], allowed)
        raise ValueError(f"unknown key {shown(unknown[0])}: allowed are {', '.join(allowed)}{hint}")
    if texts := [n for n in ("key", "label", "purpose", "metric") if not isinstance(own.get(n, ""), str)]:
        raise ValueError(f"{texts[0]}={shown(own[texts[0]])}: allowed is text")
    for size in ("band", "share"):
        value = own.get(size)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float)):
            raise ValueError(f"{size}={shown(value)}: allowed are finite numbers above 0")
    if (own.get("metric") is None) != (own.get("band") is None):
        raise ValueError("a component that is judged has both a metric and a band, and another one neither")
    question = own.get("question", Question.earns)
    if question not in tuple(Question):
        hint = did_you_mean(question, list(Question))
        raise ValueError(f"question={shown(question)}: allowed are {', '.join(Question)}{hint}")
    on = own.get("on")
    values = own | {"on": tuple(on) if isinstance(on, list) else on, "question": Question(question)}
    component = Component(name, **values)
    known = keys()
    if component.key not in known and not component.key.startswith(OF_OWN_NETWORK):
        hint = f"; did you mean {meant}?" if (meant := nearest(component.key)) else ", such as model.noise"
        raise ValueError(f"key={component.key} is no key of the configuration{hint}")
    for level in (*component.levels_on, component.off):
        if level is not None and component.key in known:
            checked_value(known[component.key], level)
    return component


def _compare_the_same(one: Component, other: Component) -> bool:
    """Whether two components of a key would be told by the same two levels."""
    if one.key != other.key:
        return False
    if None in (one.on, one.off, other.on, other.off):
        return True
    return any(one.compares(level, other.off) for level in other.levels_on)


def components_of_networks() -> dict[str, Component]:
    """The components that a generator is made of, by the field's name; others are options of data or training.

    Of several on one field it is the first, which switches it off.
    """
    declared = [c for c in components() if c.key.startswith("model.") and not c.key.startswith(OF_OWN_NETWORK)]
    return {c.key.removeprefix("model."): c for c in reversed(declared)}


def named_components(spec: GeneratorSpec) -> dict[str, object]:
    """The components of a generator by the names that tables have for them, and its inputs.

    One of two levels is whether it is on. A network of the user's has fewer.
    """
    has = {f: c for f, c in components_of_networks().items() if spec.target is None or c.key not in NOT_OF_CUSTOM}
    levels = {component.name: _level(spec, field, component) for field, component in has.items()}
    return {"family": spec.family.value, **levels, "inputs": "+".join(inputs(spec))}


def _level(spec: GeneratorSpec, field: str, component: Component) -> object:
    level = getattr(spec, field)
    if isinstance(level, StrEnum) and len(type(level)) == 2:
        return level in component.levels_on
    if field == "noise" and spec.extra_input is ExtraInput.noise:
        return Noise.input.value
    return str(level) if isinstance(level, str) else level
