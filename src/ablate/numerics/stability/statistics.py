"""Ties, constants, one site, three frames and values of all magnitudes in the statistics of a comparison."""

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd

from ablate.analysis import PairedDifference, Verdict, component_claim, factorial_effects, holm, paired_difference
from ablate.numerics.stability.checks import FLOAT32, FLOAT64, Case, Check, finite, refused


def _compared(differences: np.ndarray, clusters: np.ndarray | None = None) -> PairedDifference:
    return paired_difference(differences, np.zeros(len(differences)), clusters)


def _check(quantity: str, error: float, bound: float, why: str) -> Check:
    return Check("float64", quantity, error, bound, why)


def _consistent(label: str, found: PairedDifference, least: float, most: float) -> Iterator[Check]:
    """Check that the interval holds the estimate, that the data's range does, and that p is a probability."""
    yield finite("float64", np.array([found.shift, found.p, found.effect]), what=f"{label}: figures")
    outside = max(found.lower - found.shift, found.shift - found.upper, 0.0)
    yield _check(f"{label}: estimate outside its interval", outside, 0, "An interval holds its estimate.")
    beyond = max(least - found.shift, found.shift - most, 0.0)
    yield _check(f"{label}: estimate outside the data", beyond, 0, "A median of means of two lies in their range.")
    yield _check(f"{label}: p outside [0, 1]", max(-found.p, found.p - 1, 0.0), 0, "It is a probability.")


