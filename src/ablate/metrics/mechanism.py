"""Metrics of what each component is for: shadows, structure, checkerboards and the spread of noise."""

from functools import lru_cache

import numpy as np
from scipy.fft import fft, irfft2, next_fast_len, rfft2

from ablate.metrics.fidelity import check_pair
from ablate.metrics.patch_histograms import as_patches, patches_inside

SHADOW, ENHANCEMENT = 0.6, 1.4  # of the median attenuation at a depth
FEWEST_PIXELS = 100  # speckle of 22 grey levels then leaves 2 in a mean
SMOOTH_SIGMA_PX = 4.0
BLOCK = 32  # px, of the spectra
RING_PX = 3  # how far around a spectral line its background is taken


def relative_attenuation(
    attenuation: np.ndarray, mask: np.ndarray, depth_mm: np.ndarray, bin_mm: float = 1.0
) -> np.ndarray:
    """Attenuation map over its median in the fan at the same depth, (H, W) float32: under 1 in shadow.

    It is NaN outside the fan and where the median is 0. The arrays are those of `shadow_contrast`.
    """
    depth_bin = np.clip(depth_mm[mask] / bin_mm, 0, np.iinfo(np.uint16).max).astype(np.uint16)
    values = np.ascontiguousarray(attenuation[mask], dtype=np.float32)
    by_depth = np.split(values[np.argsort(depth_bin, kind="stable")], np.cumsum(np.bincount(depth_bin))[:-1])
    median = np.array([np.median(level) if level.size else np.nan for level in by_depth], dtype=np.float32)
    relative = np.full(attenuation.shape, np.nan, dtype=np.float32)
    at_pixel = median[depth_bin]
    relative[mask] = np.divide(values, at_pixel, out=np.full_like(values, np.nan), where=at_pixel > 0)
    return relative


def shadow_contrast(
    prediction: np.ndarray,
    target: np.ndarray,
    attenuation: np.ndarray,
    mask: np.ndarray,
    tissue_mask: np.ndarray,
    depth_mm: np.ndarray,
) -> float | None:
    """Mean error in shadow minus mean error in enhancement, in tissue; docs/metrics.md defines both.

    Parameters
    ----------
    prediction, target : (H, W) uint8
        Grey levels.
    attenuation : (H, W) float in [0, 1]
        The integral attenuation map.
    mask, tissue_mask : (H, W) bool
        The fan; pixels of tissue rather than fluid.
    depth_mm : (H, W) float, mm
        Distance from the probe's face along the scanline.

    Returns
    -------
    float or None
        Grey levels; 0 is right, positive means shadows too bright. None when either has fewer than 100 pixels.

    Raises
    ------
    ValueError
        When shapes or dtypes do not fit.
    """
    check_pair(prediction, target)
    for name, array in (("attenuation", attenuation), ("mask", mask), ("depth_mm", depth_mm)):
        if array.shape != target.shape:
            raise ValueError(f"{name} must be {target.shape}, got {array.shape}")
    inside = mask & tissue_mask
    relative = relative_attenuation(attenuation, mask, depth_mm)[inside]
    error = np.subtract(prediction, target, dtype=np.int16)[inside]
    shadow, enhanced = error[relative < SHADOW], error[relative > ENHANCEMENT]
    if min(shadow.size, enhanced.size) < FEWEST_PIXELS:
        return None
    return float(shadow.mean(dtype=np.float64) - enhanced.mean(dtype=np.float64))


@lru_cache(maxsize=4)
def _smoothed_mask(mask_bytes: bytes, shape: tuple[int, int]) -> np.ndarray:
    """The mask's own Gaussian average; it is kept because it is the same for all frames of a probe."""
    mask = np.frombuffer(mask_bytes, dtype=np.bool_).reshape(shape)
    return np.maximum(_smooth(mask.astype(np.float32)), np.finfo(np.float32).tiny)


def _smooth(image: np.ndarray) -> np.ndarray:
    """Gaussian cut off at 3 standard deviations, of an image that is 0 outside; by FFT, in half the time of taps."""
    height, width = image.shape
    shape, transfer = _gaussian_transfer(height, width)
    return np.asarray(irfft2(rfft2(image, shape) * transfer, shape)[:height, :width])


