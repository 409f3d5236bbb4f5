"""Does up-sampling leave a grid? Power at its spatial frequencies, which speckle does not have."""

import numpy as np
from scipy.fft import rfft2

from ablate.metrics.metric import MECHANISM, Metric, Shown
from ablate.metrics.pair import Pair
from ablate.metrics.patches import as_patches, patches_inside

BLOCK = 32  # px, of the spectra
LINES = ((0, BLOCK // 2), (BLOCK // 2, 0), (BLOCK // 2, BLOCK // 2))  # bins of a grid with a period of 2 px
RING_PX = 3  # how far around a spectral line its surround is taken


def _mean_spectrum(image: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """(BLOCK, BLOCK): mean power spectrum of the Hann-windowed blocks, grey levels^2."""
    window = np.outer(np.hanning(BLOCK), np.hanning(BLOCK)).astype(np.float32)
    cut = as_patches(image, BLOCK)[blocks].astype(np.float32).reshape(-1, BLOCK, BLOCK)
    cut -= cut.mean(axis=(1, 2), keepdims=True)
    spectrum = rfft2(cut * window)
    power = (spectrum.real**2 + spectrum.imag**2).mean(axis=0, dtype=np.float64)
    # Rounding to 8 bits has this power whatever the image; it keeps empty blocks finite.
    half = power / np.square(window).sum() + 1.0 / 12.0
    return np.hstack((half, np.roll(half[::-1, -2:0:-1], 1, axis=0)))  # P(-f) = P(f)


def line_power(image: np.ndarray, blocks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Power of an image (H, W) uint8 on the spectral lines of a grid, and around each, grey levels^2, (3,) float64.

    The power on a line is the
    mean of its bin and the 8 next to it, and that around it the median of the bins 2 and 3 away. Both are of the mean
    spectrum of the `blocks`, (H // 32, W // 32) bool.
    """
    power = _mean_spectrum(image, blocks)
    offsets = np.arange(-RING_PX, RING_PX + 1)
    near = np.maximum(np.abs(offsets)[:, None], np.abs(offsets)[None, :])
    on, around = [], []
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

    It is at least 0, which is right, and None when no block of 32 px lies wholly inside the fan.
    """
    blocks = patches_inside(pair.mask, BLOCK)
    if not blocks.any():
        return None
    rendered, right = (line_power(image, blocks) for image in (pair.prediction, pair.target))
    added = [np.mean(np.maximum(on - around, 0.0) / right[1]) for on, around in (rendered, right)]
    return float(abs(10.0 * np.log10((1.0 + added[0]) / (1.0 + added[1]))))


NYQUIST_EXCESS = Metric(
    "nyquist_excess", "Nyquist excess", "dB", *MECHANISM, 2, Shown.drawn, of_image=nyquist_excess, place=80
)
