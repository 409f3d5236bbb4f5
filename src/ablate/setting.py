"""A setting is declared once, as a field of a frozen dataclass: type, default, range or choices, unit, use.

From this come the checks, Hydra's schema, the identity of runs and data sets, `--help` and the table of keys in docs/.
Names, which several rooms share, have checks of their own.
"""

import dataclasses
import math
import os
import re
import reprlib
import sys
import types
import unicodedata
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from enum import Enum, StrEnum
from functools import cache
from numbers import Integral, Real
from typing import Any, Union, get_args, get_origin, get_type_hints

_METADATA = "setting"
LONGEST_NAME = 200  # bytes; file systems take 255, and endings are added to names
_REPR = reprlib.Repr()
_REPR.maxstring = _REPR.maxother = 60
_REPR.maxlevel = 2


@dataclass(frozen=True)
class Declaration:
    """What is declared of a setting besides its type and default."""

    about: str = ""  # one sentence
    least: float | None = None
    most: float | None = None
    above: float | None = None  # this limit itself is not allowed
    below: float | None = None  # nor is this one
    choices: tuple[str, ...] = ()  # texts that are allowed; empty where any is, and for an enum, which has its own
    unit: str = ""
    incidental: bool = False  # decides no result: devices, threads, paths, how often something is reported
    is_path: bool = False  # of a file or folder; `~` is the home of the user, `$NAME` of the environment

    def range(self) -> str:
        """The range in words, such as `from 0 and below 1`; empty where there is none."""
        bounds = {"from": self.least, "above": self.above, "up to" if self.least is None else "to": self.most}
        words = [f"{word} {bound:.15g}" for word, bound in bounds.items() if bound is not None]
        if self.below is not None:
            words.append(f"{'and ' if words else ''}below {self.below:.15g}")
        return " ".join(words)

    def holds(self, number: Any) -> bool:
        """Whether a number lies in the range."""
        return (
            (self.least is None or number >= self.least)
            and (self.most is None or number <= self.most)
            and (self.above is None or number > self.above)
            and (self.below is None or number < self.below)
        )


def setting(default: Any, about: str = "", **declared: Any) -> Any:
    """A field of a settings dataclass; `declared` are the attributes of its `Declaration`."""
    metadata = {_METADATA: Declaration(about, **declared)}
    if isinstance(default, dict):
        return field(default_factory=default.copy, hash=False, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Setting:
    """One declared setting: its name, its type (without `None`), whether `None` is allowed, default, declaration."""

    name: str
    kind: Any
    optional: bool
    default: Any
    declared: Declaration

    @property
    def choices(self) -> tuple[str, ...]:
        """The names of which its value is one; empty where it is a number or any text."""
        is_enum = isinstance(self.kind, type) and issubclass(self.kind, StrEnum)
        return tuple(self.kind) if is_enum else self.declared.choices

    @property
    def allowed(self) -> str:
        """The values that are allowed, in words."""
        numbers = {int: "whole numbers", float: "numbers"}
        kinds = get_args(self.kind) if get_origin(self.kind) is tuple else (self.kind,)
        if self.choices:
            words = ", ".join(self.choices)
        elif kinds[0] in numbers:
            many = f"{len(kinds)} " if len(kinds) > 1 else ""
            words = f"{many}{numbers[kinds[0]]} {self.declared.range()}".rstrip()
        elif get_origin(self.kind) is dict:
            words = "names with numbers, text, true, false, null, or lists and mappings of them"
        else:
            words = {str: "text", bool: "true, false"}.get(self.kind, "")
        return f"{words}, or null" if self.optional else words


def settings_of(cls: type[Any]) -> tuple[Setting, ...]:
    """The settings that a dataclass declares, in their order; fields that are dataclasses themselves are left out."""
    hints = get_type_hints(cls)
    declared = []
    for one in dataclasses.fields(cls):
        kind, optional = hints[one.name], False
        if get_origin(kind) in (Union, types.UnionType) and type(None) in get_args(kind):
            kind, optional = next(a for a in get_args(kind) if a is not type(None)), True
        if is_group(kind):
            continue
        declaration = one.metadata.get(_METADATA, Declaration())
        default = one.default if one.default_factory is dataclasses.MISSING else one.default_factory()
        declared.append(Setting(one.name, kind, optional, default, declaration))
    return tuple(declared)


_declared = cache(settings_of)


def is_group(kind: Any) -> bool:
    """Whether a type is a group of settings: a dataclass, or a union of dataclasses such as the kinds of a probe."""
    kinds = get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)
    return all(isinstance(k, type) and dataclasses.is_dataclass(k) for k in kinds)


class Checked:
    """What a settings dataclass inherits: its values are checked when it is made, as by `check_settings`."""

    def __post_init__(self) -> None:
        check_settings(self)


def check_settings(values: Any) -> None:
    """Check every declared value of a frozen dataclass, and turn strings into enums and lists into tuples.

    Called first in its `__post_init__`. A value that is not allowed is a ValueError `name=value: allowed are ...`.
    """
    given = {one.name: getattr(values, one.name) for one in _declared(values.__class__)}
    for name, value in check_values(values.__class__, given).items():
        object.__setattr__(values, name, value)


