"""Directions as vectors."""

from collections.abc import Sequence

import numpy as np

Vector = Sequence[float] | np.ndarray


def unit(vectors: Vector) -> np.ndarray:
    """Vectors (..., 3) of the same directions and of length 1."""
    vectors = np.asarray(vectors, float)
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