@lru_cache(maxsize=4)
def _gaussian_transfer(height: int, width: int) -> tuple[tuple[int, int], np.ndarray]:
    """Size of the FFT, with room for the Gaussian's reach, and its transfer function there."""
    reach = int(3.0 * SMOOTH_SIGMA_PX + 0.5)
    offsets = np.arange(-reach, reach + 1)
    taps = np.exp(-0.5 * (offsets / SMOOTH_SIGMA_PX) ** 2)
    rows, columns = (next_fast_len(length + reach, real=True) for length in (height, width))
    along_rows, along_columns = (fft(np.bincount(offsets % n, taps / taps.sum(), n)).real for n in (rows, columns))
    return (rows, columns), np.outer(along_rows, along_columns[: columns // 2 + 1]).astype(np.float32)


def mae_smooth(prediction: np.ndarray, target: np.ndarray, mask: np.ndarray) -> float:
    """MAE in grey levels inside the fan after a Gaussian, which averages speckle and keeps structure and level.

    The Gaussian of standard deviation 4 px is normalised inside the fan, so the black outside does not count. Images
    are (H, W) uint8 and `mask` is (H, W) bool. Raises ValueError when they do not fit, or the mask is empty.
    """
    check_pair(prediction, target, mask)
    difference = np.subtract(prediction, target, dtype=np.float32) * mask
    smooth = _smooth(difference) / _smoothed_mask(mask.tobytes(), mask.shape)
    return float(np.abs(smooth[mask]).mean(dtype=np.float64))


def _mean_spectrum(image: np.ndarray, blocks: np.ndarray) -> np.ndarray:
    """(BLOCK, BLOCK // 2 + 1): mean power spectrum of the Hann-windowed blocks, grey levels^2."""
    window = np.outer(np.hanning(BLOCK), np.hanning(BLOCK)).astype(np.float32)
    cut = as_patches(image, BLOCK)[blocks].astype(np.float32).reshape(-1, BLOCK, BLOCK)
    cut -= cut.mean(axis=(1, 2), keepdims=True)
    spectrum = rfft2(cut * window)
    power = (spectrum.real**2 + spectrum.imag**2).mean(axis=0, dtype=np.float64)
    # Rounding to 8 bits has this power whatever the image; it keeps empty blocks finite.
    return power / np.square(window).sum() + 1.0 / 12.0


def line_excess_db(image: np.ndarray, blocks: np.ndarray, period_px: int = 2) -> float:
    """Power on the spectral lines of a grid of `period_px` over the power around them in an image (H, W) uint8, dB.

    The mean is over the `blocks`, (H // 32, W // 32) bool, and over the lines: the multiples of 1 / period_px along
    both axes, without zero frequency.
    """
    half = _mean_spectrum(image, blocks)
    # The other half follows from symmetry: P(-f) = P(f).
    mirrored = np.roll(half[::-1, -2:0:-1], 1, axis=0)
    power = np.hstack((half, mirrored))
    lines = np.arange(0, BLOCK, BLOCK // period_px)
    offsets = np.arange(-RING_PX, RING_PX + 1)
    near = np.maximum(np.abs(offsets)[:, None], np.abs(offsets)[None, :])
    ratios = []
    for row in lines:
        for column in lines:
            if row or column:
                around = power[np.ix_((row + offsets) % BLOCK, (column + offsets) % BLOCK)]
                ratios.append(around[near <= 1].mean() / np.median(around[near > 1]))
    return float(10.0 * np.log10(np.mean(ratios)))


def nyquist_excess(prediction: np.ndarray, target: np.ndarray, mask: np.ndarray, period_px: int = 2) -> float | None:
    """Checkerboard of up-sampling: the prediction's excess at the Nyquist lines over the target's, dB.

    Strided transposed convolutions leave a pattern of period 2 px, and of 4 px from the level before (Odena et al.
    2016). The excess is the power over that of neighbouring frequencies in the same image.

    Parameters
    ----------
    prediction, target : (H, W) uint8
        Grey levels.
    mask : (H, W) bool
        The fan; only blocks of 32 px wholly inside count.
    period_px : {2, 4}
        Period of the pattern, px.

    Returns
    -------
    float or None
        dB; 0 is right. None when no block lies inside the fan.

    Raises
    ------
    ValueError
        When shapes or dtypes do not fit, or the period is another.
    """
    check_pair(prediction, target)
    if period_px not in (2, 4):
        raise ValueError(f"period_px must be 2 or 4, got {period_px}")
    blocks = patches_inside(mask, BLOCK)
    if not blocks.any():
        return None
    return line_excess_db(prediction, blocks, period_px) - line_excess_db(target, blocks, period_px)


def noise_sd(draws: np.ndarray, mask: np.ndarray) -> float | None:
    """How much an image varies between draws of its noise: root mean variance over pixels, grey levels.

    `draws`, (k, H, W) uint8, are one frame with k draws of noise or scatterers. Only pixels of `mask`, (H, W) bool,
    count, usually tissue; the value is None when there is none. Raises ValueError when there are fewer than two draws
    or the mask does not fit.
    """
    if draws.ndim != 3 or draws.shape[0] < 2 or draws.shape[1:] != mask.shape:
        raise ValueError(f"draws must be (k >= 2, {mask.shape[0]}, {mask.shape[1]}), got {draws.shape}")
    if not mask.any():
        return None
    return float(np.sqrt(draws[:, mask].astype(np.float64).var(axis=0, ddof=1).mean()))
