"""From plain values, as Hydra composes them or JSON stores them, to frozen settings; the table of all keys; and conf/.

The folder conf/ declares the components that a study switches and the variants, a file each. Components are also read
from folders of the user's.
"""

import dataclasses
from collections.abc import Iterable
from difflib import get_close_matches
from enum import StrEnum
from functools import lru_cache
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import yaml

import ablate
from ablate.analysis.components import Component
from ablate.networks.spec import ExtraInput, GeneratorSpec, Noise, inputs
from ablate.setting import Setting, check_values, checked_value, is_group, naming, settings_of, shown
from ablate.settings.study import ConfigurationError, StudySettings, refusing
from ablate.ultrasound.settings import PROBES, Probe, probe_from

T = TypeVar("T")

# The order of tables and figures; components that are not listed follow by name.
_COMPONENTS = ("att", "concat", "conv", "noise", "depth", "encoding", "space", "position", "interfaces", "grain")
OF_OWN_NETWORK = "model.settings."  # begins the keys that a network of the user's has
CUSTOM = "custom"  # the variant that a user's network takes the place of
#: Components that a network of the user's does not have, whatever its settings say.
NOT_OF_CUSTOM = frozenset({"model.concat", "model.upsampling", "model.depth", "model.grain"})
_OF_COMPONENTS: list[Path] = []  # folders of the user's, beside conf/
_TABLE_II = ("lsa2h", "nsa2h", "sa2h-att", "sa2h-concat", "sa2h-conv", "sa2h-noise", "sa2h", "sa2h-depth")


def build(cls: type[T], values: dict[str, Any], prefix: str = "", stored: bool = False) -> T:
    """A frozen dataclass from plain values: dicts become dataclasses, lists tuples, strings enums.

    What is not allowed is a ValueError that begins with the dotted key, `prefix` included. Of `stored` values, keys
    that no setting has any more are left out: what decides a result is in the identity beside them.
    """
    hints = get_type_hints(cls)
    unknown = sorted(values.keys() - hints.keys())
    if stored:
        values = {name: value for name, value in values.items() if name in hints}
    elif unknown:
        raise ValueError(unknown_key(f"{prefix}{unknown[0]}"))
    for name, value in values.items():
        if isinstance(value, int) and abs(value) >= 2**63:  # neither torch nor NumPy takes it
            raise ValueError(f"{prefix}{name}={shown(value)}: allowed are whole numbers below 2^63")
    with naming(prefix):  # before groups, which may take a value over, as training.seed=${seed} does
        check_values(cls, values)
    groups = {k: _group(hints[k], v, f"{prefix}{k}.", stored) for k, v in values.items() if is_group(hints[k])}
    with naming(prefix):
        return cls(**{**values, **groups})


def _group(hint: Any, values: Any, prefix: str, stored: bool) -> Any:
    """A group of settings; the probe is of the kind that its values name."""
    if not isinstance(values, dict):
        return values
    if hint != Probe:
        return build(hint, values, prefix, stored)
    with naming(prefix):
        return probe_from(values)


def keys(cls: type = StudySettings, prefix: str = "") -> dict[str, Setting]:
    """Every key of the command line, such as `training.steps`, in the order of the dataclasses.

    Of the probe they are those of every kind.
    """
    own = {one.name: one for one in settings_of(cls)}
    table: dict[str, Setting] = {}
    for name, hint in get_type_hints(cls).items():
        if hint == Probe:
            table |= {f"{prefix}{name}.{one.name}": one for kind in PROBES.values() for one in settings_of(kind)}
        elif is_group(hint):
            table |= keys(hint, f"{prefix}{name}.")
        else:
            table[prefix + name] = own[name]
    return table


def unknown_key(key: str) -> str:
    """What is said of a key that there is not: the one that is meant, and those beside it."""
    meant, parent, beside = nearest(key), key.rpartition(".")[0], ", ".join(_beside(key))
    hint = f"; did you mean '{meant}'?" if meant else ";" if beside else ""
    return f"unknown key '{key}'{hint}" + (f" allowed{' in ' + parent if parent else ''}: {beside}" if beside else "")


def nearest(key: str) -> str:
    """The known keys that a wrong one may stand for, joined by `or`; empty where none is like it.

    They are those of any group with its last part, or else the most similar one, first of its own group.
    """
    known = list(keys())
    parent, _, last = key.rpartition(".")
    if alike := [other for other in known if other.rpartition(".")[2] == last]:
        return " or ".join(alike)
    if close := get_close_matches(last, _beside(key), n=1):
        return f"{parent}.{close[0]}".lstrip(".")
    last_parts = {other.rpartition(".")[2]: other for other in reversed(known)}
    close = get_close_matches(last, last_parts, n=1, cutoff=0.75)
    return last_parts[close[0]] if close else ""


