"""What a work-precision table says: the order at which an error falls, and the points that no other one beats."""

import numpy as np


def observed_order(n: np.ndarray, error: np.ndarray, metric: str = "") -> tuple[float, float] | None:
    """Fit the order of error = c n^-order on logarithms by least squares; None with fewer than two n.

    Returns the order and its standard error, which is NaN with two points. n are rays, or anything else.
    `n`, (k,), are positive; points whose `error`, (k,), is not positive and finite are left out. Of the metric PSNR it
    is converted to the root-mean-square error, 255 x 10^(-PSNR / 20).
    """
    n, error = np.asarray(n, float), np.asarray(error, float)
    if metric.startswith("psnr"):
        error = 255 * 10 ** (-error / 20)
    usable = np.isfinite(error) & (error > 0)
    x, y = np.log(n[usable]), np.log(error[usable])
    if len(np.unique(x)) < 2:
        return None
    line, covariance = np.polyfit(x, y, 1, cov="unscaled")
    residual, free = y - np.polyval(line, x), len(x) - 2
    error_of_slope = float(np.sqrt(residual @ residual / free * covariance[0, 0])) if free else float("nan")
    return -float(line[0]), error_of_slope


def pareto_front(
    ms: np.ndarray, error: np.ndarray, lower: np.ndarray | None = None, upper: np.ndarray | None = None
) -> np.ndarray:
    """Find the points that no other point beats: with a smaller error in no more time, or equal in less.

    All are (n,) float. `lower` and `upper` are the spread of the times: another point takes no more time unless its
    lower bound is above this one's upper. Returns indices by increasing time, (k,) int; of equal points the first.
    """
    lower, upper = (ms if ends is None else np.where(np.isfinite(ends), ends, ms) for ends in (lower, upper))
    order = np.lexsort((error, ms))
    place = np.argsort(order)
    better = (error[None] < error[:, None]) & (lower[None] <= upper[:, None])
    earlier = (error[None] == error[:, None]) & (place[None] < place[:, None])
    return order[(np.isfinite(error) & ~(better | earlier).any(axis=1))[order]]
