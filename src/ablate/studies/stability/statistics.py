"""Ties, constants, one site, three frames and values of every size in the statistics of a comparison."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

import numpy as np
import pandas as pd

from ablate.analysis import PairedDifference, Verdict, component_claim, factorial_effects, holm, paired_difference
from ablate.studies.stability.checks import FLOAT32, FLOAT64, Case, Check, finite, refused


def _compared(differences: np.ndarray, clusters: np.ndarray | None = None) -> PairedDifference:
    return paired_difference(differences, np.zeros(len(differences)), clusters)


def _holds_together(label: str, found: PairedDifference, least: float, most: float) -> Iterator[Check]:
    """An interval about its estimate, within the data, and a probability."""
    yield finite("float64", np.array([found.shift, found.p, found.effect]), what=f"{label}: figures")
    outside = max(found.low - found.shift, found.shift - found.high, 0.0)
    yield Check("float64", f"{label}: estimate outside its interval", outside, 0, "An interval is about its estimate.")
    beyond = max(least - found.shift, found.shift - most, 0.0)
    yield Check("float64", f"{label}: estimate outside the data", beyond, 0, "A median of means of two is among them.")
    yield Check("float64", f"{label}: p outside [0, 1]", max(-found.p, found.p - 1, 0.0), 0, "It is a probability.")


def _ties(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Most frames without a difference, most with the same one, and nothing but ties of two values."""
    for label, differences in (
        ("60 zeros, -1 and pi", np.array([0.0] * 60 + [-1.0, np.pi])),
        ("1000 of 1, 0 and pi", np.array([1.0] * 1000 + [0.0, np.pi])),
        ("zeros and ones", np.repeat([0.0, 1.0], 15)),
        ("one in a hundred", np.array([0.0] * 99 + [1.0])),
    ):
        found = _compared(differences)
        yield from _holds_together(label, found, differences.min(), differences.max())
    found = _compared(np.array([0.0] * 60 + [-1.0, np.pi]))
    yield Check(
        "float64", "60 zeros: width of the interval", found.high - found.low, 0, "No resample's median is another."
    )


def _constant(device: str) -> Iterator[Check]:  # noqa: ARG001
    """The same difference on every frame, and none on any."""
    for value in (0.0, 2.0, -1e-12, 1e12):
        found = _compared(np.full(12, value))
        yield from _holds_together(f"{value:g} throughout", found, value, value)
        spread = max(abs(found.low - value), abs(found.high - value), abs(found.shift - value))
        yield Check(
            "float64", f"{value:g} throughout: interval and estimate off it", spread, 0, "Every resample is the same."
        )
        yield Check(
            "float64", f"{value:g} throughout: effect", abs(found.effect - np.sign(value)), 0, "All of one sign."
        )


def _few(device: str) -> Iterator[Check]:  # noqa: ARG001
    """One, two and three frames; many frames of one site; nothing at all."""
    for n in (1, 2, 3):
        found = _compared(np.arange(1.0, n + 1))
        yield from _holds_together(f"n = {n}", found, 1, n)
        yield Check(
            "float64", f"n = {n}: p against 2^(1 - n)", abs(found.p - 2.0 ** (1 - n)), 4 * FLOAT64, "All signs alike."
        )
    one_site = _compared(np.arange(20.0), np.zeros(20))
    ends = int(np.isfinite([one_site.low, one_site.high]).sum())
    yield Check("float64", "one site: finite ends of the interval", ends, 0, "One site tells nothing of others.")
    two = _compared(np.arange(20.0), np.repeat([0, 1], 10))
    yield from _holds_together("two sites", two, 0, 19)
    yield refused("float64", partial(_compared, np.array([])), partial(_compared, np.array([np.inf])))
    verdict = component_claim([1.0, 2.0], [3.0, 4.0, 5.0]).verdict
    yield Check("float64", "two seeds: claims", int(verdict is not Verdict.not_claimable), 0, "Three are needed.")


