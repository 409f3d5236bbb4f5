"""Frechet and kernel distances between two sets of features, and their bootstrap intervals over probe sites."""

import math
from collections.abc import Callable

import numpy as np

LARGEST = 1e50  # of a feature: the kernel's cube of a square stays finite
_BLOCK = 2048  # rows at a time: bounds the memory

# (how often each group of rows is drawn, (g,) int) -> the distance of what is drawn
OfDraw = Callable[[np.ndarray], float]


def check_features(X: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return features (n, d) and (m, d) as float64; raise ValueError as `frechet_distance` says."""
    X = np.asarray(X, dtype=np.float64)
    Y = np.asarray(Y, dtype=np.float64)
    for name, features in (("X", X), ("Y", Y)):
        if features.ndim != 2 or features.shape[1] == 0:
            raise ValueError(f"{name} must be (n, d) features with d > 0, got shape {features.shape}")
        if features.shape[0] < 2:
            raise ValueError(f"{name} needs at least 2 samples for a covariance, got {features.shape[0]}")
        if not np.isfinite(features).all():
            raise ValueError(f"{name} holds values that are not finite")
        if (np.abs(features) > LARGEST).any():
            raise ValueError(f"{name} holds values beyond {LARGEST:g}, of which the distance would overflow")
    if X.shape[1] != Y.shape[1]:
        raise ValueError(f"X and Y must have one feature dimension, got {X.shape[1]} and {Y.shape[1]}")
    return X, Y


def frechet_distance(X: np.ndarray, Y: np.ndarray) -> float:
    """Squared Frechet distance between Gaussians fitted to two sets of features.

    |mu_x - mu_y|^2 + Tr(S_x + S_y - 2 (S_x S_y)^(1/2)) (Dowson and Landau 1982; Heusel et al. 2017). With
    S = R^T R from a QR of the centred features, Tr (S_x S_y)^(1/2) is the nuclear norm of R_x R_y^T. This
    needs no matrix root, never forms a covariance (whose squaring loses half the digits), is small when
    n < d, and gives 0 for identical sets to rounding.

    Parameters
    ----------
    X, Y : (n, d) and (m, d) float
        Features of the two sets, one sample a row.

    Returns
    -------
    float
        At least 0. Biased upwards at small n: compare only at equal n.

    Raises
    ------
    ValueError
        When a set has fewer than two samples, is not finite or beyond 1e50, or the dimensions differ.
    """
    X, Y = check_features(X, Y)
    mean_x = X.mean(axis=0)
    mean_y = Y.mean(axis=0)
    root_x = np.linalg.qr(X - mean_x, mode="r") / np.sqrt(len(X) - 1)
    root_y = np.linalg.qr(Y - mean_y, mode="r") / np.sqrt(len(Y) - 1)
    overlap = np.linalg.svd(root_x @ root_y.T, compute_uv=False).sum()
    spread = np.square(root_x).sum() + np.square(root_y).sum() - 2.0 * overlap
    return float(max(np.square(mean_x - mean_y).sum() + spread, 0.0))


def kernel_distance(X: np.ndarray, Y: np.ndarray) -> float:
    """Kernel distance (KID): unbiased squared MMD with the kernel (x.y / d + 1)^3.

    Binkowski et al. 2018, on all samples at once instead of random subsets. Arguments and errors are those of
    `frechet_distance`. The value is 0 in expectation for independent samples of one distribution. It can be slightly
    negative, by chance or when rows of X and Y show the same frames.
    """
    X, Y = check_features(X, Y)
    one_group_x = np.zeros(len(X), np.intp)
    one_group_y = np.zeros(len(Y), np.intp)
    return kernel_of_draw(X, Y, one_group_x, one_group_y)(np.ones(1))


def kernel_of_draw(X: np.ndarray, Y: np.ndarray, groups_x: np.ndarray, groups_y: np.ndarray) -> OfDraw:
    """Return the unbiased squared MMD as a function of how often each group is drawn.

    Kernels are summed pair by pair, or from sums of monomials when many rows have few features: the kernel is the inner
    product of the monomials of its rows up to the third degree. Both ways give the same to rounding. Inception has too
    many features for the second way, and a study of the paper's size too many patches of speckle for the first.

    Parameters
    ----------
    X, Y : (n, d) and (m, d) float64
        Features.
    groups_x, groups_y : (n,) and (m,) int
        The group of each row; every number from 0 on occurs.

    Returns
    -------
    callable
        How often each group is drawn, (g,) int -> float.
    """
    sizes_x = np.bincount(groups_x)
    sizes_y = np.bincount(groups_y)
    groups = len(sizes_x) + len(sizes_y)
    d = X.shape[1]
    if d**2 * (len(X) + len(Y) + groups**2) < len(X) * len(Y):
        sums_x = _monomial_sums(X, groups_x, len(sizes_x))
        sums_y = _monomial_sums(Y, groups_y, len(sizes_y))
        within_x = sums_x @ sums_x.T
        within_y = sums_y @ sums_y.T
        between = sums_x @ sums_y.T
    else:
        within_x = _kernel_sums(X, X, groups_x, groups_x)
        within_y = _kernel_sums(Y, Y, groups_y, groups_y)
        between = _kernel_sums(X, Y, groups_x, groups_y)
    selves_x = _self_kernel_sums(X, groups_x)
    selves_y = _self_kernel_sums(Y, groups_y)

    def distance(times: np.ndarray) -> float:
        n = float(times @ sizes_x)
        m = float(times @ sizes_y)
        mean_x = (times @ within_x @ times - times @ selves_x) / (n * (n - 1))
        mean_y = (times @ within_y @ times - times @ selves_y) / (m * (m - 1))
        return float(mean_x + mean_y - 2.0 * (times @ between @ times) / (n * m))

    return distance


def _self_kernel_sums(X: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """(g,): sums of the kernels of rows with themselves, which an unbiased mean leaves out."""
    kernels = (np.square(X).sum(axis=1) / X.shape[1] + 1.0) ** 3
    return np.bincount(groups, kernels)


def _kernel_sums(X: np.ndarray, Y: np.ndarray, groups_x: np.ndarray, groups_y: np.ndarray) -> np.ndarray:
    """(g, h): sums of the kernel over pairs of rows of X and Y."""
    order = np.argsort(groups_y, kind="stable")
    starts = np.searchsorted(groups_y[order], np.arange(groups_y.max() + 1))
    sums = np.zeros((groups_x.max() + 1, len(starts)))
    for start in range(0, len(X), _BLOCK):
        rows = slice(start, start + _BLOCK)
        kernels = (X[rows] @ Y[order].T / X.shape[1] + 1.0) ** 3
        np.add.at(sums, groups_x[rows], np.add.reduceat(kernels, starts, axis=1))
    return sums


def _monomial_sums(X: np.ndarray, groups: np.ndarray, count: int) -> np.ndarray:
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
            first = x.sum(axis=0) * np.sqrt(3.0 / d)
            second = squares.sum(axis=0) * (np.sqrt(3.0) / d)
            third = (squares.T @ x).ravel() / d**1.5
            sums[group] += np.hstack((float(len(x)), first, second, third))
    return sums


def bootstrap_interval(
    distance: Callable[[np.ndarray, np.ndarray], float],
    X: np.ndarray,
    Y: np.ndarray,
    groups: np.ndarray,
    resamples: int = 200,
) -> tuple[float, float]:
    """Bootstrap interval of a distance at this sample size, with a coverage of 95 %.

    Resampling with replacement repeats samples, which biases both distances upwards, as small n does. The spread of
    the resampled values is therefore centred on the estimate. The interval is for the value expected at this n.

    Parameters
    ----------
    distance : callable
        Of two sets of features. A resample for `frechet_distance` or `kernel_distance` costs less than a call, as sums
        by group are kept.
    X, Y : (n, d) float
        Features.
    groups : (n,) int or str
        Frame or probe site of each row; row i of X and of Y belong together. Whole groups are drawn, the same for both.
    resamples : int
        How often groups are drawn.

    Returns
    -------
    (float, float)
        Its ends; infinite where there is one group alone.

    Raises
    ------
    ValueError
        As `frechet_distance` does.
    """
    X, Y = check_features(X, Y)
    group_of_row = np.unique(groups, return_inverse=True)[1]
    count = int(group_of_row.max()) + 1
    if count < 2:
        return -math.inf, math.inf
    distance_of_draw = _of_draw(distance, X, Y, group_of_row)
    rng = np.random.default_rng(0)
    draws = [distance_of_draw(np.bincount(rng.integers(count, size=count), minlength=count)) for _ in range(resamples)]
    tail = (1.0 - 0.95) / 2.0
    estimate = distance_of_draw(np.ones(count, int))
    lower, upper = np.quantile(draws, [tail, 1.0 - tail]) - np.mean(draws) + estimate
    return float(lower), float(upper)


def _of_draw(
    distance: Callable[[np.ndarray, np.ndarray], float], X: np.ndarray, Y: np.ndarray, groups: np.ndarray
) -> OfDraw:
    """A distance as a function of how often each group of rows is drawn."""
    if distance is frechet_distance:
        return frechet_of_draw(X, Y, groups)
    if distance is kernel_distance:
        return kernel_of_draw(X, Y, groups, groups)

    def of_rows_drawn(times: np.ndarray) -> float:
        drawn_x = np.repeat(X, times[groups], axis=0)
        drawn_y = np.repeat(Y, times[groups], axis=0)
        return distance(drawn_x, drawn_y)

    return of_rows_drawn


def frechet_of_draw(X: np.ndarray, Y: np.ndarray, groups: np.ndarray) -> OfDraw:
    """Return the Frechet distance as a function of how often each group is drawn, (g,) int.

    X and Y are (n, d) float64, and `groups`, (n,) int, is that of each row of either; every number from 0 on occurs.
    """
    rows_x, group_of_row = _condensed(X, groups)
    rows_y, _ = _condensed(Y, groups)

    def value(times: np.ndarray) -> float:
        mean_x, root_x = _mean_and_root(rows_x, times[group_of_row])
        mean_y, root_y = _mean_and_root(rows_y, times[group_of_row])
        product = root_x @ root_y.T
        # Half the digits of `frechet_distance`, in a sixth of its time: a spread needs no more.
        overlap = np.sqrt(np.maximum(np.linalg.eigvalsh(product @ product.T), 0.0)).sum()
        spread = np.square(root_x).sum() + np.square(root_y).sum() - 2.0 * overlap
        return float(np.square(mean_x - mean_y).sum() + spread)

    return value


def _condensed(X: np.ndarray, groups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows [1 | x] and their groups; of a group with more than d + 1 rows the triangle of a QR, of like moments."""
    rows = []
    group_of_row = []
    for group in range(int(groups.max()) + 1):
        members = X[groups == group]
        augmented = np.column_stack((np.ones(len(members)), members))
        if len(augmented) > augmented.shape[1]:
            augmented = np.asarray(np.linalg.qr(augmented, mode="r"))
        rows.append(augmented)
        group_of_row.append(np.full(len(augmented), group))
    return np.concatenate(rows), np.concatenate(group_of_row)


def _mean_and_root(rows: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and a root of the covariance of condensed rows, each taken some times."""
    taken = np.sqrt(times[times > 0])[:, None] * rows[times > 0]
    ones = taken[:, :1]
    features = taken[:, 1:]
    count = float(np.square(ones).sum())
    mean = (ones.T @ features)[0] / count
    centred = features - ones * mean
    if len(centred) > 4 * centred.shape[1]:  # one small product: several threads in a QR of this size only wait
        values, vectors = np.linalg.eigh(centred.T @ centred)
        centred = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return mean, centred / np.sqrt(max(count - 1.0, 1.0))
