"""From plain values, as Hydra composes them or JSON stores them, to frozen settings; the table of all keys; conf/."""

import re
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import ablate
from ablate.setting import Setting, check_values, is_group, naming, settings_of, shown
from ablate.settings.study import StudySettings
from ablate.ultrasound.settings import PROBES, Probe, probe_from

T = TypeVar("T")

CUSTOM = "custom"  # the variant that a user's network takes the place of
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
    by_name = {one.name: one for one in settings_of(cls)}
    table: dict[str, Setting] = {}
    for name, hint in get_type_hints(cls).items():
        if hint == Probe:
            table |= {f"{prefix}{name}.{one.name}": one for kind in PROBES.values() for one in settings_of(kind)}
        elif is_group(hint):
            table |= keys(hint, f"{prefix}{name}.")
        else:
            table[prefix + name] = by_name[name]
    return table


def unknown_key(key: str) -> str:
    """What is said of a key that there is not: the one that is meant, and those beside it."""
    meant, parent = nearest(key), key.rpartition(".")[0]
    beside = ", ".join(names_in(parent))
    hint = f"; did you mean '{meant}'?" if meant else ";" if beside else ""
    return f"unknown key '{key}'{hint}" + (f" allowed{' in ' + parent if parent else ''}: {beside}" if beside else "")


def nearest(key: str) -> str:
    """The known keys that a wrong one may stand for, joined by `or`; empty where none is like it.

    They are those of any group with its last part, or with its letters as their initials, such as `lr`, or else the
    most similar one, first of its own group.
    """
    known = list(keys())
    parent, _, last = re.sub(r"[/\[]", ".", key.lower()).rstrip("]").rpartition(".")
    if alike := [other for other in known if other.rpartition(".")[2] == last]:
        return " or ".join(alike)
    if short := [other for other in known if len(last) > 1 and _initials(other) == last]:
        return " or ".join(short)
    if close := get_close_matches(last, names_in(parent), n=1, cutoff=0.65):
        return f"{parent}.{close[0]}".lstrip(".")
    last_parts = {other.rpartition(".")[2]: other for other in reversed(known)}
    close = get_close_matches(last, last_parts, n=1, cutoff=0.75)
    return last_parts[close[0]] if close else ""


def _initials(key: str) -> str:
    return "".join(word[0] for word in key.rpartition(".")[2].split("_"))


def names_in(group: str) -> list[str]:
    """The names of settings and groups in a group such as `training`, or in none, which is empty text."""
    prefix = f"{group}." if group else ""
    return sorted({known.removeprefix(prefix).partition(".")[0] for known in keys() if known.startswith(prefix)})


def allowed_for(key: str) -> str:
    """What may be typed of a key, a group of settings or a group of conf/, empty for others."""
    if names := choices_of(key):  # `variant` is a key, too
        return f"{key}= one of {', '.join(names)}"
    if key in keys():
        return f"{key}= one of {keys()[key].allowed}" if keys()[key].choices else f"{key}= {keys()[key].allowed}"
    names = names_in(key) if key else []
    return f"{key}.NAME=..., where NAME is one of {', '.join(names)}" if names else ""


def conf_folder() -> Path:
    """The folder conf/: inside the installed package, or beside src/ in a checkout."""
    package = Path(ablate.__file__).parent
    inside = package / "conf"
    return inside if inside.is_dir() else package.parents[1] / "conf"


def choices_of(group: str) -> list[str]:
    """The names of the files in a group of conf/, such as `variant`; empty for anything else."""
    return sorted(path.stem for path in (conf_folder() / group).glob("*.yaml")) if group else []


def variant_names() -> tuple[str, ...]:
    """Every network of conf/variant, in the order of the paper's Table II, others after; `custom` names none."""
    names = {path.stem for path in (conf_folder() / "variant").glob("*.yaml")} - {CUSTOM}
    return (*[n for n in _TABLE_II if n in names], *sorted(names - set(_TABLE_II)))
