"""Where the time of a frame goes: the stages of the simulator, timed from outside, so that frames pay for no clock."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import wraps
from typing import Any

import torch

from ablate.ultrasound import simulator as frame
from ablate.ultrasound.scan_conversion import ScanConverter
from ablate.ultrasound.speckle import Speckle

#: Name of a stage, where its function is looked up, and the function's name; in the order they run.
STAGES: tuple[tuple[str, Any, str], ...] = (
    ("labels of the pixels", frame, "segment"),
    ("attenuation, its labels", frame, "plane_labels"),
    ("attenuation, its sum", frame, "integral_attenuation"),
    ("rays at the probe", frame, "leave_probe"),
    ("rays, to the last echo", frame, "trace"),
    ("labels of the scanlines", frame, "sampled_lines"),
    ("echoes onto lines", frame, "surface_lines"),
    ("clutter onto lines", frame, "clutter_lines"),
    ("illumination", frame, "mean_level_db"),
    ("level and texture", Speckle, "light"),
    ("scatterers", Speckle, "__call__"),
    ("point spread", frame, "blur"),
    ("grey levels", frame, "grey_levels"),
    ("scan conversion", ScanConverter, "__call__"),
)


@contextmanager
def stage_times() -> Iterator[dict[str, list[float]]]:
    """Collect the milliseconds of every call of every stage, of all simulators of this process.

    Yields
    ------
    dict of str to list of float
        By name of the stage, in the order of the calls; filled while the context is open.
    """
    taken: dict[str, list[float]] = defaultdict(list)
    with ExitStack() as stack:
        for name, owner, attribute in STAGES:
            original = getattr(owner, attribute)
            stack.callback(setattr, owner, attribute, original)
            setattr(owner, attribute, _timed(original, taken[name]))
        yield taken


def _timed(function: Callable[..., Any], taken: list[float]) -> Callable[..., Any]:
    @wraps(function)
    def timed(*args: Any, **kwargs: Any) -> Any:
        _wait()
        start = time.perf_counter()
        result = function(*args, **kwargs)
        _wait()
        taken.append(1e3 * (time.perf_counter() - start))
        return result

    return timed


def _wait() -> None:
    if torch.cuda.is_initialized():
        torch.cuda.synchronize()
