"""Polygons and strips of any number of corners, as triangles."""

import numpy as np


def triangles_of_polygons(corners: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Triangles (k, 3) of polygons, cut as fans.

    `corners` (n,) holds the vertices of all polygons, one polygon after the other, and `lengths` (m,) how many each of
    them has. One with fewer than three is a point or a line, of which nothing is left.
    """
    counts = np.maximum(lengths - 2, 0)
    first = np.repeat(np.cumsum(lengths) - lengths, counts)
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    return corners[np.stack([first, first + step + 1, first + step + 2], axis=1)].astype(np.int64)


def triangles_of_strip(corners: np.ndarray) -> np.ndarray:
    """Triangles (k, 3) of a strip (n,), in which -1 begins another strip."""
    triples = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    return triples[(triples != -1).all(axis=1)].astype(np.int64)
