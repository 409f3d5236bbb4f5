"""Checks of values that the frozen settings of all rooms share."""

import math
from enum import StrEnum
from numbers import Integral, Real
from typing import get_type_hints


def coerce_enums(settings: object) -> None:
    """Replace the strings in the fields of a frozen dataclass that are annotated as enums by the enums' members.

    A value that is not one of its enum's is a ValueError that names the field and the values allowed.
    """
    for name, kind in get_type_hints(type(settings)).items():
        if not (isinstance(kind, type) and issubclass(kind, StrEnum)):
            continue
        value = getattr(settings, name)
        try:
            object.__setattr__(settings, name, kind(value))
        except ValueError:
            raise ValueError(f"{name}={value!r}: allowed are {', '.join(kind)}") from None


def check_number(name: str, value: object, lower: float, upper: float) -> None:
    """Raise ValueError unless `value` is a finite number in [lower, upper]."""
    if not isinstance(value, Real) or not math.isfinite(value) or not lower <= float(value) <= upper:
        raise ValueError(f"{name} must be between {lower:g} and {upper:g}, not {value!r}")


def check_count(name: str, value: object, lower: int) -> None:
    """Raise ValueError unless `value` is a whole number of at least `lower`."""
    if not isinstance(value, Integral) or isinstance(value, bool) or value < lower:
        raise ValueError(f"{name} must be a whole number of at least {lower}, not {value!r}")