def _ties(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Differences that are 0 on most frames, the same on most frames, or only two values."""
    for label, differences in (
        ("60 zeros, -1 and pi", np.array([0.0] * 60 + [-1.0, np.pi])),
        ("1000 of 1, 0 and pi", np.array([1.0] * 1000 + [0.0, np.pi])),
        ("zeros and ones", np.repeat([0.0, 1.0], 15)),
        ("one in a hundred", np.array([0.0] * 99 + [1.0])),
    ):
        yield from _consistent(label, _compared(differences), differences.min(), differences.max())
    found = _compared(np.array([0.0] * 60 + [-1.0, np.pi]))
    width = found.upper - found.lower
    yield _check("60 zeros: width of the interval", width, 0, "Every resample has the same median.")


def _constant(device: str) -> Iterator[Check]:  # noqa: ARG001
    """The same difference on all frames."""
    for value in (0.0, 2.0, -1e-12, 1e12):
        found = _compared(np.full(12, value))
        yield from _consistent(f"{value:g} throughout", found, value, value)
        spread = max(abs(found.lower - value), abs(found.upper - value), abs(found.shift - value))
        yield _check(f"{value:g} throughout: interval and estimate off it", spread, 0, "Every resample is the same.")
        effect = abs(found.effect - np.sign(value))
        yield _check(f"{value:g} throughout: effect", effect, 0, "All differences have one sign.")


def _few(device: str) -> Iterator[Check]:  # noqa: ARG001
    """One, two and three frames, many frames of one site, and no frame."""
    for n in (1, 2, 3):
        found = _compared(np.arange(1.0, n + 1))
        yield from _consistent(f"n = {n}", found, 1, n)
        error = abs(found.p - 2.0 ** (1 - n))
        yield _check(f"n = {n}: p against 2^(1 - n)", error, 4 * FLOAT64, "All signs are the same.")
    one_site = _compared(np.arange(20.0), np.zeros(20))
    ends = int(np.isfinite([one_site.lower, one_site.upper]).sum())
    yield _check("one site: finite ends of the interval", ends, 0, "One site does not show how sites differ.")
    two = _compared(np.arange(20.0), np.repeat([0, 1], 10))
    yield from _consistent("two sites", two, 0, 19)
    yield refused("float64", partial(_compared, np.array([])), partial(_compared, np.array([np.inf])))
    verdict = component_claim([1.0, 2.0], [3.0, 4.0, 5.0]).verdict
    yield _check("two seeds: claims", int(verdict is not Verdict.not_claimable), 0, "Three seeds are needed.")


def _sizes(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Differences of 10^-300 and 10^90, with an offset of 10^12, and too large to be squared."""
    random = np.random.default_rng(0)
    plain = random.normal(0.3, 1.0, 40)
    right = _compared(plain)
    for scale in (2.0**-997, 2.0**-100, 2.0**300):
        found = _compared(plain * scale)
        yield from _consistent(f"times {scale:.1e}", found, plain.min() * scale, plain.max() * scale)
        apart = max(abs(getattr(found, name) / scale - getattr(right, name)) for name in ("shift", "lower", "upper"))
        yield _check(f"times {scale:.1e}: figures over the scale", apart, 64 * FLOAT64, "A power of two is exact.")
    offset = 1e12
    found = paired_difference(plain + offset, np.full(40, offset))
    error = abs(found.shift - right.shift)
    yield _check("offset 1e12: shift", error, 2 * offset * FLOAT64, "Values are rounded.")
    single = paired_difference(plain.astype(np.float32), np.zeros(40, np.float32))
    error = abs(single.shift - right.shift)
    yield Check("float32", "shift against float64", error, 4 * FLOAT32, "Values are rounded; medians are not.")
    unusable = ([1e300, 2e300], [1.0, np.nan], [1e308, -1e308])
    yield refused("float64", *(partial(_compared, np.array(values)) for values in unusable))


def _claims(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Seeds with the same result on one side, with results that differ in the last digit, and by 10^-150."""
    for label, a, b in (
        ("one side constant", [1.0, 1.0, 1.0], [1.0, 2.0, 3.0]),
        ("last digit", [1.0, 1.0, 1 + 2e-16], [1.0, 1 + 2e-16, 1.0]),
        ("1e8 and 1e-7", [1e8, 1e8 + 1e-7, 1e8], [1e8, 1e8, 1e8 + 1e-7]),
        ("spread 1e-150", [1e-150, 2e-150, 3e-150], [1e-150, 5e-150, 2e-150]),
        ("spread 1e90", [1e90, 2e90, 3e90], [1e90, 5e90, 2e90]),
    ):
        claim = component_claim(a, b)
        values = np.array([claim.shift, claim.lower, claim.upper, claim.p], float)
        yield finite("float64", values, what=f"{label}: figures")
        claimed = int(claim.verdict is Verdict.differs)
        yield _check(f"{label}: differences claimed", claimed, 0, "The two sides overlap.")
    claimed = int(component_claim([1.0] * 3, [2.0] * 3).verdict is not Verdict.not_claimable)
    yield _check("no seed changes anything: claims", claimed, 0, "There is no spread to compare with.")


def _families(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Holm's correction of p-values of 0, of 1, of the smallest double and of ties."""
    p = np.array([0.0, 1.0, 5e-324, 0.02, 0.02, 0.5])
    adjusted = holm(p)
    yield finite("float64", adjusted, what="p-values")
    wrong = int(((adjusted < p) | (adjusted > 1)).sum())
    yield _check("p-values that fell or exceed 1", wrong, 0, "The correction increases p, to 1 at most.")
    fall = float(max(-np.diff(adjusted[np.argsort(p, kind="stable")]).min(), 0))
    yield _check("order that changed", fall, 0, "The correction is a running maximum.")
    yield _check("values of an empty family", holm([]).size, 0, "An empty family has no values.")
    yield refused("float64", partial(holm, [1.0 + 1e-12]), partial(holm, [np.nan]), partial(holm, [-1e-300]))


def _effects(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Factorial studies with a constant result, with an exact effect, and with values of 10^100."""
    cells = pd.DataFrame([(a, b, s) for a in "xy" for b in "uv" for s in range(3)], columns=["a", "b", "seed"])
    second = (cells["a"] == "y").to_numpy(float)
    noise = np.random.default_rng(0).normal(size=len(cells))
    for label, values, effect in (
        ("constant 0.1", np.full(len(cells), 0.1), 0.0),
        ("effect of 0.1", 0.3 + 0.1 * second, 0.1),
        ("values of 1e100", 1e100 * (second + 1e-3 * noise), 1e100),
    ):
        table = factorial_effects(cells.assign(value=values), ["a", "b"])
        found = table[["estimate", "lower", "upper", "p"]].to_numpy(float)
        yield finite("float64", found, what=f"{label}: figures")
        size = np.abs(values).max()
        error, bound = abs(float(found[0, 0]) - effect) / size, 64 * FLOAT64 if size < 1e50 else 5e-3
        yield _check(f"{label}: effect of a", error, bound, "Sums of twelve; the last has noise of 1e-3 over six runs.")


CASES = (
    Case("statistics: ties", _ties),
    Case("statistics: constant differences", _constant),
    Case("statistics: n of 1, 2 and 3, and one site", _few),
    Case("statistics: differences of every size", _sizes),
    Case("statistics: seeds that hardly vary", _claims),
    Case("statistics: p-values of 0 and 1", _families),
    Case("statistics: effects of constants", _effects),
)
