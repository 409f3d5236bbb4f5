"""Which metrics are computed: named, named together, or a function of the user's own."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib import import_module

from ablate.metrics.evaluation import IMAGE_METRICS, ImageMetric

FID_METRICS = ("fid", "kid")  # on Inception's features
SPECKLE_METRICS = ("fd_speckle", "kd_speckle")
SET_METRICS = (*FID_METRICS, *SPECKLE_METRICS, "noise_sd")
METRIC_SETS = {
    "all": (*IMAGE_METRICS, *SET_METRICS),
    "paper": ("psnr", "mae", "pchi2", "fid", "fd_speckle"),  # its Table II, and what stands in for FID without weights
}


@dataclass(frozen=True)
class Metrics:
    """The metrics of an evaluation.

    Attributes
    ----------
    of_image : mapping of str to callable
        Those that every image has.
    of_set : frozenset of str
        Those of `SET_METRICS`, that only a set of images has.
    """

    of_image: Mapping[str, ImageMetric]
    of_set: frozenset[str]

    @property
    def names(self) -> frozenset[str]:
        return self.of_set.union(self.of_image)


def choose_metrics(asked: str | Iterable[str] = "all") -> Metrics:
    """The metrics behind their names.

    Parameters
    ----------
    asked : str or iterable of str
        Names of metrics, `all`, `paper`, and dotted paths of functions of a `Pair` that return a float, or None where
        an image offers nothing to measure: `my_package.my_metric` is then the metric `my_metric`.

    Returns
    -------
    Metrics

    Raises
    ------
    ValueError
        When a name is unknown, a path leads to no function, or its last part is the name of another metric.
    """
    if not isinstance(asked, Iterable):
        raise ValueError(f"metrics={asked}: {_allowed()}")
    of_image: dict[str, ImageMetric] = {}
    of_set: set[str] = set()
    for entry in (asked,) if isinstance(asked, str) else asked:
        for name in METRIC_SETS.get(entry, (entry,)):
            if name in IMAGE_METRICS:
                of_image[name] = IMAGE_METRICS[name]
            elif name in SET_METRICS:
                of_set.add(name)
            else:
                own, metric = _imported(name)
                if of_image.setdefault(own, metric) is not metric:
                    raise ValueError(f"metrics: two of them are called {own}")
    if not (of_image or of_set):
        raise ValueError(f"metrics: none is named; {_allowed()}")
    return Metrics(of_image, frozenset(of_set))


def _imported(path: object) -> tuple[str, ImageMetric]:
    module, _, name = str(path).rpartition(".")
    if not module:
        raise ValueError(f"metrics={path}: {_allowed()}")
    try:
        metric = getattr(import_module(module), name)
    except Exception as error:  # whatever the user's module does
        raise ValueError(f"metrics={path}: {type(error).__name__}: {error}; {_allowed()}") from error
    if not callable(metric):
        raise ValueError(f"metrics={path}: is no function; {_allowed()}")
    if name in METRIC_SETS["all"]:
        raise ValueError(f"metrics={path}: {name} is the name of another metric")
    return name, metric


def _allowed() -> str:
    names = ", ".join((*METRIC_SETS, *METRIC_SETS["all"]))
    return f"allowed are {names}, and the path of a function of yours (my_package.my_metric)"
