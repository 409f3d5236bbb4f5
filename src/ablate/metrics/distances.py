"""Distances between two sets of features: Frechet, kernel, and how sure either is."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

LARGEST = 1e50  # of a feature: the kernel's cube of a square stays finite


def _checked(features: np.ndarray, name: str) -> np.ndarray:
    features = np.asarray(features, dtype=np.float64)
    if features.ndim != 2 or features.shape[1] == 0:
        raise ValueError(f"{name} must be (n, d) features with d > 0, got shape {features.shape}")
    if features.shape[0] < 2:
        raise ValueError(f"{name} needs at least 2 samples for a covariance, got {features.shape[0]}")
    if not np.isfinite(features).all():
        raise ValueError(f"{name} holds values that are not finite")
    if (np.abs(features) > LARGEST).any():
        raise ValueError(f"{name} holds values beyond {LARGEST:g}, of which the distance would overflow")
    return features


def _checked_pair(X: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    X, Y = _checked(X, "X"), _checked(Y, "Y")
    if X.shape[1] != Y.shape[1]:
        raise ValueError(f"X and Y must have one feature dimension, got {X.shape[1]} and {Y.shape[1]}")
    return X, Y


def _covariance_root(centred: np.ndarray) -> np.ndarray:
    """R, (min(n, d), d), with R^T R the covariance: the triangle of a QR, so nothing is squared."""
    return np.linalg.qr(centred, mode="r") / np.sqrt(centred.shape[0] - 1)


def frechet_distance(X: np.ndarray, Y: np.ndarray) -> float:
    """Squared Frechet distance between Gaussians fitted to two sets of features.

    |mu_x - mu_y|^2 + Tr(S_x + S_y - 2 (S_x S_y)^(1/2)) (Dowson and Landau 1982; Heusel et al. 2017). With
    S = R^T R from a QR of the centred features, Tr (S_x S_y)^(1/2) is the nuclear norm of R_x R_y^T. This
    needs no matrix root, never forms a covariance (whose squaring loses half the digits), is small when
    n < d, and gives 0 for identical sets to rounding.

    Parameters
    ----------
    X : (n, d) float
        Features of the first set, one sample a row.
    Y : (m, d) float
        Features of the second set.

    Returns
    -------
    float
        At least 0. Biased upwards at small n: compare only at equal n.

    Raises
    ------
    ValueError
        When a set has fewer than two samples, is not finite or beyond 1e50, or the dimensions differ.
    """
    X, Y = _checked_pair(X, Y)
    mean_x, mean_y = X.mean(axis=0), Y.mean(axis=0)
    root_x, root_y = _covariance_root(X - mean_x), _covariance_root(Y - mean_y)
    overlap = np.linalg.svd(root_x @ root_y.T, compute_uv=False).sum()
    spread = np.square(root_x).sum() + np.square(root_y).sum() - 2.0 * overlap
    return float(max(np.square(mean_x - mean_y).sum() + spread, 0.0))


def kernel_distance(X: np.ndarray, Y: np.ndarray) -> float:
    """Kernel distance (KID): unbiased squared MMD with the kernel (x.y / d + 1)^3.

    Binkowski et al. 2018. On all samples at once, so there are no random subsets.

    Parameters
    ----------
    X : (n, d) float
        Features of the first set.
    Y : (m, d) float
        Features of the second set.

    Returns
    -------
    float
        0 in expectation for independent samples of one distribution; slightly negative by chance, or when
        rows of X and Y show the same frames.

    Raises
    ------
    ValueError
        When a set has fewer than two samples, is not finite or beyond 1e50, or the dimensions differ.
    """
    X, Y = _checked_pair(X, Y)
    n, m, d = X.shape[0], Y.shape[0], X.shape[1]

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        return (a @ b.T / d + 1.0) ** 3

    within_x, within_y = kernel(X, X), kernel(Y, Y)
    mean_x = (within_x.sum() - np.trace(within_x)) / (n * (n - 1))
    mean_y = (within_y.sum() - np.trace(within_y)) / (m * (m - 1))
    return float(mean_x + mean_y - 2.0 * kernel(X, Y).mean())


def bootstrap_interval(
    distance: Callable[[np.ndarray, np.ndarray], float],
    X: np.ndarray,
    Y: np.ndarray,
    groups: np.ndarray | None = None,
    level: float = 0.95,
    resamples: int = 200,
    seed: int = 0,
) -> tuple[float, float]:
    """Bootstrap interval of a distance at this sample size.

    Resampling with replacement biases both distances upwards (repeated samples), as small n does. So the
    spread of the resampled values is taken and put around the estimate: the interval is for the value
    expected at this n, which is what two models evaluated on the same frames are compared by.

    Parameters
    ----------
    distance : callable
        `frechet_distance` or `kernel_distance`.
    X, Y : (n, d) and (m, d) float
        Features.
    groups : (n,) int or str, optional
        Frame or probe site of each row, then n = m and row i of X and of Y belong together: whole groups are
        drawn, the same for both. Without it, rows of X and of Y are drawn independently.
    level : float
        Coverage aimed at.
    resamples, seed : int
        Number of resamples, and of their random generator.

    Returns
    -------
    low, high : float

    Raises
    ------
    ValueError
        As `distance`; and when groups do not fit the rows or there are fewer than two.
    """
    X, Y = _checked_pair(X, Y)
    rng = np.random.default_rng(seed)
    members: list[np.ndarray] = []
    if groups is not None:
        groups = np.asarray(groups)
        if groups.shape != (len(X),) or len(X) != len(Y):
            raise ValueError(f"groups need one label a row of X and Y, got {groups.shape}, {len(X)}, {len(Y)}")
        members = [np.flatnonzero(groups == group) for group in np.unique(groups)]
        if len(members) < 2:
            raise ValueError("groups must name at least 2 groups to resample")

    def resampled() -> float:
        if not members:
            return distance(X[rng.integers(len(X), size=len(X))], Y[rng.integers(len(Y), size=len(Y))])
        rows = np.concatenate([members[k] for k in rng.integers(len(members), size=len(members))])
        return distance(X[rows], Y[rows])

    draws = np.array([resampled() for _ in range(resamples)])
    tail = (1.0 - level) / 2.0
    low, high = np.quantile(draws, [tail, 1.0 - tail]) - draws.mean() + distance(X, Y)
    return float(low), float(high)
