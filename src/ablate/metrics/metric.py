"""What there is to know of a metric: what it reads, how it is computed, printed, judged, shown and stored."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from enum import Enum, Flag, StrEnum, auto
from functools import cached_property

import numpy as np

from ablate.metrics.patches import check_pair, patch_chi2

# Names in stored scores, once for all rooms that write or read them.
SCORE_COLUMNS = ("frame", "site", "metric", "value")  # of an evaluation, one row a metric of a frame
MODEL, RESIMULATED, FORMULA = "model", "resimulation", "formula"  # sources of images: a trained generator, and none
SCALAR_COLUMNS = ("variant", "seed", "metric", "value")  # one row a metric of a run; `BOUNDS` may follow
BOUNDS = ("lower", "upper")  # ends of an interval: columns of tables, and suffixes as in `test/fd_speckle_lower`
FRAME_TIME = "ms_per_frame"  # of a network, timed beside the others of its study; its bounds are quartiles
# What stands before the scalars of a source, as in `test/floor_psnr`.
SCALAR_PREFIXES = {MODEL: "", RESIMULATED: "floor_", FORMULA: "formula_"}
BASELINE_PREFIXES = (SCALAR_PREFIXES[RESIMULATED], SCALAR_PREFIXES[FORMULA])
# Kinds of NumPy's types that an array of a pair may have, and how a message calls them.
_NUMBERS = "fiu"
_KINDS = {"mask": "b", "tissue_mask": "b", "bone_mask": "b", "draws": "u", "segmentation": "iu"}
_KIND_NAMES = {"b": "bool", "u": "uint8", "iu": "integers", _NUMBERS: "numbers"}


class Direction(Enum):
    """Which values are better."""

    higher = "higher"
    lower = "lower"
    zero = "zero"
    none = "none"  # the metric describes, it does not judge


class Pixels(StrEnum):
    """Which frames a metric is of: the images, or the frames on the network's own grid, mostly that of beam space.

    Scan conversion hides a pattern of beam space.
    """

    image = "image"
    network = "network"


class Resimulation(StrEnum):
    """What the same frame simulated with other scatterers and other paths tells about a metric."""

    floor = "floor"  # no stochastic renderer can do better
    level = "level"  # of a perfect stochastic renderer; better is smooth, or knows the scatterers
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


class Shown(Flag):
    """Where a metric is shown beside `table.csv`, the statistics and its own figure, which have every metric."""

    nowhere = 0
    headline = auto()  # the first page of the parent run, the paper's Fig. 4, error against run time
    table = auto()  # the paper's Table II
    screen = auto()
    report = auto()  # unfolded in the report
    everywhere = headline | table | screen | report


class FeatureKind(Enum):
    """Features that a distance between two sets of images is computed on."""

    inception = "Inception"
    speckle = "the speckle descriptor"


@dataclass(frozen=True, eq=False)
class Pair:
    """A prediction beside its target and the maps of the frame; raises ValueError when shapes or dtypes do not fit.

    The arrays are views that cannot be written to: what one metric changed, all later ones would read.

    Attributes
    ----------
    prediction, target : (H, W) uint8
        Grey levels.
    mask : (H, W) bool
        The fan.
    tissue_mask : (H, W) bool, optional
        Pixels of tissue; fluid, gas and the outside are False.
    attenuation : (H, W) float in [0, 1], optional
        The integral attenuation map.
    depth_mm : (H, W) float, mm, optional
        Distance from the probe's face along the scanline.
    segmentation : (H, W) uint8, optional
        Tissue labels.
    bone_mask : (H, W) bool, optional
        Pixels of bone.
    pixel_mm : (float, float), mm, optional
        Height and width of a pixel.
    draws : (k >= 2, H, W) uint8, optional
        The prediction, and the same frame with other draws of the generator's noise.
    """

    prediction: np.ndarray
    target: np.ndarray
    mask: np.ndarray
    tissue_mask: np.ndarray | None = None
    attenuation: np.ndarray | None = None
    depth_mm: np.ndarray | None = None
    segmentation: np.ndarray | None = None
    bone_mask: np.ndarray | None = None
    pixel_mm: tuple[float, float] | None = None
    draws: np.ndarray | None = None

    def __post_init__(self) -> None:
        check_pair(self.prediction, self.target)
        for name, array in vars(self).items():
            if isinstance(array, np.ndarray):
                _check_array(name, array, self.target.shape)
                view = array.view()
                view.flags.writeable = False
                object.__setattr__(self, name, view)
        if self.draws is not None and not np.array_equal(self.draws[0], self.prediction):
            raise ValueError("draws must begin with the prediction")

    @cached_property
    def chi2_map(self) -> np.ndarray:
        """(H // 20, W // 20) float: patch chi-square map, computed once."""
        chi2 = patch_chi2(self.prediction, self.target)
        chi2.flags.writeable = False
        return chi2


def _check_array(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise ValueError unless an array of a pair fits its images, of `shape`, and has the type that its name asks."""
    if name == "draws" and (array.shape[1:] != shape or len(array) < 2):
        raise ValueError(f"draws must be (k >= 2, {shape[0]}, {shape[1]}), got {array.shape}")
    if name != "draws" and array.shape != shape:
        raise ValueError(f"{name} must be {shape}, got {array.shape}")
    kinds = _KINDS.get(name, _NUMBERS)
    if array.dtype.kind not in kinds:
        raise ValueError(f"{name} must be {_KIND_NAMES[kinds]}, got {array.dtype}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")


@dataclass(frozen=True, eq=False)
class MovedPair:
    """An image before and after a known motion of the probe, both rendered with the same noise.

    Attributes
    ----------
    before, after : (H, W) uint8
        Grey levels.
    mask : (H, W) bool
        The fan.
    tissue_mask : (H, W) bool
        Pixels of soft tissue after the motion.
    rows_before, columns_before : (H, W) float, px
        Where the image before shows what each pixel shows after.
    in_plane : bool
        Whether the image plane still shows the same points of the body.
    """

    before: np.ndarray
    after: np.ndarray
    mask: np.ndarray
    tissue_mask: np.ndarray
    rows_before: np.ndarray
    columns_before: np.ndarray
    in_plane: bool


ImageMetric = Callable[[Pair], float | None]
MotionMetric = Callable[[Sequence[MovedPair]], float | None]


@dataclass(frozen=True)
class SetDistance:
    """A distance between two sets of features, each (n, d) float, as a metric."""

    features: FeatureKind
    distance: Callable[[np.ndarray, np.ndarray], float]
    resamples: int = 200  # of probe sites, for its interval


@dataclass(frozen=True)
class Metric:
    """One metric. Everything that prints, draws, tests or logs it reads this entry.

    A metric of the package is a constant of this type in the module of its function; `METRICS` finds it there.

    Attributes
    ----------
    name : str
        It is logged by this name, with `test/` before it.
    label : str
        How it is printed; as its name when left out.
    unit : str
        Printed after the label.
    better : Direction
        Which values are better.
    resimulation : Resimulation
        What the value of re-simulation tells.
    group : Group
        The kind of thing that it measures.
    decimals : int
        With which it is printed.
    shown : Shown
        Where it is shown beside `table.csv`, the statistics and its own figure.
    of_image : callable, optional
        Takes a `Pair` and gives a value, or None where the image offers nothing to measure.
    pixels : Pixels
        What the pair of `of_image` shows.
    of_set : SetDistance, optional
        A distance between all rendered images and all targets.
    of_draws : callable, optional
        As `of_image`, of a pair that has draws. Frames are rendered with more than one draw of noise only for it.
    of_motion : callable, optional
        Takes a sequence of `MovedPair`, one a motion of a frame, and gives a value or None. Only frames of a simulator
        can be moved.
    place : float
        Tables and figures are in rising order of it.
    """

    name: str
    _: KW_ONLY
    label: str = ""
    unit: str = ""
    better: Direction = Direction.none
    resimulation: Resimulation = Resimulation.none
    group: Group = Group.own
    decimals: int = 3
    shown: Shown = Shown.nowhere
    of_image: ImageMetric | None = None
    pixels: Pixels = Pixels.image
    of_set: SetDistance | None = None
    of_draws: ImageMetric | None = None
    of_motion: MotionMetric | None = None
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
        return any([self.of_image, self.of_set, self.of_draws, self.of_motion])

    def uses(self, features: FeatureKind) -> bool:
        """Whether it is a distance of these features."""
        return self.of_set is not None and self.of_set.features is features

    def badness(self, value: float) -> float:
        """A number that is smaller the better the value; NaN when the metric does not judge."""
        signs = {Direction.higher: -value, Direction.lower: value, Direction.zero: abs(value)}
        return signs.get(self.better, float("nan"))


def is_bound(name: str) -> bool:
    """Whether a scalar is an end of the interval of another."""
    return any(name.endswith(f"_{side}") for side in BOUNDS)
