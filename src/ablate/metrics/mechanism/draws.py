"""Does noise make speckle? The spread of an image over draws of its noise, and how well the draws fit the target."""

from itertools import combinations

import numpy as np

from ablate.metrics.images import check_shapes
from ablate.metrics.metric import Direction, Group, Metric, Resimulation, Shown
from ablate.metrics.pair import Pair


def check_draws(draws: np.ndarray, mask: np.ndarray) -> None:
    """Raise ValueError unless `draws` are (k >= 2, H, W) with the shape of `mask`."""
    if draws.ndim != 3 or draws.shape[0] < 2 or draws.shape[1:] != mask.shape:
        raise ValueError(f"draws must be (k >= 2, {mask.shape[0]}, {mask.shape[1]}), got {draws.shape}")


def noise_sd(draws: np.ndarray, mask: np.ndarray) -> float | None:
    """How much an image varies between draws of its noise: root mean variance over pixels, grey levels.

    `draws`, (k, H, W) uint8, are one frame with k draws of noise or scatterers. Only pixels of `mask`, (H, W) bool,
    count, usually tissue; the value is None when there is none. Raises ValueError when there are fewer than two draws
    or the mask does not fit.
    """
    check_draws(draws, mask)
    if not mask.any():
        return None
    return float(np.sqrt(draws[:, mask].astype(np.float64).var(axis=0, ddof=1).mean()))


def crps(draws: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float | None:
    """Continuous ranked probability score of images with random speckle, mean over pixels, grey levels.

    CRPS = E|X - t| - E|X - X'| / 2, with two independent draws X and X' of a pixel and its target t (Gneiting and
    Raftery 2007, eq. 21). It is proper: its expectation is smallest if X has the distribution of t. The first draw
    estimates the first term, all pairs of draws the second, so that the estimate has no bias at any number of draws
    (Ferro 2014). A generator that draws no noise scores its mean absolute error.

    Parameters
    ----------
    draws : (k, H, W) uint8
        One frame with k >= 2 draws; the first is the image that the other metrics score. For re-simulation the second
        draw is the target: it is as independent of the first as a third simulation. The score is then half of the
        mean absolute error, as it must be for exchangeable images.
    target : (H, W) uint8
    mask : (H, W) bool
        Pixels that count, usually tissue.

    Returns
    -------
    float or None
        None when no pixel counts. Single frames can be slightly negative by chance.

    Raises
    ------
    ValueError
        When there are fewer than two draws or shapes do not fit.
    """
    check_draws(draws, mask)
    check_shapes(mask, target=target)
    if not mask.any():
        return None
    values = [draw[mask].astype(np.int16) for draw in draws]
    between = np.mean([np.abs(a - b).mean() for a, b in combinations(values, 2)])
    return float(np.abs(values[0] - target[mask]).mean() - between / 2)


def _crps(pair: Pair) -> float | None:
    return None if pair.draws is None or pair.tissue_mask is None else crps(pair.draws, pair.target, pair.tissue_mask)


def _noise_sd(pair: Pair) -> float | None:
    return None if pair.draws is None or pair.tissue_mask is None else noise_sd(pair.draws, pair.tissue_mask)


CRPS = Metric(
    *("crps", "CRPS", "grey levels", Direction.lower, Resimulation.floor, Group.mechanism, 2, Shown.drawn),
    of_draws=_crps,
    place=100,
)
NOISE_SD = Metric(
    *("noise_sd", "Noise sd", "grey levels", Direction.none, Resimulation.level, Group.mechanism, 1, Shown.drawn),
    of_draws=_noise_sd,
    place=110,
)
