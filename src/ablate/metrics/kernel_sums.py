"""Sums of the cubic kernel (x.y / d + 1)^3 over all pairs of two sets of features, by group."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

_BLOCK = 2048  # rows at a time: bounds the memory


@dataclass(frozen=True, eq=False)
class KernelSums:
    """What the kernel distance needs, of all samples or of any choice of groups.

    Attributes
    ----------
    within_x : (g, g) float64
        Sum over all pairs of rows of X, one from each of two groups; a row is paired with itself too.
    within_y : (h, h) float64
        The same for Y.
    between : (g, h) float64
        The same for a row of X and one of Y.
    selves_x, selves_y : (g,) and (h,) float64
        Sum over the rows of each group of their kernel with themselves.
    sizes_x, sizes_y : (g,) and (h,) int
        Rows of each group.
    """

    within_x: np.ndarray
    within_y: np.ndarray
    between: np.ndarray
    selves_x: np.ndarray
    selves_y: np.ndarray
    sizes_x: np.ndarray
    sizes_y: np.ndarray

    def distance(self, times_x: np.ndarray, times_y: np.ndarray) -> float:
        """Unbiased squared MMD of groups taken `times_x` (g,) int and `times_y` (h,) int times."""
        n, m = float(times_x @ self.sizes_x), float(times_y @ self.sizes_y)
        mean_x = (times_x @ self.within_x @ times_x - times_x @ self.selves_x) / (n * (n - 1))
        mean_y = (times_y @ self.within_y @ times_y - times_y @ self.selves_y) / (m * (m - 1))
        return float(mean_x + mean_y - 2.0 * (times_x @ self.between @ times_y) / (n * m))


def kernel_sums(X: np.ndarray, Y: np.ndarray, groups_x: np.ndarray, groups_y: np.ndarray) -> KernelSums:
    """Sums by group: pair by pair, or, of many rows of few features, from sums of monomials.

    The kernel is the inner product of the monomials of its rows up to the third degree, so its sum over pairs is
    the inner product of their sums. Both ways give the same to rounding.

    Parameters
    ----------
    X, Y : (n, d) and (m, d) float64
        Features.
    groups_x, groups_y : (n,) and (m,) int
        Group of each row; every number from 0 on occurs.

    Returns
    -------
    KernelSums
    """
    d = X.shape[1]
    sizes_x, sizes_y = np.bincount(groups_x), np.bincount(groups_y)
    if d**2 * (len(X) + len(Y) + (len(sizes_x) + len(sizes_y)) ** 2) < len(X) * len(Y):
        sums_x, sums_y = _monomials(X, groups_x, len(sizes_x)), _monomials(Y, groups_y, len(sizes_y))
        within_x, within_y, between = sums_x @ sums_x.T, sums_y @ sums_y.T, sums_x @ sums_y.T
    else:
        within_x, within_y = _pairs(X, X, groups_x, groups_x), _pairs(Y, Y, groups_y, groups_y)
        between = _pairs(X, Y, groups_x, groups_y)
    selves_x, selves_y = (
        np.bincount(groups, (np.square(features).sum(axis=1) / d + 1.0) ** 3)
        for features, groups in ((X, groups_x), (Y, groups_y))
    )
    return KernelSums(within_x, within_y, between, selves_x, selves_y, sizes_x, sizes_y)


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
