"""Every metric of the package, found in the modules that declare them, and those of the user by name or path.

A new metric of the package is one module below `ablate.metrics` with a function and its `Metric`.
"""

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from importlib import import_module
from pkgutil import walk_packages
from typing import Any, TypeVar

import numpy as np

from ablate import metrics as package
from ablate.metrics.metric import BASELINE_PREFIXES, FeatureKind, Metric, MovedPair, Pair, Shown, is_bound
from ablate.setting import check_name, did_you_mean
from ablate.user_code import code_digest, load

#: Raise it when a metric gives another value for the same images: kept scores, of runs and of re-simulation, are then
#: made anew.
METRICS_VERSION = 3


def _declared() -> dict[str, Metric]:
    """The entries of all modules below `ablate.metrics` but this one."""
    modules = [module.name for module in walk_packages(package.__path__, f"{package.__name__}.")]
    modules.remove(__name__)
    values = [value for name in modules for value in vars(import_module(name)).values()]
    entries = {value for value in values if isinstance(value, Metric)}
    return {metric.name: metric for metric in sorted(entries, key=lambda metric: (metric.place, metric.name))}


#: By name, in the order of every table and figure.
METRICS = _declared()
METRIC_SETS = {
    "all": tuple(name for name, metric in METRICS.items() if metric.computed),
    "paper": tuple(name for name, metric in METRICS.items() if metric.computed and metric.shown & Shown.table),
}
_COLUMNS = {"variant", "seed", "data", "encoding", "encoding_seed", "probe", "preset", "scene"}  # of runs.csv
_OWN: dict[str, Metric] = {}  # of the user, since they were chosen
PairOfAKind = TypeVar("PairOfAKind", Pair, MovedPair)


def metric_of(name: str) -> Metric:
    """The entry of a metric; one that is not known is shown under its own name and not judged."""
    return METRICS.get(name) or _OWN.get(name) or Metric(name)


def shown_in(place: Shown) -> list[str]:
    """Names of the metrics that are shown in a place, those of the package first.

    A metric of the user, who named it, is always on the screen and in the report.
    """
    user_metrics = [metric.name for metric in _OWN.values() if (metric.shown | Shown.screen | Shown.report) & place]
    return [*(metric.name for metric in METRICS.values() if metric.shown & place), *user_metrics]


def is_own(metric: Metric) -> bool:
    """Whether a metric is one of the user, whose code may do anything."""
    return METRICS.get(metric.name) is not metric


def apart(pair: PairOfAKind) -> PairOfAKind:
    """A pair with arrays of its own: torch writes to what NumPy has locked."""
    values = {field.name: getattr(pair, field.name) for field in fields(pair)}
    copied: dict[str, Any] = {name: value.copy() for name, value in values.items() if isinstance(value, np.ndarray)}
    return replace(pair, **copied)


def evaluate_image(pair: Pair, metrics: Iterable[Metric] = METRICS.values()) -> dict[str, float]:
    """Every per-image metric that this pair allows, by name.

    Metrics that the frame offers nothing for (no shadow in it, no tissue mask, no draws) are left out. `psnr` may be
    inf, of identical images. No other metric of the package is NaN or infinite, but one of the user's may be. A metric
    of the user's gets arrays of its own, so that what it changes is not what others read.

    What a metric raises, such as a ValueError where it writes to an array of the pair, has a note that names it.
    """
    values = {}
    for metric in metrics:
        try:
            measure = metric.of_image
            if pair.draws is not None and metric.of_draws is not None:
                measure = metric.of_draws
            value = None if measure is None else measure(apart(pair) if is_own(metric) else pair)
            if value is not None:
                values[metric.name] = float(value)
        except Exception as error:
            error.add_note(f"by the metric {metric.name}")
            raise
    return values


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
    entries = [asked] if isinstance(asked, str) else asked
    for entry in entries:
        if not isinstance(entry, str):
            raise ValueError(f"metrics={entry}: is no name; {_allowed()}")
        for name in METRIC_SETS.get(entry, (entry,)):
            metric = METRICS[name] if name in METRIC_SETS["all"] else _imported(name)
            if chosen.setdefault(metric.name, metric) != metric:
                raise ValueError(f"metrics: two of them are called {metric.name}")
    if not chosen:
        raise ValueError(f"metrics: none is named; {_allowed()}")
    titles = Counter(metric.title for metric in {**METRICS, **chosen}.values())
    twice = [title for title, count in titles.items() if count > 1]
    if twice:
        raise ValueError(f"metrics: two of them have the title {twice[0]}; a column of a table has one")
    return chosen


def needs_inception(metrics: Mapping[str, Metric]) -> bool:
    """Whether one of them is a distance of Inception's features."""
    return any(metric.uses(FeatureKind.inception) for metric in metrics.values())


def _imported(path: str) -> Metric:
    """A user's metric, known from now on to tables, figures and statistics."""
    if "." not in path:
        raise ValueError(f"metrics={path}: {_allowed()}{did_you_mean(path, (*METRIC_SETS, *METRIC_SETS['all']))}")
    try:
        named = load(path)
        code_digest(path)  # read now: a file that is edited later is not what runs
    except ValueError as error:
        raise ValueError(f"metrics={path}: {error}; {_allowed()}") from error
    metric = named if isinstance(named, Metric) else Metric(path.rpartition(".")[2], of_image=named)
    if not callable(metric.of_image or metric.of_draws):
        raise ValueError(f"metrics={path}: is no function; {_allowed()}")
    check_name(f"metrics={path}: name", metric.name)
    taken = metric.name in METRICS or metric.name in _COLUMNS
    if taken or metric.name.startswith(BASELINE_PREFIXES) or is_bound(metric.name):
        other = "another metric, of an end of an interval, or of a column of runs.csv"
        raise ValueError(f"metrics={path}: {metric.name} is the name of {other}")
    _OWN[metric.name] = metric  # in place of an earlier one of that name
    return metric


def _allowed() -> str:
    names = ", ".join((*METRIC_SETS, *METRIC_SETS["all"]))
    return f"allowed are {names}, and the path of a function of yours (my_package.my_metric)"
