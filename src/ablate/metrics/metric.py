"""What there is to know of a metric: how it is computed, printed, judged, and where it is shown."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum, Flag, StrEnum, auto

import numpy as np

from ablate.metrics.pair import Pair


class Direction(Enum):
    """Which values are better."""

    higher = "higher"
    lower = "lower"
    zero = "zero"
    none = "none"  # the metric describes, it does not judge


class Resimulation(StrEnum):
    """What the same frame simulated with other scatterers and other paths tells about a metric."""

    floor = "floor"  # no stochastic renderer can do better
    level = "level"  # a perfect stochastic renderer scores this; a better score means smoothing
    none = "none"


class Group(StrEnum):
    """The kind of thing that a metric measures."""

    pixel = "pixel"
    patch = "patch"
    set = "set"  # all images together
    mechanism = "mechanism"  # whether a component does what it is for
    simulation = "simulation"
    cost = "cost"  # of a network, not of its images: no claim is made about it
    own = "own"  # of a user


#: How an error of what a component is for is judged: it is least where it is right.
MECHANISM = (Direction.lower, Resimulation.floor, Group.mechanism)


class Shown(Flag):
    """Where a metric is shown beside `table.csv`, the statistics and its own figure, which have every metric."""

    nowhere = 0
    headline = auto()  # the first page of the parent run, the paper's Fig. 4, error against run time
    table = auto()  # the paper's Table II
    panels = auto()  # the figures of seeds and of effects
    screen = auto()
    report = auto()  # unfolded in the report
    drawn = panels | screen
    everywhere = headline | table | panels | screen | report


class FeatureKind(Enum):
    """Features that a distance between two sets of images is computed on."""

    inception = "Inception"
    speckle = "the speckle descriptor"


ImageMetric = Callable[["Pair"], "float | None"]


@dataclass(frozen=True)
class SetDistance:
    """A distance between two sets of features, and how often sites are resampled for its interval."""

    features: FeatureKind
    distance: Callable[[np.ndarray, np.ndarray], float]
    resamples: int = 200


@dataclass(frozen=True)
class Metric:
    """One metric. Everything that prints, draws, tests or logs it reads this entry.

    A metric of the package is a constant of this type in the module of its function; `METRICS` finds it there.

    Attributes
    ----------
    name, label : str
        As it is logged, without `test/`, and as it is printed; the label is the name when left out.
    decimals : int
        Of a printed mean.
    of_image : callable, optional
        Value of a `Pair`, or None where the image offers nothing to measure.
    of_draws : callable, optional
        The same of a `Pair` with draws. Frames are rendered with more than one draw of noise only for such a metric.
    place : float
        Where it stands in tables and figures, which are in rising order.
    """

    name: str
    label: str = ""
    unit: str = ""
    better: Direction = Direction.none
    resimulation: Resimulation = Resimulation.none
    group: Group = Group.own
    decimals: int = 3
    shown: Shown = Shown.nowhere
    of_image: ImageMetric | None = None
    of_set: SetDistance | None = None
    of_draws: ImageMetric | None = None
    place: float = math.inf

    def __post_init__(self) -> None:
        if not self.label:
            object.__setattr__(self, "label", self.name)

    @property
    def title(self) -> str:
        """Label with its unit."""
        return f"{self.label} ({self.unit})" if self.unit else self.label

    @property
    def computed(self) -> bool:
        """Whether an evaluation computes it from images."""
        return any((self.of_image, self.of_set, self.of_draws))

    def uses(self, features: FeatureKind) -> bool:
        """Whether it is a distance of these features."""
        return self.of_set is not None and self.of_set.features is features

    def badness(self, value: float) -> float:
        """A number that is smaller the better the value; NaN when the metric does not judge."""
        signs = {Direction.higher: -value, Direction.lower: value, Direction.zero: abs(value)}
        return signs.get(self.better, float("nan"))
