"""Scores of constant and too small images, and distances of odd features."""

import math
from functools import partial
from itertools import product

import numpy as np
from scipy.linalg import eigvals

from ablate import metrics
from ablate.metrics.features import GRADIENT_UNIT
from ablate.numerics.stability.checks import FLOAT32, FLOAT64, Checks, case, off
from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm

SHAPE = (200, 277)
FAN = fan_mask(ConvexProbe(), SHAPE)
DEPTH_MM = pixel_polar(ConvexProbe(), SHAPE)[0]
PIXEL_MM = pixel_size_mm(ConvexProbe(), SHAPE)
BONE = FAN & (np.indices(SHAPE) // 5 % 6 == 0).all(axis=0)  # squares of 4 mm and more
BLACK = np.zeros(SHAPE, np.uint8)
WHITE = np.full(SHAPE, 255, np.uint8)
NOISE = np.stack([np.random.default_rng(seed).integers(0, 256, SHAPE).astype(np.uint8) for seed in range(4)])
CHECKERBOARD = (np.indices(SHAPE).sum(axis=0) % 2 * 255).astype(np.uint8)
FFT_ERROR = 255 * 64 * FLOAT32
DISTANCES = metrics.frechet_distance, metrics.kernel_distance


def _scores(a: np.ndarray, b: np.ndarray, mask: np.ndarray = FAN) -> dict[str, float]:
    """Compute all metrics of a pair, with shadow at the left, enhancement at the right, and bone."""
    attenuation = np.repeat([0.2, 1.0, 2.0], (80, 117, 80)).astype(np.float32) / 2 * np.ones(SHAPE, np.float32)
    labels = np.ones(SHAPE, np.uint8)
    depth_mm = np.maximum(DEPTH_MM, 0)
    pair = metrics.Pair(a, b, mask, mask, attenuation, depth_mm, labels, BONE, PIXEL_MM, np.stack([a, b]))
    return metrics.evaluate_image(pair)


def _against(checks: Checks, label: str, scores: dict[str, float], right: dict[str, float]) -> None:
    """Compare each score with its exact value; a score that is missing, or not listed, is an error."""
    checks.label = label
    checks.add("scores missing", len(right.keys() ^ scores.keys()), 0, "Each has a value here.", "uint8")
    for name in (name for name in right if name in scores):
        wrong = 0.0 if scores[name] == right[name] else abs(scores[name] - right[name])
        quantity = f"{name} against {right[name]:g}"
        if name in ("mae_smooth", "nyquist_excess", "octave_sd"):
            checks.add(quantity, wrong, FFT_ERROR, "Float32 sums with some ten factors each.", "float32")
        else:
            checks.add(quantity, wrong, 16 * FLOAT64 * 255, "Sums of whole numbers and one division.", "uint8")


@case("all-black, all-white and identical images in every metric")
def _black_and_white(checks: Checks) -> None:
    """Black against white images, and each image against itself."""
    pair_metrics = [name for name, metric in metrics.METRICS.items() if metric.of_image or metric.of_draws]
    same = {name: math.inf if name in ("psnr", "psnr_fan") else 0.0 for name in pair_metrics}
    for label, image in (("black, black", BLACK), ("white, white", WHITE), ("noise, itself", NOISE[0])):
        _against(checks, label, _scores(image, image), same)
    apart = {"psnr": 0.0, "psnr_fan": 0.0, "mae": 255.0, "mae_fan": 255.0, "mae_smooth": 255.0, "pchi2": 1.0}
    apart |= {"pchi2_fan": 1.0, "pchi2_tissue": 1.0, "shadow_contrast": 0.0, "nyquist_excess": 0.0}
    apart |= {"thin_contrast": 0.0, "octave_sd": 0.0, "crps": 127.5, "noise_sd": 255 / math.sqrt(2)}
    _against(checks, "black, white", _scores(BLACK, WHITE), apart)
    checks.label = "any two of black, white, checkerboard and noise"
    scores = [_scores(a, b) for a, b in product((BLACK, WHITE, CHECKERBOARD, NOISE[0]), repeat=2)]
    checks.none("scores missing", [len(same.keys() ^ values.keys()) for values in scores], "Each has a value here.")
    finite = [value for values in scores for name, value in values.items() if not name.startswith("psnr")]
    checks.finite(np.array(finite), what="scores but PSNR")
    checks.none("PSNR that is NaN", [math.isnan(v["psnr"] + v["psnr_fan"]) for v in scores], "0 dB to infinity.")


@case("empty histograms, masks and images")
def _empty(checks: Checks) -> None:
    """Empty masks and histograms, maps without a shadow, images smaller than a patch, and a fan of one pixel."""
    nowhere, one = np.zeros((2, *SHAPE), bool)
    empty = metrics.Pair(BLACK, WHITE, nowhere, nowhere, draws=np.stack([BLACK, WHITE]))
    one[100, 138] = True
    checks.dtype = "uint8"
    masked = (partial(score, BLACK, WHITE, nowhere) for score in (metrics.psnr, metrics.mae))
    features = partial(metrics.speckle_features, BLACK[None], nowhere)
    checks.refused(*masked, partial(metrics.psnr, BLACK[:0], WHITE[:0]), features)
    more = len(_scores(BLACK, WHITE, nowhere).keys() - {"psnr", "mae", "pchi2"})
    checks.add("no fan: scores besides those of the whole image", more, 0, "Other scores need a fan.")
    for bins in (1, 50, 256):  # all but one are empty in both images: 0 / 0
        error = off(metrics.patch_chi2(BLACK, WHITE, bins=bins), float(bins > 1))
        checks.add(f"{bins} bins: chi-square against its value", error, 0, "0 / 0 counts as 0.")
    for where, score in (
        ("smaller than a patch", metrics.rms(metrics.patch_chi2(BLACK[:19, :19], WHITE[:19, :19]))),
        ("no patch in the fan", metrics.rms(metrics.patch_chi2(BLACK, WHITE), metrics.patches_inside(nowhere))),
        ("no tissue", metrics.noise_sd(empty)),
    ):
        checks.none(f"{where}: scores", score is not None, "There is no patch, or no pixel.")
    for value in (0.0, float(np.finfo(np.float32).tiny), -0.0):
        attenuation = np.full(SHAPE, value, np.float32)
        pair = metrics.Pair(NOISE[1], NOISE[2], FAN, FAN, attenuation, DEPTH_MM, FAN.astype(np.uint8))
        shadow = metrics.shadow_contrast(pair)
        checks.none(f"A is {value:.1g}: shadows found", shadow is not None, "A is constant at every depth.")
    error = abs((metrics.mae_smooth(metrics.Pair(BLACK, WHITE, one)) or math.nan) - 255)
    why = "The sum is divided by the peak of the Gaussian, 1/100."
    checks.add("a fan of one pixel: mae_smooth against 255", error, FFT_ERROR * 2 * math.pi * 16, why, "float32")


@case("Frechet distance: n < d, n = 2, n = 1")
def _frechet(checks: Checks) -> None:
    """Fewer samples than features, two samples, one sample, and samples that are all the same."""
    random = np.random.default_rng(0)
    one = random.normal(size=(1, 8))
    checks.refused(*(partial(distance, one, one) for distance in DISTANCES))
    for n, d in ((5, 20), (2, 20), (40, 4)):
        checks.label = f"{n} of {d}"
        x = random.normal(size=(n, d))
        y = 1.5 * random.normal(size=(n + 1, d)) + 0.2
        a, b = (np.atleast_2d(np.cov(v.T)) for v in (x, y))
        root = np.sqrt(np.maximum(eigvals(a @ b).real, 0)).sum()  # a zero eigenvalue is computed as 10^-16 or so
        right = ((x.mean(axis=0) - y.mean(axis=0)) ** 2).sum() + np.trace(a) + np.trace(b) - 2 * root
        computed = metrics.frechet_distance(x, y)
        why = "The reference takes roots of eigenvalues that are right to 2^-53 only: 2^-26.5 each."
        checks.add("against eigenvalues, relative", abs(computed / right - 1), d * np.sqrt(FLOAT64) / 4, why)
        single = metrics.frechet_distance(x.astype(np.float32), y.astype(np.float32))
        why = "Only the features are rounded: the distance is computed in float64."
        checks.add("against float64, relative", abs(single / computed - 1), 16 * d * FLOAT32, why, "float32")
        why = "Two traces cancel a nuclear norm."
        checks.add("of a set to itself", metrics.frechet_distance(x, x), 64 * d * FLOAT64 * np.trace(a), why)
    alike = np.ones((6, 5))
    checks.label = "without variance"
    interval = metrics.bootstrap_interval(metrics.frechet_distance, alike, alike, np.arange(6), resamples=20)
    distances = np.array([*(distance(alike, alike) for distance in DISTANCES), *interval])
    checks.finite(distances, what="distances")
    checks.add("largest distance", np.abs(distances).max(), 64 * FLOAT64 * 8, "All samples are the same.")


@case("distances of features of every scale")
def _scales(checks: Checks) -> None:
    """Features of 1e-30 and 1e30, with an offset of 1e8, with deviations over ten decades, and too large to square."""
    random = np.random.default_rng(1)
    x = random.normal(size=(50, 6))
    y = random.normal(size=(40, 6)) * 1.3 + 0.4
    right = metrics.frechet_distance(x, y)
    for scale in (2.0**-100, 2.0**100):
        error = abs(metrics.frechet_distance(x * scale, y * scale) / scale**2 / right - 1)
        checks.add(f"scale {scale:.1e}: relative", error, 64 * FLOAT64, "The distance is of second degree.")
    offset = 1e8
    why = "The offset rounds the features to 10^8 2^-53."
    error = abs(metrics.frechet_distance(x + offset, y + offset) / right - 1)
    checks.add("offset 1e8: relative", error, 64 * offset * FLOAT64, why)
    deviations = np.logspace(-5, 5, 6)
    why = "No covariance is formed, in which large entries would hide small ones."
    error = metrics.frechet_distance(x * deviations, x * deviations) / deviations[-1] ** 2
    checks.add("ten decades: of a set to itself, of its variance", error, 64 * 6 * FLOAT64, why)
    large = product(DISTANCES, (1e60, 1e200, np.nan, np.inf))
    checks.refused(*(partial(distance, x * value, y) for distance, value in large))


@case("texture of one grey and of a checkerboard")
def _textures(checks: Checks) -> None:
    """Texture features of constant images, of a single white pixel, of a checkerboard and of noise."""
    single = np.pad(WHITE[:1, :1], ((24, SHAPE[0] - 25), (24, SHAPE[1] - 25)))
    features = metrics.speckle_features(np.stack([BLACK, WHITE, single, CHECKERBOARD, NOISE[3]]))
    checks.finite(features, what="features")
    why = "The mean gradient of a checkerboard is 255 grey levels, which is the largest feature."
    checks.add("largest feature", np.abs(features).max(), 255 / GRADIENT_UNIT, why)
    excess = metrics.evaluate_image(metrics.Pair(CHECKERBOARD, BLACK, FAN))["nyquist_excess"]
    checks.finite(np.array(excess), what="checkerboard: excess", dtype="float32")
