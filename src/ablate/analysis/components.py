"""The components of a study as values: what each one switches, and by which metric it is judged."""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass

from ablate.setting import check_name

DEPTH = "model.depth"


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
        The improvement that is too small to matter, in units of the metric.

    Raises
    ------
    ValueError
        When the name cannot be part of a file name, the key is empty, or the band is not a finite number above 0.
    """

    name: str
    key: str
    on: object = None
    off: object = None
    label: str = ""
    purpose: str = ""
    metric: str | None = None
    band: float | None = None

    @property
    def levels_on(self) -> tuple[object, ...]:
        """The levels with the component."""
        return self.on if isinstance(self.on, tuple) else (self.on,)

    def __post_init__(self) -> None:
        check_name("component", self.name)
        if not self.key:
            raise ValueError(f"component {self.name}: key is empty; allowed is a dotted key, as model.attenuation")
        if self.band is not None and not (math.isfinite(self.band) and self.band > 0):
            raise ValueError(f"component {self.name}: band={self.band}: allowed are finite numbers above 0")
        if not self.label:
            object.__setattr__(self, "label", self.key.rpartition(".")[2])


def with_undeclared(components: Sequence[Component], keys: Collection[str]) -> tuple[Component, ...]:
    """The components, and one without a metric for each of the dotted keys that none of them switches."""
    declared = {component.key for component in components}
    short = short_keys([*declared, *keys])
    undeclared = [Component(name=short[key], key=key) for key in keys if key not in declared]
    return (*components, *undeclared)


def short_keys(keys: Iterable[str]) -> dict[str, str]:
    """By dotted key, how it is written in texts and figures: its last part, or the whole key where two end alike."""
    last = {key: key.rpartition(".")[2] for key in keys}
    count = Counter(last.values())
    return {key: part if count[part] == 1 else key for key, part in last.items()}


def level_with(component: Component, levels: Sequence[object]) -> object:
    """Which of two levels is the one with the component; `levels` starts with that of the reference run.

    Of two depths it is the one on the side that is declared: a depth follows the size of the frame, and the smaller
    one is that of the full model at every size.
    """
    if component.key == DEPTH and component.off is not None:
        smaller = component.on < component.off  # type: ignore[operator]
        return min(levels) if smaller else max(levels)  # type: ignore[type-var]
    return next((level for level in levels if level in component.levels_on), levels[0])
