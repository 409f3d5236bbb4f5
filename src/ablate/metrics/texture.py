"""Is texture right? Its roughness at every scale, the grid that up-sampling may leave, and what noise does to it."""

from itertools import combinations

import numpy as np
from scipy.fft import rfft2
from scipy.ndimage import convolve1d

from ablate.metrics.metric import Direction, Group, Metric, Pair, Pixels, Resimulation, Shown
from ablate.metrics.patches import as_patches, patches_inside

OCTAVES = 4
FEWEST_PIXELS = 100  # of tissue in a band
BINOMIAL = np.array([1, 4, 6, 4, 1], np.float32) / 16  # nearly a Gaussian of 1 px
ROUNDING = 1.0 / 12.0  # grey levels^2, of 8 bits; keeps flat images finite
BLOCK = 32  # px, of the spectra
LINES = ((0, BLOCK // 2), (BLOCK // 2, 0), (BLOCK // 2, BLOCK // 2))  # bins of a grid with a period of 2 px
RING_PX = 3  # how far around a spectral line its surround is taken


def octave_variances(image: np.ndarray, mask: np.ndarray) -> list[float]:
    """Variance of an image (H, W) in octave bands, grey levels^2, over the pixels of `mask`, (H, W) bool.

    A band is the image minus its average by the binomial window (1, 4, 6, 4, 1) / 16 along both axes, normalised
    within the mask. The next band is that of every second pixel of the average (Burt and Adelson 1983). There are at
    most four bands, of periods from 2 to some 30 px; bands with fewer than 100 pixels are left out.
    """
    values = image.astype(np.float32)
    inside = mask
    variances: list[float] = []
    for _ in range(OCTAVES):
        if np.count_nonzero(inside) < FEWEST_PIXELS:
            break
        average = _blurred(values * inside) / np.maximum(_blurred(inside.astype(np.float32)), np.float32(1e-6))
        variances.append(float((values - average)[inside].var(dtype=np.float64)))
        values = average[::2, ::2]
        inside = inside[::2, ::2]
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
    rendered = np.array(octave_variances(pair.prediction, tissue))
    right = np.array(octave_variances(pair.target, tissue))
    if not len(right):
        return None
    return float(np.abs(10.0 * np.log10((rendered + ROUNDING) / (right + ROUNDING))).mean())


OCTAVE_SD = Metric(
    name="octave_sd",
    label="Octave error",
    unit="dB",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.mechanism,
    decimals=2,
    of_image=octave_sd,
    place=90,
)


def _mean_spectrum(image: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """(BLOCK, BLOCK): mean power spectrum of the Hann-windowed blocks, grey levels^2."""
    window = np.outer(np.hanning(BLOCK), np.hanning(BLOCK)).astype(np.float32)
    cut = as_patches(image, BLOCK)[blocks].astype(np.float32).reshape(-1, BLOCK, BLOCK)
    cut -= cut.mean(axis=(1, 2), keepdims=True)
    spectrum = rfft2(cut * window)
    power = (spectrum.real**2 + spectrum.imag**2).mean(axis=0, dtype=np.float64)
    # Rounding to 8 bits has this power whatever the image; it keeps empty blocks finite.
    half = power / np.square(window).sum() + ROUNDING
    return np.hstack((half, np.roll(half[::-1, -2:0:-1], 1, axis=0)))  # P(-f) = P(f)


def line_power(image: np.ndarray, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power of an image (H, W) uint8 on the spectral lines of a grid, and around each, grey levels^2, (3,) float64.

    The power on a line is the mean of its bin and the 8 next to it, and that around it the median of the bins 2 and 3
    away. Both are of the mean spectrum of the `blocks`, (H // 32, W // 32) bool.
    """
    power = _mean_spectrum(image, blocks)
    offsets = np.arange(-RING_PX, RING_PX + 1)
    near = np.maximum(np.abs(offsets)[:, None], np.abs(offsets)[None, :])
    on = []
    around = []
    for row, column in LINES:
        here = power[np.ix_((row + offsets) % BLOCK, (column + offsets) % BLOCK)]
        on.append(here[near <= 1].mean())
        around.append(np.median(here[near > 1]))
    return np.array(on), np.array(around)


def nyquist_excess(pair: Pair) -> float | None:
    """Checkerboard of up-sampling: the power that lines of a grid add to the prediction, against the target's, dB.

    Strided transposed convolutions leave a pattern of period 2 px (Odena et al. 2016). What an image has on a line
    above its own surround is divided by the surround of the line in the target: e = 10 log10(1 + mean over lines of
    max(on - around, 0) / around in the target). The value is |e - e of the target|. So a smooth prediction, whose own
    surround is faint, is not punished for being smooth.

    In a study the pixels are those of the network's own grid, because scan conversion hides a pattern of beam space. It
    is at least 0, which is right, and None when no block of 32 px lies wholly inside the fan.
    """
    blocks = patches_inside(pair.mask, BLOCK)
    if not blocks.any():
        return None
    on_rendered, around_rendered = line_power(pair.prediction, blocks)
    on_target, around_target = line_power(pair.target, blocks)
    added_rendered = np.mean(np.maximum(on_rendered - around_rendered, 0.0) / around_target)
    added_target = np.mean(np.maximum(on_target - around_target, 0.0) / around_target)
    return float(abs(10.0 * np.log10((1.0 + added_rendered) / (1.0 + added_target))))


NYQUIST_EXCESS = Metric(
    name="nyquist_excess",
    label="Nyquist excess",
    unit="dB",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.mechanism,
    decimals=2,
    shown=Shown.screen,
    of_image=nyquist_excess,
    pixels=Pixels.network,
    place=80,
)


def noise_sd(pair: Pair) -> float | None:
    """How much an image varies between draws of its noise: root mean variance over pixels of tissue, grey levels.

    The draws are of the generator's noise or, of re-simulation, of scatterers. The value is None without draws or
    tissue.
    """
    if pair.draws is None or pair.tissue_mask is None or not pair.tissue_mask.any():
        return None
    values = pair.draws[:, pair.tissue_mask].astype(np.float64)
    return float(np.sqrt(values.var(axis=0, ddof=1).mean()))


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


CRPS = Metric(
    name="crps",
    label="CRPS",
    unit="grey levels",
    better=Direction.lower,
    resimulation=Resimulation.floor,
    group=Group.mechanism,
    decimals=2,
    shown=Shown.screen,
    of_draws=crps,
    place=100,
)
NOISE_SD = Metric(
    name="noise_sd",
    label="Noise sd",
    unit="grey levels",
    resimulation=Resimulation.level,
    group=Group.mechanism,
    decimals=1,
    shown=Shown.screen,
    of_draws=noise_sd,
    place=110,
)