def check_values(cls: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Those of the values that a dataclass declares, as their types; a ValueError as of `check_settings`."""
    return {one.name: checked_value(one, values[one.name]) for one in _declared(cls) if one.name in values}


def checked_value(one: Setting, value: Any) -> Any:
    """The value of a setting as its type; a ValueError `name=value: allowed are ...` where it is not allowed."""
    if value is None and one.optional:
        return None
    try:
        return _checked(one, value)
    except ValueError:
        hint = did_you_mean(value, one.choices)
        raise ValueError(f"{one.name}={shown(value)}: allowed are {one.allowed}{hint}") from None


def _checked(one: Setting, value: Any) -> Any:
    """The value as its type; a ValueError where it is not allowed."""
    if isinstance(one.kind, type) and issubclass(one.kind, StrEnum):
        return one.kind(value)
    if one.declared.choices and value not in one.declared.choices:
        raise ValueError
    if get_origin(one.kind) is dict:
        if not isinstance(value, Mapping):
            raise ValueError
        return _as_stored(value)
    is_tuple = get_origin(one.kind) is tuple
    kinds, values = (get_args(one.kind), value) if is_tuple else ((one.kind,), (value,))
    if kinds[0] not in (int, float):
        if (one.kind, value) == (str, "") or (one.kind is bool and not isinstance(value, bool)):
            raise ValueError
        is_path = one.declared.is_path and isinstance(value, str)
        return os.path.expandvars(os.path.expanduser(value)) if is_path else value  # noqa: PTH111
    if not isinstance(values, (tuple, list)) or len(values) != len(kinds):
        raise ValueError
    if not all(_is_number(v, kind) and one.declared.holds(v) for v, kind in zip(values, kinds, strict=True)):
        raise ValueError
    numbers = tuple(kind(v) for v, kind in zip(values, kinds, strict=True))
    return numbers if is_tuple else numbers[0]


def _as_stored(value: Any) -> Any:
    """A free value as JSON gives it back, in containers of its own; a ValueError where JSON cannot hold it."""
    if isinstance(value, Mapping) and all(isinstance(name, str) and name for name in value):
        return {name: _as_stored(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_as_stored(part) for part in value]
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, int | float) and math.isfinite(value) and (isinstance(value, float) or abs(value) < 2**63):
        return value
    raise ValueError


def _is_number(value: object, kind: type) -> bool:
    """Whether a value is a finite number of the kind `int` or `float`; a float without decimals is a whole number."""
    if isinstance(value, bool) or not isinstance(value, Real) or not abs(value) <= sys.float_info.max:  # type: ignore[operator]
        return False
    return kind is not int or isinstance(value, Integral) or float(value).is_integer()


def plain(value: Any) -> Any:
    """Settings as JSON can hold them: dataclasses as dicts, tuples as lists, enums by name.

    A dataclass that is one of several kinds, such as a probe, names its `kind` by a class variable.
    """
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {one.name: plain(getattr(value, one.name)) for one in dataclasses.fields(value)}
        kind = getattr(type(value), "kind", None)
        return {"kind": kind.name, **fields} if isinstance(kind, Enum) and "kind" not in fields else fields
    if isinstance(value, Enum):
        return value.name
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    return value


def identity(values: object) -> dict[str, Any]:
    """The settings of a dataclass that decide a result, as JSON can hold them.

    Incidental ones are left out, and so is a mapping that is empty.
    """
    deciding = {one.name for one in settings_of(values.__class__) if not one.declared.incidental}
    return {name: value for name, value in plain(values).items() if name in deciding and value != {}}


def flat(values: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of nested dicts: `{"training": {"steps": 3}}` gives `training.steps`."""
    for name, value in values.items():
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value


def shown(value: object) -> str:
    """Represent a value in a message, shortened where it is long."""
    return " ".join(_REPR.repr(value).split())


def did_you_mean(wrong: object, names: Collection[str]) -> str:
    """The name that a wrong one may stand for, as the end of a message; empty where none is like it."""
    by_lower = {name.lower(): name for name in names}
    near = get_close_matches(str(wrong)[:LONGEST_NAME].lower(), by_lower, n=1, cutoff=0.7)
    return f"; did you mean {by_lower[near[0]]}?" if near else ""


@contextmanager
def naming(where: str, kinds: type[Exception] | tuple[type[Exception], ...] = ValueError) -> Iterator[None]:
    """Raise an error of these kinds as a ValueError of one line that begins with `where`."""
    try:
        yield
    except kinds as error:
        raise ValueError(f"{where}{' '.join(str(error).split())}") from error


def check_name(key: str, value: str, reserved: Collection[str] = ()) -> None:
    """Raise ValueError unless `value` can name a folder and a run: letters, digits, blanks and `_.+-`.

    The part before its first dot, whatever its case, must not be one of the lower-case names in `reserved`.
    """
    if not re.fullmatch(r"\w([\w.+ -]*[\w.+-])?", value) or len(value.encode(errors="replace")) > LONGEST_NAME:
        allowed = f"at most {LONGEST_NAME} letters, digits, blanks and _.+-, the first a letter, a digit or _"
        raise ValueError(f"{key}={shown(value)}: allowed are {allowed}{_not_allowed(value)}")
    if value.partition(".")[0].lower() in reserved:
        raise ValueError(f"{key}={value}: the names {', '.join(sorted(reserved))} are taken by other folders")


def composed_letters(name: str) -> str:
    """A name with its letters in one piece (Unicode's NFC): macOS keeps `ü` as `u` and a mark that combines with it."""
    return unicodedata.normalize("NFC", name)


def cut_name(name: str, most: int = LONGEST_NAME) -> str:
    """The beginning of a name that takes so many bytes at most, and ends with no part of a letter and no blank."""
    return name.encode(errors="replace")[:most].decode(errors="ignore").rstrip()


def _not_allowed(name: str) -> str:
    """The first character that no name may hold, by its number where it cannot be seen alone; empty without one."""
    odd = next(iter(re.sub(r"[\w.+ -]", "", name)), "")
    if not odd:
        return ""
    seen = odd.isprintable() and not unicodedata.combining(odd)
    return f"; not {odd!r}" if seen else f"; not U+{ord(odd):04X} (Unicode: {unicodedata.name(odd, 'no name').lower()})"
