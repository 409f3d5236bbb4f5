"""The components of a study as values: what each one switches, and by which metric it is judged."""

import math
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from typing import Any

from ablate.setting import check_name

DEPTH = "model.depth"


class Question(StrEnum):
    """What is asked of a component."""

    earns = "earns"  # does it improve its metric?
    saves = "saves"  # does it cost less, and is its metric not worse by the band?


@dataclass(frozen=True)
class Component:
    """One switch of a study.

    A component without a primary metric and a band gets effects and interactions, but no verdict. Both are fixed before
    the runs are scored.

    Attributes
    ----------
    name : str
        The variant without this component is `sa2h-<name>`.
    key : str
        The dotted configuration key that it switches, as `model.attenuation`, `training.reconstruction` or `encoding`.
    on, off : optional
        The level of the full model, or several of which it has one, and the level that stands for "without the
        component". Where they are not declared, the level of the reference run is the one with the component.
    label : str
        What figures and reports call it; the last part of the key when left out.
    purpose : str
        One sentence on what it is for.
    metric : str, optional
        Name of the primary metric.
    band : float, optional
        The change that is too small to matter, in units of the metric: where there is no scale.
    share : float, optional
        The same as a share of the way from the formula to re-simulation, which counts where a study has both.
    question : Question
        What is asked of it.

    Raises
    ------
    ValueError
        When the name cannot be part of a file name, the key is empty, or the band or the share is not a finite number
        above 0.
    """

    name: str
    key: str
    on: object = None
    off: object = None
    label: str = ""
    purpose: str = ""
    metric: str | None = None
    band: float | None = None
    share: float | None = None
    question: Question = Question.earns

    @property
    def levels_on(self) -> tuple[object, ...]:
        """The levels with the component."""
        return self.on if isinstance(self.on, tuple) else (self.on,)

    def compares(self, first: Any, second: Any) -> bool:
        """Whether these two levels of its key are the ones that it was declared with."""
        if self.key == DEPTH and self.off is not None:  # small frames may have a level less
            declared = abs(self.on - self.off)  # type: ignore[operator]
            return bool(abs(first - second) >= declared - 1)
        levels = {first, second}
        levels_on = set(self.levels_on)
        off_is_compared = self.off is None or levels - levels_on == {self.off}
        on_is_compared = self.on is None or len(levels & levels_on) == 1
        return off_is_compared and on_is_compared

    def __post_init__(self) -> None:
        check_name("component", self.name)
        if not self.key:
            raise ValueError(f"component {self.name}: key is empty; allowed is a dotted key, as model.attenuation")
        for name, value in (("band", self.band), ("share", self.share)):
            if value is not None and not (math.isfinite(value) and value > 0):
                raise ValueError(f"component {self.name}: {name}={value}: allowed are finite numbers above 0")
        if not self.label:
            object.__setattr__(self, "label", self.key.rpartition(".")[2])


def key_of(factor: str) -> str:
    """The dotted key of a factor of a design: `model.noise` of `model.noise=input`, one of several levels of a key."""
    return factor.partition("=")[0]


def with_undeclared(components: Sequence[Component], factors: Collection[str]) -> tuple[Component, ...]:
    """The components, and one without a metric for each key of these factors that none of them switches."""
    declared = dict.fromkeys(component.key for component in components)
    keys = dict.fromkeys(key_of(factor) for factor in factors)
    short = short_keys([*declared, *keys])
    undeclared = [Component(name=short[key], key=key) for key in keys if key not in declared]
    return (*components, *undeclared)


def told_by(levels: Mapping[str, Sequence[object]], components: Sequence[Component]) -> list[Component]:
    """The components of keys of which runs have several levels; of those that share a key, the ones with their levels.

    `levels` are those that runs have, by key. Where none of those of a key fits, the first stands for it.
    """
    told: dict[str, list[Component]] = {}
    for component in components:
        levels_of_key = levels.get(component.key, ())
        if len(levels_of_key) > 1:
            told.setdefault(component.key, []).append(component)
    for key, several in told.items():
        if len(several) > 1:
            pairs = list(combinations(levels[key], 2))
            told[key] = [c for c in several if any(c.compares(*pair) for pair in pairs)] or several[:1]
    return [component for component in components if component in told.get(component.key, ())]


def short_keys(factors: Collection[str]) -> dict[str, str]:
    """How factors are written in texts and figures: the last part of the key, or the key where two end alike."""
    keys = dict.fromkeys(key_of(factor) for factor in factors)
    last = {key: key.rpartition(".")[2] for key in keys}
    count = Counter(last.values())
    short = {key: part if count[part] == 1 else key for key, part in last.items()}
    return {factor: short[key_of(factor)] + factor.removeprefix(key_of(factor)) for factor in factors}


def level_with(component: Component, levels: Sequence[object]) -> object:
    """Which of two levels is the one with the component; `levels` starts with that of the reference run.

    Of two depths it is the one on the side that is declared: a depth follows the size of the frame, and the smaller
    one is that of the full model at every size.
    """
    if component.key == DEPTH and component.off is not None:
        smaller = component.on < component.off  # type: ignore[operator]
        return min(levels) if smaller else max(levels)  # type: ignore[type-var]
    return next((level for level in levels if level in component.levels_on), levels[0])
