"""Settings of a network of the user's, checked against what its class takes."""

import inspect
import types
from collections.abc import Mapping
from difflib import get_close_matches
from enum import Enum
from inspect import Parameter
from numbers import Real
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ablate.setting import shown

_PLAIN = {int: "a whole number", float: "a number", str: "text", bool: "true or false", type(None): "null"}
_CONTAINERS = {list: "a list", tuple: "a list", dict: "a mapping"}
_VARIADIC = (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD)


def check_taken(network_class: type, target: str, settings: Mapping[str, Any]) -> None:
    """Refuse settings that a class does not take beside its channels.

    Parameters
    ----------
    network_class : type
        Its first argument is the number of channels; the others are its settings.
    target : str
        Its dotted path.
    settings : mapping
        Keyword arguments.

    Raises
    ------
    ValueError
        In one line that names the setting as `settings.<name>`: the class has none of the name, the value is of another
        kind than its annotation or, without one, its default, or a setting without a default is not given.
    """
    try:
        parameters = list(inspect.signature(network_class).parameters.values())
    except (TypeError, ValueError):  # a class that is not written in Python
        return
    takes_any = any(p.kind is Parameter.VAR_KEYWORD for p in parameters)
    # The first one is the number of channels, unless it is *args.
    keywords = {p.name: p for p in parameters[1:] if p.kind not in (*_VARIADIC, Parameter.POSITIONAL_ONLY)}
    hints = _hints(network_class)
    takes = f"{target} takes {_in_words(keywords, hints)}"
    for name, value in settings.items():
        if name not in keywords:
            if takes_any and name != parameters[0].name:
                continue
            meant = get_close_matches(name, keywords, n=1)
            hint = f"did you mean settings.{meant[0]}? " if meant else ""
            raise ValueError(f"settings.{name}={shown(value)}: {hint}{takes}")
        kinds = _kinds(keywords[name], hints)
        if kinds and not any(_is_of(value, kind) for kind in kinds):
            allowed = " or ".join(dict.fromkeys(map(_kind_in_words, kinds)))
            raise ValueError(f"settings.{name}={shown(value)}: {target} takes {allowed} as {name}")
    missing = [name for name, p in keywords.items() if p.default is Parameter.empty and name not in settings]
    if missing:
        raise ValueError(f"settings.{missing[0]}=... must be given: {takes}")


def _hints(network_class: type) -> dict[str, Any]:
    """Annotations of what a class is made with; none where they name what is not there."""
    try:
        return get_type_hints(network_class.__init__)  # type: ignore[misc]
    except Exception:  # a string may hold any code
        return {}


def _kinds(parameter: Parameter, hints: Mapping[str, Any]) -> tuple[Any, ...]:
    """What an argument may be: of its annotation, or else of its default; empty where nothing is known of it."""
    hint = hints.get(parameter.name, Any)
    if hint is Any:
        default = parameter.default
        for kind in (bool, str, *_CONTAINERS):
            if isinstance(default, kind):  # its own class may be another, as of a StrEnum
                return (kind,)
        return (float,) if isinstance(default, Real) else ()  # of a default of 1, 0.5 may be meant
    kinds = get_args(hint) if get_origin(hint) in (Union, types.UnionType) else (hint,)
    return tuple(kinds) if all(_is_known(kind) for kind in kinds) else ()


def _is_known(kind: Any) -> bool:
    """Whether it can be told of a value that it is not of this kind."""
    whole = get_origin(kind) or kind  # compared by `is`, as an annotation may be anything, also a list
    return any(whole is known for known in (*_PLAIN, *_CONTAINERS, Literal))


def _is_of(value: object, kind: Any) -> bool:
    """Whether a value may be given where this kind is asked for; what lists and mappings hold is the class's own."""
    whole = get_origin(kind) or kind
    if whole is Literal:
        return any(value == choice and isinstance(value, bool) == isinstance(choice, bool) for choice in get_args(kind))
    if whole in (list, tuple):
        return isinstance(value, list)
    if whole in (int, float):
        return not isinstance(value, bool) and isinstance(value, int if whole is int else (int, float))
    return isinstance(value, whole)


def _kind_in_words(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return " or ".join(str(choice.value if isinstance(choice, Enum) else choice) for choice in get_args(kind))
    return _PLAIN.get(kind) or _CONTAINERS[get_origin(kind) or kind]


def _in_words(own: Mapping[str, Parameter], hints: Mapping[str, Any]) -> str:
    """The settings of a class with their defaults, such as `hidden (a whole number; 16), norm`."""
    words = []
    for name, parameter in own.items():
        kinds = " or ".join(dict.fromkeys(_kind_in_words(kind) for kind in _kinds(parameter, hints)))
        default = "" if parameter.default is Parameter.empty else shown(parameter.default)
        said = "; ".join(part for part in (kinds, default and f"{default} if it is not given") if part)
        words.append(f"{name} ({said})" if said else name)
    return ", ".join(words) or "its number of channels alone"
