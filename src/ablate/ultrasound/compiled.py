"""How functions of this room are compiled: once, kept on disk, without Python's lock, dividing as NumPy does."""

from __future__ import annotations

from numba import njit

#: No fast-math: the same numbers whatever the processor's vectors.
compiled = njit(cache=True, nogil=True, error_model="numpy")
