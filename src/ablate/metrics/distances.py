"""Frechet and kernel distances between two sets of features; `intervals` computes their confidence intervals."""

import numpy as np

from ablate.metrics.kernel_sums import kernel_of_draw

LARGEST = 1e50  # of a feature: the kernel's cube of a square stays finite


def check_features(X: np.ndarray, Y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return features (n, d) and (m, d) as float64; raise ValueError as `frechet_distance` says."""
    X, Y = np.asarray(X, dtype=np.float64), np.asarray(Y, dtype=np.float64)
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
    mean_x, mean_y = X.mean(axis=0), Y.mean(axis=0)
    root_x, root_y = _covariance_root(X - mean_x), _covariance_root(Y - mean_y)
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
    return kernel_of_draw(X, Y, np.zeros(len(X), np.intp), np.zeros(len(Y), np.intp))(np.ones(1), np.ones(1))
