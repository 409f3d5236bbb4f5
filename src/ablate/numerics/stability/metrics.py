"""Scores of constant, identical and too small images, and of features that are too few, too large or too similar."""

import math
from collections.abc import Iterator
from functools import partial
from itertools import product

import numpy as np
from scipy.linalg import eigvals
from scipy.ndimage import gaussian_filter

from ablate import metrics
from ablate.metrics.features import GRADIENT_UNIT
from ablate.numerics.stability.checks import FLOAT32, FLOAT64, Case, Check, finite, none, off, refused
from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm

SHAPE = (200, 277)
FAN = fan_mask(ConvexProbe(), SHAPE)
DEPTH_MM = pixel_polar(ConvexProbe(), SHAPE)[0]
PIXEL_MM = pixel_size_mm(ConvexProbe(), SHAPE)
BONE = FAN & (np.indices(SHAPE) // 5 % 6 == 0).all(axis=0)  # squares of 4 mm and more
FFT_ERROR = 255 * 64 * FLOAT32
DISTANCES = metrics.frechet_distance, metrics.kernel_distance


def _grey(level: int) -> np.ndarray:
    return np.full(SHAPE, level, np.uint8)


def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, SHAPE).astype(np.uint8)


def _scores(a: np.ndarray, b: np.ndarray, mask: np.ndarray = FAN) -> dict[str, float]:
    """Compute all metrics of a pair, with shadow at the left, enhancement at the right, and bone."""
    attenuation = np.repeat([0.2, 1.0, 2.0], (80, 117, 80)).astype(np.float32) / 2 * np.ones(SHAPE, np.float32)
    labels, draws = np.ones(SHAPE, np.uint8), np.stack([a, b])
    depth_mm = np.maximum(DEPTH_MM, 0)
    pair = metrics.Pair(a, b, mask, mask, attenuation, depth_mm, labels, BONE, PIXEL_MM, draws)
    return metrics.evaluate_image(pair)


def _against(label: str, found: dict[str, float], right: dict[str, float]) -> Iterator[Check]:
    """Compare each score with its exact value; a score that is missing, or not listed, is an error."""
    yield Check("uint8", f"{label}: scores missing", len(right.keys() ^ found.keys()), 0, "Each has a value here.")
    for name, value in right.items():
        if name not in found:
            continue
        wrong = 0.0 if found[name] == value else abs(found[name] - value)
        quantity = f"{label}: {name} against {value:g}"
        if name in ("mae_smooth", "nyquist_excess", "octave_sd"):
            yield Check("float32", quantity, wrong, FFT_ERROR, "Float32 sums with some ten factors each.")
        else:
            yield Check("uint8", quantity, wrong, 16 * FLOAT64 * 255, "Sums of whole numbers and one division.")


