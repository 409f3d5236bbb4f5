"""What a case is, and the errors that it must keep within their bounds."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

#: Unit roundoff: the largest relative error of one rounding.
FLOAT32, FLOAT64, TF32, BFLOAT16 = 2.0**-24, 2.0**-53, 2.0**-11, 2.0**-8


@dataclass(frozen=True)
class Check:
    """An error, computed in `dtype`, that must not exceed its bound, which `why` explains; 0 is perfect."""

    dtype: str
    quantity: str
    measured: float
    bound: float
    why: str

    @property
    def holds(self) -> bool:
        return self.measured <= self.bound  # false for NaN


@dataclass(frozen=True)
class Case:
    """A stiff or extreme input; `checks(device)` computes its errors."""

    name: str
    checks: Callable[[str], Iterable[Check]]

    @property
    def about(self) -> str:
        """What the case tries: the docstring of `checks`."""
        return getattr(self.checks, "func", self.checks).__doc__ or ""


def finite(dtype: str, *arrays: np.ndarray, what: str = "values") -> Check:
    """Count the values that are infinite or NaN."""
    count = sum(int(np.count_nonzero(~np.isfinite(array))) for array in arrays)
    return Check(dtype, f"{what} not finite", count, 0, "An image, a gradient or a score of NaN is useless.")


def refused(dtype: str, *attempts: Callable[[], object]) -> Check:
    """Count the attempts that raise no ValueError."""
    accepted = 0
    for attempt in attempts:
        with suppress(ValueError):
            attempt()
            accepted += 1
    return Check(dtype, "inputs not refused", accepted, 0, "What has no answer is refused in words.")


def none(dtype: str, quantity: str, wrong: object, why: str) -> Check:
    """Count the true values of `wrong`, of which there must be none."""
    return Check(dtype, quantity, int(np.count_nonzero(wrong)), 0, why)  # type: ignore[call-overload]


def off(measured: np.ndarray, right: np.ndarray | float) -> float:
    """Compute the largest absolute difference of two arrays in float64."""
    return float(np.abs(np.asarray(measured, np.float64) - right).max())


def labelled(label: str, checks: Iterable[Check]) -> Iterator[Check]:
    """Put a label before the quantity of each check, for one of several settings of a case; "" changes nothing."""
    for check in checks:
        yield replace(check, quantity=f"{label}: {check.quantity}") if label else check
