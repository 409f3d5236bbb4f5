"""The stages of a simulated frame, and a context in which each of them is observed, for example timed."""

import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import StrEnum
from functools import partial, wraps
from typing import Any, TypeVar, cast

import torch

Function = TypeVar("Function", bound=Callable[..., Any])

#: Gets a stage, its function and the arguments; it must call the function and return its result.
Observer = Callable[["Stage", Callable[..., Any], tuple[Any, ...]], Any]


class Stage(StrEnum):
    """What a frame's time is spent on, in the order that the stages run."""

    pixel_labels = "labels of the pixels"
    attenuation_labels = "attenuation, its labels"
    attenuation_sum = "attenuation, its sum"
    surface_maps = "maps of surfaces"
    grain = "grain"
    probe_rays = "rays at the probe"
    tracing = "rays, to the last echo"
    scanline_labels = "labels of the scanlines"
    surface_echoes = "echoes onto lines"
    clutter = "clutter onto lines"
    illumination = "illumination"
    aperture = "aperture"
    scatterer_level = "level and texture"
    scatterers = "scatterers"
    point_spread = "point spread"
    grey_levels = "grey levels"
    scan_conversion = "scan conversion"


_observer: Observer | None = None


def stage(which: Stage) -> Callable[[Function], Function]:
    """Declare that a function is a stage; unobserved, a call costs a fraction of a microsecond more."""

    def declare(function: Function) -> Function:
        @wraps(function)
        def run(*args: Any, **kwargs: Any) -> Any:
            called = partial(function, **kwargs) if kwargs else function
            return called(*args) if _observer is None else _observer(which, called, args)

        return cast(Function, run)

    return declare


@contextmanager
def observe_stages(observer: Observer) -> Iterator[None]:
    """Run every stage of all simulators of this process through an observer."""
    global _observer
    before, _observer = _observer, observer
    try:
        yield
    finally:
        _observer = before


@contextmanager
def stage_times() -> Iterator[dict[str, list[float]]]:
    """Collect the milliseconds of every call, a list for each stage, of all simulators of this process.

    A stage within another on one thread, as the aperture within the maps of surfaces, counts for itself alone.
    """
    taken: dict[str, list[float]] = defaultdict(list)
    thread_times = threading.local()

    def timed(which: Stage, function: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        # milliseconds of the stages that ran within each one that runs
        within: list[float] = thread_times.__dict__.setdefault("within", [0.0])
        _wait_for_gpu()
        start = time.perf_counter()
        within.append(0.0)
        result = function(*args)
        _wait_for_gpu()
        ms = 1e3 * (time.perf_counter() - start)
        taken[which].append(ms - within.pop())
        within[-1] += ms
        return result

    with observe_stages(timed):
        yield taken


def _wait_for_gpu() -> None:
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