def _beside(key: str) -> list[str]:
    """The names of settings and groups in the group of a key."""
    prefix = key[: key.rfind(".") + 1]
    return sorted({known.removeprefix(prefix).partition(".")[0] for known in keys() if known.startswith(prefix)})


def conf_folder() -> Path:
    """The folder conf/: inside the installed package, or beside src/ in a checkout."""
    package = Path(ablate.__file__).parent
    inside = package / "conf"
    return inside if inside.is_dir() else package.parents[1] / "conf"


def read_components_from(folders: Iterable[Path]) -> None:
    """Let `components` read the folder `component` in these folders of the user's too, from now on in this process."""
    others = dict.fromkeys(folder.resolve() for folder in folders)
    _OF_COMPONENTS[:] = [folder for folder in others if folder != conf_folder().resolve()]


def component_files() -> dict[str, Path]:
    """The files that declare components, by name: one of the user's takes the place of the package's of its name."""
    own: dict[str, Path] = {}
    for path in (path for folder in _OF_COMPONENTS for path in sorted((folder / "component").glob("*.yaml"))):
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


def components() -> tuple[Component, ...]:
    """The components as their files declare them now; one that is not usable is a ConfigurationError that names it."""
    files = component_files()
    names = [*(name for name in _COMPONENTS if name in files), *sorted(files.keys() - set(_COMPONENTS))]
    with refusing():
        return _declared(*((name, _shown(files[name]), files[name].read_bytes()) for name in names))


def shown_file(component: str) -> str:
    """The file of a component as messages name it."""
    return _shown(component_files().get(component, conf_folder() / "component" / f"{component}.yaml"))


def _shown(path: Path) -> str:
    if path.parent == conf_folder() / "component":
        return f"conf/component/{path.name}"
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)


@lru_cache(maxsize=8)
def _declared(*files: tuple[str, str, bytes]) -> tuple[Component, ...]:
    """The components that files declare, each by its name, its file for messages and its content."""
    declared: dict[str, str] = {}
    made = []
    for name, where, content in files:
        with naming(f"{where}: ", (ValueError, TypeError, yaml.YAMLError)):
            component = _component(name, yaml.safe_load(content))
            if other := declared.get(component.key):
                allowed = "allowed is one file a key, and one of yours with the name of another takes its place"
                raise ValueError(f"key={component.key} is declared by {other}; {allowed}")
        declared[component.key] = where
        made.append(component)
    return tuple(made)


def _component(name: str, values: object) -> Component:
    """The component that a file declares; a ValueError says what is wrong with it."""
    if not isinstance(values, dict):
        raise ValueError("holds no keys; needed are key, on and off")
    read_as = {True: "on", False: "off"}  # by YAML
    own: dict[str, Any] = {read_as.get(key, str(key)): value for key, value in values.items()}
    allowed = [one.name for one in dataclasses.fields(Component) if one.name != "name"]
    if unknown := [key for key in own if key not in allowed]:
        meant = get_close_matches(unknown[0], allowed, n=1)
        hint = f"did you mean {meant[0]}? " if meant else ""
        raise ValueError(f"unknown key {shown(unknown[0])}; {hint}allowed are {', '.join(allowed)}")
    if texts := [n for n in ("key", "label", "purpose", "metric") if not isinstance(own.get(n, ""), str)]:
        raise ValueError(f"{texts[0]}={shown(own[texts[0]])}: allowed is text")
    band = own.get("band")
    if band is not None and (isinstance(band, bool) or not isinstance(band, int | float)):
        raise ValueError(f"band={shown(band)}: allowed are finite numbers above 0")
    if (own.get("metric") is None) != (band is None):
        raise ValueError("a component that is judged has both a metric and a band, and another one neither")
    on = own.get("on")
    component = Component(name, **own | {"on": tuple(on) if isinstance(on, list) else on})
    known = keys()
    if component.key not in known and not component.key.startswith(OF_OWN_NETWORK):
        raise ValueError(f"key={component.key} is no key of the configuration, such as model.noise")
    for level in (*component.levels_on, component.off):
        if level is not None and component.key in known:
            checked_value(known[component.key], level)
    return component


def components_of_networks() -> dict[str, Component]:
    """The components that a generator is made of, by the field's name; others are options of data or training."""
    return {c.key.removeprefix("model."): c for c in components() if c.key.startswith("model.")}


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


def variant_names() -> tuple[str, ...]:
    """Every network of conf/variant, in the order of the paper's Table II, others after; `custom` names none."""
    names = {path.stem for path in (conf_folder() / "variant").glob("*.yaml")} - {CUSTOM}
    return (*[n for n in _TABLE_II if n in names], *sorted(names - set(_TABLE_II)))
