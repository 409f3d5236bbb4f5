"""How functions of this room are compiled: once, kept on disk, without Python's lock, dividing as NumPy does."""

import atexit
import hashlib
import logging
import math
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import config

Function = TypeVar("Function", bound=Callable[..., object])
Arrays = tuple[np.ndarray, ...]  # several arguments of a compiled function, in one
Vector = tuple[float, float, float]

_KEPT_IN = "CACHE_DIR"  # set by numba.core.config as it is imported, which a type checker cannot see
_ROOM = Path(__file__).parent
_DIGEST = hashlib.sha256(b"".join(file.read_bytes() for file in sorted(_ROOM.rglob("*.py")))).hexdigest()[:16]


def _find_place() -> None:
    """Where Numba finds no place, as in a container whose user has no home, make one for this process."""
    try:
        njit(cache=True)(_find_place)
    except RuntimeError:
        place = tempfile.mkdtemp(prefix="ablate-compiled-")
        setattr(config, _KEPT_IN, place)
        atexit.register(shutil.rmtree, place, ignore_errors=True)
        slow = "compiled code cannot be kept, so that each start takes longer; NUMBA_CACHE_DIR=<folder> names a place"
        logging.getLogger(__name__).warning(slow)


_find_place()


def compiled(function: Function) -> Function:
    """Compile a function when it is first called, or take what was kept of the same sources.

    Numba looks at a function's own file only, and would go on using what it compiled before another file changed that
    the function calls into; so what is kept lies in a folder named by all files of the room. Where the room cannot
    be written, it was installed as a whole, and Numba's own place serves, or else a folder that ends with the process.

    No fast-math: the same numbers whatever the processor's vectors.
    """
    return _kept(function, inlined=False)


def step(function: Function) -> Function:
    """Compile a function that is a part of the loop that calls it: `compiled`, and LLVM puts it in there.

    A call would write all numbers of a View to memory. For one ray this takes longer than to trace it. No references
    to arrays are counted in it, which would lock the counters at every ray, and threads would wait for each other: so
    it cannot make an array.
    """
    return _kept(function, inlined=True)


def _kept(function: Function, inlined: bool) -> Function:
    chosen = getattr(config, _KEPT_IN)  # NUMBA_CACHE_DIR
    base = Path(chosen) if chosen else _ROOM / "__pycache__" if os.access(_ROOM, os.W_OK) else None
    try:
        if base is not None:
            setattr(config, _KEPT_IN, str(base / f"compiled-{_DIGEST}"))
        options: Any = {"forceinline": inlined, "_nrt": not inlined}  # the second is not among Numba's types
        return cast(Function, njit(cache=True, nogil=True, error_model="numpy", **options)(function))
    finally:
        setattr(config, _KEPT_IN, chosen)


_SHIFT = 1.5 * 2.0**52  # added to a number, it leaves the nearest whole number in the last bits


@compiled
def exponential(x: float) -> float:
    """exp(x) within 1e-11 of itself, of x from -700 to 700, else of the nearest of them.

    No branch and no call: LLVM computes several at a time, whatever the processor. x is n ln 2 + r; exp(r) is a series.
    """
    x = min(max(x, -700.0), 700.0)
    shifted = x * (1 / math.log(2)) + _SHIFT
    r = x - (shifted - _SHIFT) * math.log(2)
    series = 1 + r * (1 + r * (1 / 2 + r * (1 / 6 + r * (1 / 24 + r * (1 / 120 + r * (1 / 720 + r * (1 / 5040)))))))
    r4 = r * r * r * r
    series += r4 * r4 * (1 / 40320 + r * (1 / 362880))
    power = (np.float64(shifted).view(np.int64) + np.int64(1023)) << np.int64(52)
    return series * np.int64(power).view(np.float64)
