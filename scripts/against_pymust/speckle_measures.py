"""Measures of speckle and of round lesions on a polar envelope, (samples, lines), from whatever simulator."""

import numpy as np
from scipy import optimize, signal, special, stats

_RAYLEIGH_SNR = float(np.sqrt(np.pi / (4 - np.pi)))


def level(envelope: np.ndarray, depths_mm: np.ndarray, angles_rad: np.ndarray, where: np.ndarray) -> np.ndarray:
    """The envelope over its slowly varying root mean square, so that uniform tissue has unit mean power everywhere.

    A quadratic in depth and angle is fitted to the log envelope.

    Parameters
    ----------
    envelope : (samples, lines) float
    depths_mm : (samples,) float
    angles_rad : (lines,) float
    where : (samples, lines) bool
        Uniform tissue.

    Returns
    -------
    (samples, lines) float64
    """
    d = 2 * (depths_mm - depths_mm.mean()) / np.ptp(depths_mm)
    a = 2 * angles_rad / np.ptp(angles_rad)
    d, a = np.broadcast_arrays(d[:, None], a)
    terms = np.stack([np.ones_like(d), d, a, d * d, d * a, a * a], axis=-1)
    fit = np.linalg.lstsq(terms[where], np.log(envelope[where]), rcond=None)[0]
    flat = envelope / np.exp(terms @ fit)
    return flat / np.sqrt((flat[where] ** 2).mean())


def mean_over_sd(values: np.ndarray) -> float:
    """Mean over standard deviation; sqrt(pi / (4 - pi)) = 1.913 in fully developed speckle."""
    return float(values.mean() / values.std())


def rayleigh_distance(values: np.ndarray) -> float:
    """Kolmogorov-Smirnov distance to the Rayleigh distribution of the same mean power."""
    return float(stats.kstest(values.ravel(), stats.rayleigh(scale=np.sqrt((values**2).mean() / 2)).cdf).statistic)


def cell_size(envelope: np.ndarray, axis: int) -> float:
    """Full width at half maximum of the autocovariance of the envelope along one axis, samples."""
    deviation = np.moveaxis(envelope - envelope.mean(), axis, 0)
    n = len(deviation)
    power = (np.abs(np.fft.rfft(deviation, 2 * n, axis=0)) ** 2).mean(axis=1)
    return 2 * half_width(np.fft.irfft(power)[:n] / np.arange(n, 0, -1))


def half_width(profile: np.ndarray) -> float:
    """Where a profile falls to half of its first value, by linear interpolation, samples."""
    values = profile / profile[0]
    below = int(np.argmax(values < 0.5))
    if below == 0:
        raise ValueError("the profile does not fall to half of its first value")
    return float(below - 1 + (values[below - 1] - 0.5) / (values[below - 1] - values[below]))


def contrast_db(inside: np.ndarray, outside: np.ndarray) -> float:
    """Mean power inside over mean power outside, dB."""
    return float(10 * np.log10((inside**2).mean() / (outside**2).mean()))


def radial_profile(power: np.ndarray, radius_mm: np.ndarray, edges_mm: np.ndarray) -> np.ndarray:
    """Mean power within rings."""
    ring = np.digitize(radius_mm.ravel(), edges_mm)
    count = np.bincount(ring, minlength=len(edges_mm) + 1)[1:-1]
    return np.bincount(ring, power.ravel(), minlength=len(edges_mm) + 1)[1:-1] / count


def lesion_diameter(profile: np.ndarray, edges_mm: np.ndarray, guess_mm: float) -> float:
    """Diameter at which a radial profile of mean power is half way from its inside to its outside value, mm.

    The profile is fitted with a blurred step, in - (in - out) Phi((r - radius) / s); the error of a ring's power goes
    with the power itself, but not below a tenth of the largest, and with one over the root of its area.
    """
    r = (edges_mm[:-1] + edges_mm[1:]) / 2

    def step(r: np.ndarray, inside: float, outside: float, radius: float, s: float) -> np.ndarray:
        return inside + (outside - inside) * special.ndtr((r - radius) / s)

    guess = profile[0], profile[-1], guess_mm / 2, edges_mm[-1] - edges_mm[-2]
    error = np.maximum(profile, 0.1 * profile.max()) / np.sqrt(r)
    fit, _ = optimize.curve_fit(step, r, profile, guess, sigma=error, bounds=([0, 0, 0, 0.05], np.inf))
    return float(2 * fit[2])


def scatterers_per_cell(power: np.ndarray, pixel_mm2: float, per_mm2: float) -> float:
    """Scatterers that share in one sample, from the image of a point: density x (sum of power)^2 / sum of power^2."""
    return float(per_mm2 * pixel_mm2 * power.sum() ** 2 / (power**2).sum())


def expected_mean_over_sd(per_cell: float) -> float:
    """`mean_over_sd` for so many equal scatterers a cell, by the K distribution with that kurtosis.

    n equal scatterers at random places give a power of variance 1 + 1/n over its squared mean, a K distribution of
    shape a one of 1 + 2/a (Jakeman and Pusey 1976, doi:10.1109/TAP.1976.1141451).
    """
    if np.isinf(per_cell):
        return _RAYLEIGH_SNR
    shape = 2 * per_cell
    growth = shape * np.exp(2 * (special.gammaln(shape) - special.gammaln(shape + 0.5)))
    return float(1 / np.sqrt(4 / np.pi * growth - 1))


def expected_cell(point: np.ndarray) -> tuple[float, float]:
    """`cell_size` along both axes from the complex image of a point, samples.

    With r the modulus of the image's autocorrelation, the envelope's autocovariance goes with 2F1(-1/2, -1/2; 1; r^2)
    - 1 (Wagner et al. 1987, doi:10.1364/JOSAA.4.000910).
    """
    spectrum = np.fft.fft2(point, [2 * n for n in point.shape])
    r = np.abs(np.fft.ifft2(np.abs(spectrum) ** 2))
    covariance = special.hyp2f1(-0.5, -0.5, 1, np.minimum(r / r[0, 0], 1) ** 2) - 1
    return 2 * half_width(covariance[: len(point), 0]), 2 * half_width(covariance[0, : point.shape[1]])


def expected_contrast_db(power: np.ndarray, point: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> float:
    """`contrast_db` of independent scatterers: their power blurred by the power of a point's image.

    Parameters
    ----------
    power : (samples, lines) float
        Of the scatterers.
    point : (samples, lines) float
        Power of the image of one point; taken as the same everywhere, in samples and lines.
    inside, outside : (samples, lines) bool
    """
    row, column = np.unravel_index(point.argmax(), point.shape)
    cut = tuple(slice(at, at + n) for at, n in zip((row, column), point.shape, strict=True))
    seen, all_of_it = (signal.fftconvolve(field, point)[cut] for field in (power, np.ones_like(power)))
    image = np.maximum(seen / all_of_it, 1e-15)  # the noise of a Fourier transform
    return float(10 * np.log10(image[inside].mean() / image[outside].mean()))
