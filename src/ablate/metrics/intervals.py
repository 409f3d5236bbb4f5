"""Bootstrap intervals of a distance between two sets of images, over whole groups of them such as probe sites."""

from collections.abc import Callable

import numpy as np

from ablate.metrics.distances import check_features, frechet_distance, kernel_distance
from ablate.metrics.kernel_sums import OfDraw, kernel_of_draw


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

    Resampling with replacement repeats samples, which biases both distances upwards, as small n does. The spread of
    the resampled values is therefore centred on the estimate. The interval is for the value expected at this n.

    Parameters
    ----------
    distance : callable
        `frechet_distance` or `kernel_distance`; a resample costs less than a call, as sums by group are kept.
    X, Y : (n, d) and (m, d) float
        Features.
    groups : (n,) int or str, optional
        Frame or probe site of each row, then n = m and row i of X and of Y belong together: whole groups are
        drawn, the same for both. Without it, rows of X and of Y are drawn independently.
    level : float
        Coverage.

    Raises
    ------
    ValueError
        As `distance`; when it is another function, or groups do not fit the rows or there are fewer than two.
    """
    X, Y = check_features(X, Y)
    rng = np.random.default_rng(seed)
    owner_x, owner_y = np.arange(len(X)), np.arange(len(Y))
    if groups is not None:
        groups = np.asarray(groups)
        if groups.shape != (len(X),) or len(X) != len(Y):
            raise ValueError(f"groups need one label a row of X and Y, got {groups.shape}, {len(X)}, {len(Y)}")
        owner_x = owner_y = np.unique(groups, return_inverse=True)[1]
        if owner_x.max() == 0:
            raise ValueError("groups must name at least 2 groups to resample")
    if distance is frechet_distance:
        of_draw = _frechet_of_draw(X, Y, owner_x, owner_y)
    elif distance is kernel_distance:
        of_draw = kernel_of_draw(X, Y, owner_x, owner_y)
    else:
        raise ValueError(f"no bootstrap of {distance}: allowed are frechet_distance and kernel_distance")
    size_x, size_y = int(owner_x.max()) + 1, int(owner_y.max()) + 1
    draws = np.empty(resamples)
    for i in range(resamples):
        times_x = _drawn(rng, size_x)
        draws[i] = of_draw(times_x, _drawn(rng, size_y) if groups is None else times_x)
    tail = (1.0 - level) / 2.0
    estimate = of_draw(np.ones(size_x, int), np.ones(size_y, int))
    lower, upper = np.quantile(draws, [tail, 1.0 - tail]) - draws.mean() + estimate
    return float(lower), float(upper)


def _drawn(rng: np.random.Generator, groups: int) -> np.ndarray:
    """(groups,) int: how often each is drawn, in as many draws with replacement."""
    return np.bincount(rng.integers(groups, size=groups), minlength=groups)


def _frechet_of_draw(X: np.ndarray, Y: np.ndarray, owner_x: np.ndarray, owner_y: np.ndarray) -> OfDraw:
    (rows_x, row_owner_x), (rows_y, row_owner_y) = _condensed(X, owner_x), _condensed(Y, owner_y)

    def value(times_x: np.ndarray, times_y: np.ndarray) -> float:
        mean_x, root_x = _mean_and_root(rows_x, times_x[row_owner_x])
        mean_y, root_y = _mean_and_root(rows_y, times_y[row_owner_y])
        product = root_x @ root_y.T
        # Half the digits of `frechet_distance`, in a sixth of its time: a spread needs no more.
        overlap = np.sqrt(np.maximum(np.linalg.eigvalsh(product @ product.T), 0.0)).sum()
        spread = np.square(root_x).sum() + np.square(root_y).sum() - 2.0 * overlap
        return float(np.square(mean_x - mean_y).sum() + spread)

    return value


def _condensed(X: np.ndarray, owner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows [1 | x] and their groups; of a group with more than d + 1 rows the triangle of a QR, of like moments."""
    rows, owners = [], []
    for group in range(int(owner.max()) + 1):
        members = X[owner == group]
        augmented = np.column_stack((np.ones(len(members)), members))
        if len(augmented) > augmented.shape[1]:
            augmented = np.asarray(np.linalg.qr(augmented, mode="r"))
        rows.append(augmented)
        owners.append(np.full(len(augmented), group))
    return np.concatenate(rows), np.concatenate(owners)


def _mean_and_root(rows: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and a root of the covariance of condensed rows, each taken some times."""
    taken = np.sqrt(times[times > 0])[:, None] * rows[times > 0]
    ones, features = taken[:, :1], taken[:, 1:]
    count = float(np.square(ones).sum())
    mean = (ones.T @ features)[0] / count
    centred = features - ones * mean
    if len(centred) > 4 * centred.shape[1]:  # one small product: several threads in a QR of this size only wait
        values, vectors = np.linalg.eigh(centred.T @ centred)
        centred = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
    return mean, centred / np.sqrt(max(count - 1.0, 1.0))
