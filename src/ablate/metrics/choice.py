"""Find the metrics that a user asks for, by name, by the name of a set, or by the path of a metric of their own."""

from collections.abc import Iterable, Mapping
from importlib import import_module

from ablate.metrics.metric import FeatureKind, Metric, Shown
from ablate.metrics.registry import METRICS, register

METRIC_SETS = {
    "all": tuple(name for name, metric in METRICS.items() if metric.computed),
    "paper": tuple(name for name, metric in METRICS.items() if metric.computed and metric.shown & Shown.table),
}


def choose_metrics(asked: str | Iterable[str] = "all") -> dict[str, Metric]:
    """Return metrics by name; `metric_of` knows those of the user from now on.

    Parameters
    ----------
    asked : str or iterable of str
        Names of metrics, `all`, `paper`, and dotted paths such as `my_package.my_metric` of a user's function of a
        `Pair`, which returns a float or None where an image has nothing to measure, or of a user's `Metric`.

    Raises
    ------
    ValueError
        When a name is unknown, a path leads to no function or metric, or its name is that of another metric.
    """
    if not isinstance(asked, Iterable):
        raise ValueError(f"metrics={asked}: {_allowed()}")
    chosen: dict[str, Metric] = {}
    for entry in (asked,) if isinstance(asked, str) else asked:
        if not isinstance(entry, str):
            raise ValueError(f"metrics={entry}: is no name; {_allowed()}")
        for name in METRIC_SETS.get(entry, (entry,)):
            metric = METRICS[name] if name in METRIC_SETS["all"] else _imported(name)
            if chosen.setdefault(metric.name, metric) != metric:
                raise ValueError(f"metrics: two of them are called {metric.name}")
    if not chosen:
        raise ValueError(f"metrics: none is named; {_allowed()}")
    return chosen


def needs_inception(metrics: Mapping[str, Metric]) -> bool:
    """Whether one of them is a distance of Inception's features."""
    return any(metric.uses(FeatureKind.inception) for metric in metrics.values())


def _imported(path: object) -> Metric:
    module, _, name = str(path).rpartition(".")
    if not module:
        raise ValueError(f"metrics={path}: {_allowed()}")
    try:
        found = getattr(import_module(module), name)
    except (Exception, SystemExit) as error:  # whatever the user's module does
        said = " ".join(str(error).split())
        raise ValueError(f"metrics={path}: {type(error).__name__}: {said:.200}; {_allowed()}") from error
    metric = found if isinstance(found, Metric) else Metric(name, of_image=found)
    if not callable(metric.of_image):
        raise ValueError(f"metrics={path}: is no function; {_allowed()}")
    try:
        return register(metric)
    except ValueError as error:
        raise ValueError(f"metrics={path}: {error}") from error


def _allowed() -> str:
    names = ", ".join((*METRIC_SETS, *METRIC_SETS["all"]))
    return f"allowed are {names}, and the path of a function of yours (my_package.my_metric)"
