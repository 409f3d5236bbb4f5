"""From plain values, as Hydra composes them or JSON stores them, to frozen settings; the table of all keys; and conf/.

The folder conf/ declares the components that a study switches and the variants, a file each.
"""

from difflib import get_close_matches
from enum import StrEnum
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import yaml

import ablate
from ablate.analysis.components import Component, Question
from ablate.networks.spec import ExtraInput, GeneratorSpec, Noise, inputs
from ablate.setting import Setting, check_values, is_group, naming, settings_of, shown
from ablate.settings.study import StudySettings
from ablate.ultrasound.settings import PROBES, Probe, probe_from

T = TypeVar("T")

# The order of tables and figures; components that are not listed follow by name.
_COMPONENTS = (
    *("att", "concat", "conv", "noise", "lattice", "depth", "encoding", "properties", "space", "position"),
    *("interfaces", "grain"),
)
CUSTOM = "custom"  # the variant that a user's network takes the place of
#: Components that a network of the user's does not have, whatever its settings say.
NOT_OF_CUSTOM = frozenset({"model.concat", "model.upsampling", "model.depth", "model.grain"})
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


@cache
def components(study: str = "") -> tuple[Component, ...]:
    """The components of conf/component, or as they were registered for a study.

    A file `conf/registered/<study>.yaml` names what was different: by component, the values that are others today, or
    null where it was none.

    Raises
    ------
    ValueError
        When a file declares no usable component; it names the file.
    """
    folder = conf_folder() / "component"
    files = {path.stem: path for path in folder.glob("*.yaml")}
    names = [*(name for name in _COMPONENTS if name in files), *sorted(files.keys() - set(_COMPONENTS))]
    registered = conf_folder() / "registered" / f"{study}.yaml"
    changes = _yaml(registered, "by component, what was registered") if registered.is_file() else {}
    if unknown := sorted(changes.keys() - files.keys()):
        raise ValueError(f"conf/registered/{study}.yaml: {unknown[0]} is no file of conf/component")
    known = keys()
    declared: list[Component] = []
    for name in names:
        where = f"conf/component/{name}.yaml"
        own = _yaml(files[name], "key, on and off")
        if name in changes:
            if changes[name] is None:
                continue
            where = f"conf/registered/{study}.yaml: {name}"
            if not isinstance(changes[name], dict):
                raise ValueError(f"{where}={changes[name]}: allowed are null and values as in conf/component")
            own |= _named_levels(changes[name])
        with naming(f"{where}: ", TypeError):
            levels_on = own.get("on")
            own["on"] = tuple(levels_on) if isinstance(levels_on, list) else levels_on
            own["question"] = _question(own.get("question", Question.earns))
            component = Component(name, **own)
        if component.key not in known:
            raise ValueError(f"{where}: key={component.key} is no key of the configuration, such as model.noise")
        if twins := [other.name for other in declared if _compare_the_same(other, component)]:
            same = f"{where}: key={component.key} is declared by {twins[0]}.yaml with the same levels"
            raise ValueError(f"{same}; allowed is one file for two levels of a key")
        declared.append(component)
    return tuple(declared)


def _yaml(path: Path, needed: str) -> dict[str, Any]:
    values = yaml.safe_load(path.read_text("utf-8"))
    if not isinstance(values, dict):
        raise ValueError(f"conf/{path.parent.name}/{path.name}: holds no keys; needed are {needed}")
    return _named_levels(values)


def _named_levels(values: dict[Any, Any]) -> dict[str, Any]:
    """The values with `on` and `off` as names, which YAML reads as true and false."""
    read_as = {True: "on", False: "off"}
    return {read_as.get(key, str(key)): value for key, value in values.items()}


def _question(word: str) -> Question:
    if word not in tuple(Question):
        raise ValueError(f"question={word}: allowed are {', '.join(Question)}")
    return Question(word)


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
    return {c.key.removeprefix("model."): c for c in reversed(components()) if c.key.startswith("model.")}


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
