"""Sums of the cubic kernel (x.y / d + 1)^3 over all pairs of two sets of features, by group."""

from collections.abc import Callable

import numpy as np

_BLOCK = 2048  # rows at a time: bounds the memory

# (how often each group of X is drawn, (g,) int; the same for Y, (h,) int) -> the distance of what is drawn
OfDraw = Callable[[np.ndarray, np.ndarray], float]


def kernel_of_draw(X: np.ndarray, Y: np.ndarray, groups_x: np.ndarray, groups_y: np.ndarray) -> OfDraw:
    """Return the unbiased squared MMD as a function of how often each group is drawn.

    `groups_x`, (n,) int, has the group of each row of `X`, (n, d) float64; every number from 0 on occurs. Kernels are
    summed pair by pair, or from sums of monomials when many rows have few features: the kernel is the inner product of
    the monomials of its rows up to the third degree. Both ways give the same to rounding.
    """
    d = X.shape[1]
    sizes_x, sizes_y = np.bincount(groups_x), np.bincount(groups_y)
    if d**2 * (len(X) + len(Y) + (len(sizes_x) + len(sizes_y)) ** 2) < len(X) * len(Y):
        sums_x, sums_y = _monomials(X, groups_x, len(sizes_x)), _monomials(Y, groups_y, len(sizes_y))
        within_x, within_y, between = sums_x @ sums_x.T, sums_y @ sums_y.T, sums_x @ sums_y.T
    else:
        within_x, within_y = _pairs(X, X, groups_x, groups_x), _pairs(Y, Y, groups_y, groups_y)
        between = _pairs(X, Y, groups_x, groups_y)
    # Kernels of rows with themselves, which an unbiased mean leaves out.
    selves_x, selves_y = (
        np.bincount(groups, (np.square(features).sum(axis=1) / d + 1.0) ** 3)
        for features, groups in ((X, groups_x), (Y, groups_y))
    )

    def distance(times_x: np.ndarray, times_y: np.ndarray) -> float:
        n, m = float(times_x @ sizes_x), float(times_y @ sizes_y)
        mean_x = (times_x @ within_x @ times_x - times_x @ selves_x) / (n * (n - 1))
        mean_y = (times_y @ within_y @ times_y - times_y @ selves_y) / (m * (m - 1))
        return float(mean_x + mean_y - 2.0 * (times_x @ between @ times_y) / (n * m))

    return distance


def _pairs(X: np.ndarray, Y: np.ndarray, groups_x: np.ndarray, groups_y: np.ndarray) -> np.ndarray:
    """(g, h): sums of the kernel over pairs of rows of X and Y."""
    order = np.argsort(groups_y, kind="stable")
    starts = np.searchsorted(groups_y[order], np.arange(groups_y.max() + 1))
    sums = np.zeros((groups_x.max() + 1, len(starts)))
    for start in range(0, len(X), _BLOCK):
        rows = slice(start, start + _BLOCK)
        kernels = (X[rows] @ Y[order].T / X.shape[1] + 1.0) ** 3
        np.add.at(sums, groups_x[rows], np.add.reduceat(kernels, starts, axis=1))
    return sums


def _monomials(X: np.ndarray, groups: np.ndarray, count: int) -> np.ndarray:
    """(count, ...): sums of 1, x_i, x_i x_j (i <= j) and x_i x_j x_k over each group, scaled to give the kernel."""
    d = X.shape[1]
    i, j = np.triu_indices(d)
    twice = np.where(i == j, 1.0, np.sqrt(2.0))
    sums = np.zeros((count, 1 + d + len(i) * (1 + d)))
    for group in range(count):
        members = X[groups == group]
        for start in range(0, len(members), _BLOCK):
            x = members[start : start + _BLOCK]
            squares = x[:, i] * x[:, j] * twice
            first, second = x.sum(axis=0) * np.sqrt(3.0 / d), squares.sum(axis=0) * (np.sqrt(3.0) / d)
            sums[group] += np.hstack((float(len(x)), first, second, (squares.T @ x).ravel() / d**1.5))
    return sums
