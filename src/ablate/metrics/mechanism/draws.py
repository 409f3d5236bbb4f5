"""Does noise make speckle? The spread of an image over draws of its noise, and how well the draws fit the target."""

from itertools import combinations

import numpy as np

from ablate.metrics.metric import MECHANISM, Direction, Group, Metric, Resimulation, Shown
from ablate.metrics.pair import Pair


def noise_sd(pair: Pair) -> float | None:
    """How much an image varies between draws of its noise: root mean variance over pixels of tissue, grey levels.

    The draws are of the generator's noise or, of re-simulation, of scatterers. The value is None without draws or
    tissue.
    """
    if pair.draws is None or pair.tissue_mask is None or not pair.tissue_mask.any():
        return None
    return float(np.sqrt(pair.draws[:, pair.tissue_mask].astype(np.float64).var(axis=0, ddof=1).mean()))


def crps(pair: Pair) -> float | None:
    """Continuous ranked probability score of images with random speckle, mean over pixels of tissue, grey levels.

    CRPS = E|X - t| - E|X - X'| / 2, with two independent draws X and X' of a pixel and its target t (Gneiting and
    Raftery 2007, eq. 21). It is proper: its expectation is smallest if X has the distribution of t. The first draw,
    which is the image that the other metrics score, estimates the first term, all pairs of draws the second, so that
    the estimate has no bias at any number of draws (Ferro 2014). A generator that draws no noise scores its mean
    absolute error. For re-simulation the second draw is the target: it is as independent of the first as a third
    simulation. The score is then half of the mean absolute error, as it must be for exchangeable images.

    The value is None without draws or tissue. Single frames can be slightly negative by chance.
    """
    if pair.draws is None or pair.tissue_mask is None or not pair.tissue_mask.any():
        return None
    values = [draw[pair.tissue_mask].astype(np.int16) for draw in pair.draws]
    between = np.mean([np.abs(a - b).mean() for a, b in combinations(values, 2)])
    return float(np.abs(values[0] - pair.target[pair.tissue_mask]).mean() - between / 2)


CRPS = Metric("crps", "CRPS", "grey levels", *MECHANISM, 2, Shown.drawn, of_draws=crps, place=100)
NOISE_SD = Metric(
    *("noise_sd", "Noise sd", "grey levels", Direction.none, Resimulation.level, Group.mechanism, 1, Shown.drawn),
    of_draws=noise_sd,
    place=110,
)