def _sizes(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Differences of 10^-300 and 10^90, next to an offset of 10^12, and beyond what can be squared."""
    random = np.random.default_rng(0)
    plain = random.normal(0.3, 1.0, 40)
    right = _compared(plain)
    for scale in (2.0**-997, 2.0**-100, 2.0**300):
        found = _compared(plain * scale)
        yield from _holds_together(f"times {scale:.1e}", found, plain.min() * scale, plain.max() * scale)
        apart = max(
            abs(a / scale - b)
            for a, b in ((found.shift, right.shift), (found.low, right.low), (found.high, right.high))
        )
        yield Check(
            "float64", f"times {scale:.1e}: figures over the scale", apart, 64 * FLOAT64, "Powers of two do not round."
        )
    offset = 1e12
    found = paired_difference(plain + offset, np.full(40, offset))
    yield Check(
        "float64", "offset 1e12: shift", abs(found.shift - right.shift), 2 * offset * FLOAT64, "Values are rounded."
    )
    single = paired_difference(plain.astype(np.float32), np.zeros(40, np.float32))
    yield Check(
        "float32",
        "shift against float64",
        abs(single.shift - right.shift),
        4 * FLOAT32,
        "Values are rounded; medians are not.",
    )
    yield refused(
        "float64",
        partial(_compared, np.array([1e300, 2e300])),
        partial(_compared, np.array([1.0, np.nan])),
        partial(_compared, np.array([1e308, -1e308])),
    )


def _claims(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Seeds that do not vary on one side, that vary in the last digit, and by 10^-150."""
    for label, a, b in (
        ("one side constant", [1.0, 1.0, 1.0], [1.0, 2.0, 3.0]),
        ("last digit", [1.0, 1.0, 1 + 2e-16], [1.0, 1 + 2e-16, 1.0]),
        ("1e8 and 1e-7", [1e8, 1e8 + 1e-7, 1e8], [1e8, 1e8, 1e8 + 1e-7]),
        ("spread 1e-150", [1e-150, 2e-150, 3e-150], [1e-150, 5e-150, 2e-150]),
        ("spread 1e90", [1e90, 2e90, 3e90], [1e90, 5e90, 2e90]),
    ):
        claim = component_claim(a, b)
        values = np.array([claim.shift, claim.low, claim.high, claim.p], float)
        yield finite("float64", values, what=f"{label}: figures")
        yield Check(
            "float64", f"{label}: differences claimed", int(claim.verdict is Verdict.differs), 0, "They overlap."
        )
    same = component_claim([1.0] * 3, [2.0] * 3)
    yield Check(
        "float64",
        "no seed changes anything: claims",
        int(same.verdict is not Verdict.not_claimable),
        0,
        "Nothing to judge by.",
    )


def _families(device: str) -> Iterator[Check]:  # noqa: ARG001
    """p-values of 0, 1, the smallest double and ties under Holm's correction."""
    p = np.array([0.0, 1.0, 5e-324, 0.02, 0.02, 0.5])
    adjusted = holm(p)
    yield finite("float64", adjusted, what="p-values")
    yield Check(
        "float64",
        "p-values that fell or exceed 1",
        int(((adjusted < p) | (adjusted > 1)).sum()),
        0,
        "It corrects upwards.",
    )
    order = np.argsort(p, kind="stable")
    yield Check(
        "float64", "order that changed", float(max(-np.diff(adjusted[order]).min(), 0)), 0, "It is a running maximum."
    )
    yield Check("float64", "values of an empty family", holm([]).size, 0, "There is none.")
    yield refused("float64", partial(holm, [1.0 + 1e-12]), partial(holm, [np.nan]), partial(holm, [-1e-300]))


def _effects(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Factorial studies of a constant, of an exact effect, and of values of 10^100."""
    cells = pd.DataFrame([(a, b, s) for a in "xy" for b in "uv" for s in range(3)], columns=["a", "b", "seed"])
    second = (cells["a"] == "y").to_numpy(float)
    noise = np.random.default_rng(0).normal(size=len(cells))
    for label, values, effect in (
        ("constant 0.1", np.full(len(cells), 0.1), 0.0),
        ("effect of 0.1", 0.3 + 0.1 * second, 0.1),
        ("values of 1e100", 1e100 * (second + 1e-3 * noise), 1e100),
    ):
        table = factorial_effects(cells.assign(value=values), ["a", "b"])
        found = table[["estimate", "low", "high", "p"]].to_numpy(float)
        yield finite("float64", found, what=f"{label}: figures")
        size = np.abs(values).max()
        yield Check(
            "float64", f"{label}: effect of a", abs(float(found[0, 0]) - effect) / size,
            64 * FLOAT64 if size < 1e50 else 5e-3, "Sums of twelve; of the last, noise of 1e-3 over six runs.",
        )  # fmt: skip


CASES = (
    Case("statistics: ties", _ties),
    Case("statistics: constant differences", _constant),
    Case("statistics: n of 1, 2 and 3, and one site", _few),
    Case("statistics: differences of every size", _sizes),
    Case("statistics: seeds that hardly vary", _claims),
    Case("statistics: p-values of 0 and 1", _families),
    Case("statistics: effects of constants", _effects),
)