def _black_and_white(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Black against white images, and each image against itself."""
    of_pair = [name for name, metric in metrics.METRICS.items() if metric.of_image or metric.of_draws]
    same = {name: math.inf if name in ("psnr", "psnr_fan") else 0.0 for name in of_pair}
    yield from _against("black, black", _scores(_grey(0), _grey(0)), same)
    yield from _against("white, white", _scores(_grey(255), _grey(255)), same)
    yield from _against("noise, itself", _scores(_noise(0), _noise(0)), same)
    apart = {"psnr": 0.0, "psnr_fan": 0.0, "mae": 255.0, "mae_fan": 255.0, "mae_smooth": 255.0, "pchi2": 1.0}
    apart |= {"pchi2_fan": 1.0, "pchi2_tissue": 1.0, "shadow_contrast": 0.0, "nyquist_excess": 0.0}
    apart |= {"thin_contrast": 0.0, "octave_sd": 0.0, "crps": 127.5, "noise_sd": 255 / math.sqrt(2)}
    yield from _against("black, white", _scores(_grey(0), _grey(255)), apart)


def _in_double(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Metrics that are computed in float32, against float64, on images of noise."""
    a, b = _noise(1), _noise(2)
    difference = (a.astype(float) - b) * FAN
    sigma = [1.5 / size for size in PIXEL_MM]
    smooth, weight = (gaussian_filter(x, sigma, mode="constant", truncate=3.0) for x in (difference, FAN.astype(float)))
    right = float(np.abs(smooth[FAN] / weight[FAN]).mean())
    error = abs(metrics.mae_smooth(a, b, FAN, PIXEL_MM) - right)
    why = "Sums of values up to 255 by an FFT with some ten factors."
    yield Check("float32", "mae_smooth against float64, grey levels", error, FFT_ERROR, why)
    images = np.stack([_noise(k) for k in range(4)])
    right = float(np.sqrt(images[:, FAN].astype(np.longdouble).var(axis=0, ddof=1).mean()))
    found = metrics.noise_sd(images, FAN)
    assert found is not None
    error = abs(found / right - 1)
    yield Check("float64", "noise_sd against long doubles, relative", error, 64 * FLOAT64, "There are few roundings.")


def _shadows(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Attenuation maps that are 0, -0 and the smallest float32 everywhere."""
    tiny = float(np.finfo(np.float32).tiny)
    for label, value in (("0", 0.0), ("the smallest float32", tiny), ("-0", -0.0)):
        attenuation = np.full(SHAPE, value, np.float32)
        found = metrics.shadow_contrast(_noise(1), _noise(2), attenuation, FAN, FAN.astype(np.uint8), DEPTH_MM)
        yield none("float32", f"A is {label}: shadows found", found is not None, "A is constant at every depth.")


def _empty(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Empty masks and histograms, images smaller than a patch, and a fan of one pixel."""
    nowhere, one = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    one[100, 138] = True
    black, white = _grey(0), _grey(255)
    masked = [partial(score, black, white, nowhere) for score in (metrics.psnr, metrics.mae, metrics.mae_smooth)]
    features = partial(metrics.speckle_features, black[None], nowhere)
    yield refused("uint8", *masked, partial(metrics.psnr, black[:0], white[:0]), features)
    more = len(_scores(black, white, nowhere).keys() - {"psnr", "mae", "pchi2"})
    yield Check("uint8", "no fan: scores besides those of the whole image", more, 0, "Other scores need a fan.")
    for bins in (1, 50, 256):  # all but one are empty in both images: 0 / 0
        error = off(metrics.patch_chi2(black, white, bins=bins), float(bins > 1))
        yield Check("uint8", f"{bins} bins: chi-square against its value", error, 0, "0 / 0 counts as 0.")
    small = metrics.rms(metrics.patch_chi2(black[:19, :19], white[:19, :19]))
    yield none("uint8", "smaller than a patch: scores", small is not None, "There is no patch.")
    outside = metrics.rms(metrics.patch_chi2(black, white), metrics.patches_inside(nowhere))
    yield none("uint8", "no patch in the fan: scores", outside is not None, "There is no patch.")
    spread = metrics.noise_sd(np.stack([black, white]), nowhere)
    yield none("uint8", "no tissue: spreads", spread is not None, "There is no pixel.")
    error = abs(metrics.mae_smooth(black, white, one) - 255)
    why = "The sum is divided by the peak of the Gaussian, 1/100."
    yield Check("float32", "a fan of one pixel: mae_smooth against 255", error, FFT_ERROR * 2 * math.pi * 16, why)


def _large(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Images of 25 million pixels, black against white: the sum of squares is 1.6e12."""
    black, white = np.zeros((5000, 5000), np.uint8), np.full((5000, 5000), 255, np.uint8)
    error = abs(metrics.psnr(black, white))
    yield Check("uint8", "psnr against 0 dB", error, 0, "Sums of squares are 64-bit integers.")
    yield Check("uint8", "mae against 255", abs(metrics.mae(black, white) - 255), 0, "Sums are 64-bit integers.")


def _frechet(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Fewer samples than features, two samples, one sample, and samples that are all the same."""
    random = np.random.default_rng(0)
    one = random.normal(size=(1, 8))
    yield refused("float64", *(partial(distance, one, one) for distance in DISTANCES))
    for n, d in ((5, 20), (2, 20), (40, 4)):
        x, y = random.normal(size=(n, d)), 1.5 * random.normal(size=(n + 1, d)) + 0.2
        a, b = (np.atleast_2d(np.cov(v.T)) for v in (x, y))
        root = np.sqrt(np.maximum(eigvals(a @ b).real, 0)).sum()  # a zero eigenvalue is computed as 10^-16 or so
        right = ((x.mean(axis=0) - y.mean(axis=0)) ** 2).sum() + np.trace(a) + np.trace(b) - 2 * root
        found = metrics.frechet_distance(x, y)
        error = abs(found / right - 1)
        why = "The reference takes roots of eigenvalues that are right to 2^-53 only: 2^-26.5 each."
        yield Check("float64", f"{n} of {d}: against eigenvalues, relative", error, d * np.sqrt(FLOAT64) / 4, why)
        single = metrics.frechet_distance(x.astype(np.float32), y.astype(np.float32))
        why = "Only the features are rounded: the distance is computed in float64."
        yield Check("float32", f"{n} of {d}: against float64, relative", abs(single / found - 1), 16 * d * FLOAT32, why)
        error = metrics.frechet_distance(x, x)
        why = "Two traces cancel a nuclear norm."
        yield Check("float64", f"{n} of {d}: of a set to itself", error, 64 * d * FLOAT64 * np.trace(a), why)
    alike = np.ones((6, 5))
    lower, upper = metrics.bootstrap_interval(metrics.frechet_distance, alike, alike, resamples=20)
    distances = np.array((metrics.frechet_distance(alike, alike), metrics.kernel_distance(alike, alike), lower, upper))
    yield finite("float64", distances, what="without variance: distances")
    largest = float(np.abs(distances).max())
    yield Check("float64", "without variance: largest distance", largest, 64 * FLOAT64 * 8, "All samples are the same.")


def _scales(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Features of 1e-30 and 1e30, with an offset of 1e8, with deviations over ten decades, and too large to square."""
    random = np.random.default_rng(1)
    x, y = random.normal(size=(50, 6)), random.normal(size=(40, 6)) * 1.3 + 0.4
    right = metrics.frechet_distance(x, y)
    for scale in (2.0**-100, 2.0**100):
        error = abs(metrics.frechet_distance(x * scale, y * scale) / scale**2 / right - 1)
        yield Check("float64", f"scale {scale:.1e}: relative", error, 64 * FLOAT64, "The distance is of second degree.")
    offset = 1e8
    error = abs(metrics.frechet_distance(x + offset, y + offset) / right - 1)
    why = "The offset rounds the features to 10^8 2^-53."
    yield Check("float64", "offset 1e8: relative", error, 64 * offset * FLOAT64, why)
    deviations = np.logspace(-5, 5, 6)
    error = metrics.frechet_distance(x * deviations, x * deviations) / deviations[-1] ** 2
    why = "No covariance is formed, in which the largest entries would hide the smallest."
    yield Check("float64", "ten decades: of a set to itself, of its variance", error, 64 * 6 * FLOAT64, why)
    large = product(DISTANCES, (1e60, 1e200, np.nan, np.inf))
    yield refused("float64", *(partial(distance, x * value, y) for distance, value in large))


def _textures(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Texture features of constant images, of a single white pixel, of a checkerboard and of noise."""
    single, board = _grey(0), (np.indices(SHAPE).sum(axis=0) % 2 * 255).astype(np.uint8)
    single[24, 24] = 255
    features = metrics.speckle_features(np.stack([_grey(0), _grey(255), single, board, _noise(3)]))
    yield finite("float64", features, what="features")
    why = "The mean gradient of a checkerboard is 255 grey levels, which is the largest feature."
    yield Check("float64", "largest feature", float(np.abs(features).max()), 255 / GRADIENT_UNIT, why)
    excess = metrics.evaluate_image(metrics.Pair(board, _grey(0), FAN))["nyquist_excess"]
    yield finite("float32", np.array(excess), what="checkerboard: excess")


CASES = (
    Case("all-black, all-white and identical images in every metric", _black_and_white),
    Case("metrics in float32 against float64", _in_double),
    Case("maps without a shadow", _shadows),
    Case("empty histograms, masks and images", _empty),
    Case("images of 25 million pixels", _large),
    Case("Frechet distance: n < d, n = 2, n = 1", _frechet),
    Case("distances of features of every scale", _scales),
    Case("texture of one grey and of a checkerboard", _textures),
)
