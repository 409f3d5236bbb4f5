"""Is texture as rough as it should be, at every scale? The standard deviation of tissue in octave bands."""

import numpy as np
from scipy.ndimage import convolve1d

from ablate.metrics.metric import MECHANISM, Metric
from ablate.metrics.pair import Pair

OCTAVES = 4
FEWEST_PIXELS = 100  # of tissue in a band
BINOMIAL = np.array([1, 4, 6, 4, 1], np.float32) / 16  # nearly a Gaussian of 1 px
ROUNDING = 1.0 / 12.0  # grey levels^2, of 8 bits; keeps the bands of flat images finite


def octave_variances(image: np.ndarray, mask: np.ndarray) -> list[float]:
    """Variance of an image (H, W) in octave bands, grey levels^2, over the pixels of `mask`, (H, W) bool.

    A band is the image minus its average by the binomial window (1, 4, 6, 4, 1) / 16 along both axes, normalised
    within the mask. The next band is that of every second pixel of the average (Burt and Adelson 1983). There are at
    most four bands, of periods from 2 to some 30 px; bands with fewer than 100 pixels are left out.
    """
    values, inside = image.astype(np.float32), mask
    variances: list[float] = []
    for _ in range(OCTAVES):
        if np.count_nonzero(inside) < FEWEST_PIXELS:
            break
        average = _blurred(values * inside) / np.maximum(_blurred(inside.astype(np.float32)), np.float32(1e-6))
        variances.append(float((values - average)[inside].var(dtype=np.float64)))
        values, inside = average[::2, ::2], inside[::2, ::2]
    return variances


def _blurred(values: np.ndarray) -> np.ndarray:
    down = convolve1d(values, BINOMIAL, axis=0, mode="constant")
    return np.asarray(convolve1d(down, BINOMIAL, axis=1, mode="constant"))


def octave_sd(pair: Pair) -> float | None:
    """Error of the standard deviation in octave bands of tissue: mean over bands of |20 log10(sd / sd of the target)|.

    In dB, at least 0, which is right; None when fewer than 100 pixels of the fan are tissue.
    """
    if pair.tissue_mask is None:
        return None
    tissue = pair.tissue_mask & pair.mask
    rendered, right = (np.array(octave_variances(image, tissue)) for image in (pair.prediction, pair.target))
    if not len(right):
        return None
    return float(np.abs(10.0 * np.log10((rendered + ROUNDING) / (right + ROUNDING))).mean())


OCTAVE_SD = Metric("octave_sd", "Octave sd", "dB", *MECHANISM, 2, of_image=octave_sd, place=90)
