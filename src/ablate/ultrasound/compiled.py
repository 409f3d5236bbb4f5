"""How functions of this room are compiled: once, kept on disk, without Python's lock, dividing as NumPy does."""

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar, cast

from numba import njit
from numba.core import config

Function = TypeVar("Function", bound=Callable[..., object])

_KEPT_IN = "CACHE_DIR"  # set by numba.core.config as it is imported, which a type checker cannot see
_ROOM = Path(__file__).parent
_DIGEST = hashlib.sha256(b"".join(file.read_bytes() for file in sorted(_ROOM.rglob("*.py")))).hexdigest()[:16]


def compiled(function: Function) -> Function:
    """Compile a function when it is first called, or take what was kept of the same sources.

    Numba looks at a function's own file only, and would go on using what it compiled before another file changed that
    the function calls into; so what is kept lies in a folder named by all files of the room. Where the room cannot
    be written, it was installed as a whole, and Numba's own place serves.

    No fast-math: the same numbers whatever the processor's vectors.
    """
    chosen = getattr(config, _KEPT_IN)  # NUMBA_CACHE_DIR
    base = Path(chosen) if chosen else _ROOM / "__pycache__" if os.access(_ROOM, os.W_OK) else None
    try:
        if base is not None:
            setattr(config, _KEPT_IN, str(base / f"compiled-{_DIGEST}"))
        return cast(Function, njit(cache=True, nogil=True, error_model="numpy")(function))
    finally:
        setattr(config, _KEPT_IN, chosen)
