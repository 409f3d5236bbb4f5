"""From plain values, as Hydra composes them or JSON stores them, to frozen settings; and the table of all keys."""

from typing import Any, TypeVar, get_type_hints

from ablate.setting import Setting, is_group, settings_of
from ablate.settings.study import StudySettings
from ablate.ultrasound.settings import PROBES, Probe, probe_from
from ablate.validation import shown

T = TypeVar("T")


def build(cls: type[T], values: dict[str, Any], prefix: str = "") -> T:
    """A frozen dataclass from plain values: dicts become dataclasses, lists tuples, strings enums.

    What is not allowed is a ValueError that begins with the dotted key, `prefix` included.
    """
    hints = get_type_hints(cls)
    unknown = sorted(values.keys() - hints.keys())
    if unknown:
        raise ValueError(f"unknown key '{prefix}{unknown[0]}'; allowed: {', '.join(sorted(hints))}")
    for name, value in values.items():
        if isinstance(value, int) and abs(value) >= 2**63:  # neither torch nor NumPy takes it
            raise ValueError(f"{prefix}{name}={shown(value)}: allowed are whole numbers below 2^63")
    groups = {k: _group(hints[k], v, f"{prefix}{k}.") for k, v in values.items() if is_group(hints[k])}
    try:
        return cls(**{**values, **groups})
    except ValueError as error:
        raise ValueError(f"{prefix}{error}") from error


def _group(hint: Any, values: Any, prefix: str) -> Any:
    """A group of settings; the probe is of the kind that its values name."""
    if not isinstance(values, dict):
        return values
    if hint != Probe:
        return build(hint, values, prefix)
    try:
        return probe_from(values)
    except ValueError as error:
        raise ValueError(f"{prefix}{error}") from error


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
