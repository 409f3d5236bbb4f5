"""What a case is, and the figures that it has to keep within their bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

#: Unit roundoff: the largest relative error of one rounding.
FLOAT32, FLOAT64, TF32, BFLOAT16 = 2.0**-24, 2.0**-53, 2.0**-11, 2.0**-8


@dataclass(frozen=True)
class Check:
    """A figure that must not exceed its bound; all are distances from what is right, so 0 is perfect.

    Attributes
    ----------
    dtype : str
        Floating point that was used.
    quantity : str
    measured, bound : float
    why : str
        Where the bound comes from, one sentence.
    """

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
    """Something stiff or extreme that is tried; `checks(device)` computes its figures."""

    name: str
    checks: Callable[[str], Iterable[Check]]

    @property
    def about(self) -> str:
        """What is tried, from the docstring."""
        return getattr(self.checks, "func", self.checks).__doc__ or ""


def finite(dtype: str, *arrays: np.ndarray, what: str = "values") -> Check:
    """None of the values is infinite or NaN."""
    count = sum(int(np.count_nonzero(~np.isfinite(array))) for array in arrays)
    return Check(dtype, f"{what} not finite", count, 0, "A picture, a gradient or a score of NaN says nothing.")


def refused(dtype: str, *attempts: Callable[[], object]) -> Check:
    """Each attempt is a ValueError: what has no answer gets none."""
    accepted = 0
    for attempt in attempts:
        try:
            attempt()
        except ValueError:
            continue
        accepted += 1
    return Check(dtype, "inputs not refused", accepted, 0, "What has no answer is refused by name, never NaN.")


def off(measured: np.ndarray, right: np.ndarray | float, relative_to: float = 1.0) -> float:
    """Largest distance between two arrays, over a scale."""
    return float(np.abs(np.asarray(measured, np.float64) - right).max()) / relative_to


def labelled(label: str, checks: Iterable[Check]) -> Iterator[Check]:
    """The same checks with a label in front of their quantities: one setting among several of a case."""
    for check in checks:
        yield Check(check.dtype, f"{label}: {check.quantity}", check.measured, check.bound, check.why)
