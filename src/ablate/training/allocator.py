"""Let the C library keep the memory that a training step frees, for the next step."""

from __future__ import annotations

import ctypes
import sys

# Parameters of mallopt(3) in glibc, and the largest values that it takes.
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_LARGEST_TRIM, _LARGEST_MMAP = 2**31 - 1, 32 * 2**20


def keep_freed_memory() -> None:
    """Take large blocks from the heap and never give its end back, for the rest of the process.

    A step frees and asks again for the same hundreds of megabytes. By default glibc returns them to the system and
    gets them back page by page, each one zeroed: a tenth of a step's time. Does nothing where the C library is
    another.
    """
    if sys.platform != "linux":
        return
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_MMAP_THRESHOLD, _LARGEST_MMAP)
        mallopt(_TRIM_THRESHOLD, _LARGEST_TRIM)
