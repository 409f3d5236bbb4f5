"""Scores of constant and too small images, distances of odd features, and statistics of few or equal values."""

import math
from functools import partial
from itertools import product

import numpy as np
import pandas as pd
from scipy.linalg import eigvals
from scipy.ndimage import gaussian_filter

from ablate import metrics
from ablate.analysis import PairedDifference, Verdict, component_claim, factorial_effects, holm, paired_difference
from ablate.metrics.features import GRADIENT_UNIT
from ablate.numerics.stability.checks import FLOAT32, FLOAT64, Checks, case, off
from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.ultrasound.probe import pixel_polar, pixel_size_mm

SHAPE = (200, 277)
FAN = fan_mask(ConvexProbe(), SHAPE)
DEPTH_MM, PIXEL_MM = pixel_polar(ConvexProbe(), SHAPE)[0], pixel_size_mm(ConvexProbe(), SHAPE)
BONE = FAN & (np.indices(SHAPE) // 5 % 6 == 0).all(axis=0)  # squares of 4 mm and more
BLACK, WHITE = np.zeros(SHAPE, np.uint8), np.full(SHAPE, 255, np.uint8)
NOISE = np.stack([np.random.default_rng(seed).integers(0, 256, SHAPE).astype(np.uint8) for seed in range(4)])
CHECKERBOARD = (np.indices(SHAPE).sum(axis=0) % 2 * 255).astype(np.uint8)
FFT_ERROR = 255 * 64 * FLOAT32
DISTANCES = metrics.frechet_distance, metrics.kernel_distance


def _scores(a: np.ndarray, b: np.ndarray, mask: np.ndarray = FAN) -> dict[str, float]:
    """Compute all metrics of a pair, with shadow at the left, enhancement at the right, and bone."""
    attenuation = np.repeat([0.2, 1.0, 2.0], (80, 117, 80)).astype(np.float32) / 2 * np.ones(SHAPE, np.float32)
    labels, depth_mm = np.ones(SHAPE, np.uint8), np.maximum(DEPTH_MM, 0)
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
    of_pair = [name for name, metric in metrics.METRICS.items() if metric.of_image or metric.of_draws]
    same = {name: math.inf if name in ("psnr", "psnr_fan") else 0.0 for name in of_pair}
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


@case("metrics in float32 against float64")
def _in_double(checks: Checks) -> None:
    """Metrics that are computed in float32, against float64, on images of noise."""
    difference = (NOISE[1].astype(float) - NOISE[2]) * FAN
    sigma = [1.5 / size for size in PIXEL_MM]
    smooth, weight = (gaussian_filter(x, sigma, mode="constant", truncate=3.0) for x in (difference, FAN.astype(float)))
    noise = metrics.Pair(NOISE[1], NOISE[2], FAN, FAN, pixel_mm=PIXEL_MM, draws=NOISE)
    error = abs((metrics.mae_smooth(noise) or math.nan) - np.abs(smooth[FAN] / weight[FAN]).mean())
    why = "Sums of values up to 255 by an FFT with some ten factors."
    checks.add("mae_smooth against float64, grey levels", error, FFT_ERROR, why, "float32")
    right = float(np.sqrt(NOISE[:, FAN].astype(np.longdouble).var(axis=0, ddof=1).mean()))
    error = abs((metrics.noise_sd(noise) or math.nan) / right - 1)
    checks.add("noise_sd against long doubles, relative", error, 64 * FLOAT64, "There are few roundings.")


@case("maps without a shadow")
def _shadows(checks: Checks) -> None:
    """Attenuation maps that are 0, -0 and the smallest float32 everywhere."""
    checks.dtype, tiny = "float32", float(np.finfo(np.float32).tiny)
    for label, value in (("0", 0.0), ("the smallest float32", tiny), ("-0", -0.0)):
        attenuation = np.full(SHAPE, value, np.float32)
        pair = metrics.Pair(NOISE[1], NOISE[2], FAN, FAN, attenuation, DEPTH_MM, FAN.astype(np.uint8))
        shadow = metrics.shadow_contrast(pair)
        checks.none(f"A is {label}: shadows found", shadow is not None, "A is constant at every depth.")


@case("empty histograms, masks and images")
def _empty(checks: Checks) -> None:
    """Empty masks and histograms, images smaller than a patch, and a fan of one pixel."""
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
    small = metrics.rms(metrics.patch_chi2(BLACK[:19, :19], WHITE[:19, :19]))
    checks.none("smaller than a patch: scores", small is not None, "There is no patch.")
    outside = metrics.rms(metrics.patch_chi2(BLACK, WHITE), metrics.patches_inside(nowhere))
    checks.none("no patch in the fan: scores", outside is not None, "There is no patch.")
    checks.none("no tissue: spreads", metrics.noise_sd(empty) is not None, "There is no pixel.")
    error = abs((metrics.mae_smooth(metrics.Pair(BLACK, WHITE, one)) or math.nan) - 255)
    why = "The sum is divided by the peak of the Gaussian, 1/100."
    checks.add("a fan of one pixel: mae_smooth against 255", error, FFT_ERROR * 2 * math.pi * 16, why, "float32")


@case("images of 25 million pixels")
def _large(checks: Checks) -> None:
    """Images of 25 million pixels, black against white: the sum of squares is 1.6e12."""
    checks.dtype = "uint8"
    black, white = np.zeros((5000, 5000), np.uint8), np.full((5000, 5000), 255, np.uint8)
    checks.add("psnr against 0 dB", abs(metrics.psnr(black, white)), 0, "Sums of squares are 64-bit integers.")
    checks.add("mae against 255", abs(metrics.mae(black, white) - 255), 0, "Sums are 64-bit integers.")


@case("Frechet distance: n < d, n = 2, n = 1")
def _frechet(checks: Checks) -> None:
    """Fewer samples than features, two samples, one sample, and samples that are all the same."""
    random = np.random.default_rng(0)
    one = random.normal(size=(1, 8))
    checks.refused(*(partial(distance, one, one) for distance in DISTANCES))
    for n, d in ((5, 20), (2, 20), (40, 4)):
        checks.label = f"{n} of {d}"
        x, y = random.normal(size=(n, d)), 1.5 * random.normal(size=(n + 1, d)) + 0.2
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
    alike, checks.label = np.ones((6, 5)), "without variance"
    interval = metrics.bootstrap_interval(metrics.frechet_distance, alike, alike, np.arange(6), resamples=20)
    distances = np.array([*(distance(alike, alike) for distance in DISTANCES), *interval])
    checks.finite(distances, what="distances")
    checks.add("largest distance", np.abs(distances).max(), 64 * FLOAT64 * 8, "All samples are the same.")


@case("distances of features of every scale")
def _scales(checks: Checks) -> None:
    """Features of 1e-30 and 1e30, with an offset of 1e8, with deviations over ten decades, and too large to square."""
    random = np.random.default_rng(1)
    x, y = random.normal(size=(50, 6)), random.normal(size=(40, 6)) * 1.3 + 0.4
    right = metrics.frechet_distance(x, y)
    for scale in (2.0**-100, 2.0**100):
        error = abs(metrics.frechet_distance(x * scale, y * scale) / scale**2 / right - 1)
        checks.add(f"scale {scale:.1e}: relative", error, 64 * FLOAT64, "The distance is of second degree.")
    offset, why = 1e8, "The offset rounds the features to 10^8 2^-53."
    error = abs(metrics.frechet_distance(x + offset, y + offset) / right - 1)
    checks.add("offset 1e8: relative", error, 64 * offset * FLOAT64, why)
    deviations, why = np.logspace(-5, 5, 6), "No covariance is formed, in which large entries would hide small ones."
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


def _compared(differences: np.ndarray, clusters: np.ndarray | None = None) -> PairedDifference:
    return paired_difference(differences, np.zeros(len(differences)), clusters)


def _consistent(checks: Checks, label: str, values: np.ndarray, clusters: np.ndarray | None = None) -> PairedDifference:
    """Check that the interval holds the estimate, that the data's range does, and that p is a probability."""
    checks.label, result = label, _compared(values, clusters)
    checks.finite(np.array([result.shift, result.p, result.effect]), what="figures")
    outside = max(result.lower - result.shift, result.shift - result.upper, 0.0)
    checks.add("estimate outside its interval", outside, 0, "An interval holds its estimate.")
    beyond = max(values.min() - result.shift, result.shift - values.max(), 0.0)
    checks.add("estimate outside the data", beyond, 0, "A median of means of two lies in their range.")
    checks.add("p outside [0, 1]", max(-result.p, result.p - 1, 0.0), 0, "It is a probability.")
    return result


@case("statistics: ties")
def _ties(checks: Checks) -> None:
    """Differences that are 0 on most frames, the same on most frames, or only two values."""
    _consistent(checks, "1000 of 1, 0 and pi", np.array([1.0] * 1000 + [0.0, np.pi]))
    _consistent(checks, "zeros and ones", np.repeat([0.0, 1.0], 15))
    _consistent(checks, "one in a hundred", np.array([0.0] * 99 + [1.0]))
    result = _consistent(checks, "60 zeros, -1 and pi", np.array([0.0] * 60 + [-1.0, np.pi]))
    checks.add("width of the interval", result.upper - result.lower, 0, "Every resample has the same median.")


@case("statistics: constant differences")
def _constant(checks: Checks) -> None:
    """The same difference on all frames."""
    for value in (0.0, 2.0, -1e-12, 1e12):
        result = _consistent(checks, f"{value:g} throughout", np.full(12, value))
        spread = max(abs(result.lower - value), abs(result.upper - value), abs(result.shift - value))
        checks.add("interval and estimate off it", spread, 0, "Every resample is the same.")
        checks.add("effect", abs(result.effect - np.sign(value)), 0, "All differences have one sign.")


@case("statistics: n of 1, 2 and 3, and one site")
def _few(checks: Checks) -> None:
    """One, two and three frames, many frames of one site, and no frame."""
    for n in (1, 2, 3):
        result = _consistent(checks, f"n = {n}", np.arange(1.0, n + 1))
        checks.add("p against 2^(1 - n)", abs(result.p - 2.0 ** (1 - n)), 4 * FLOAT64, "All signs are the same.")
    _consistent(checks, "two sites", np.arange(20.0), np.repeat([0, 1], 10))
    checks.label, one_site = "", _compared(np.arange(20.0), np.zeros(20))
    ends = np.isfinite([one_site.lower, one_site.upper])
    checks.none("one site: finite ends of the interval", ends, "One site does not show how sites differ.")
    checks.refused(partial(_compared, np.array([])), partial(_compared, np.array([np.inf])))
    verdict = component_claim([1.0, 2.0], [3.0, 4.0, 5.0]).verdict
    checks.none("two seeds: claims", verdict is not Verdict.not_claimable, "Three seeds are needed.")


@case("statistics: differences of every size")
def _sizes(checks: Checks) -> None:
    """Differences of 10^-300 and 10^90, with an offset of 10^12, and too large to be squared."""
    plain = np.random.default_rng(0).normal(0.3, 1.0, 40)
    right = _compared(plain)
    for scale in (2.0**-997, 2.0**-100, 2.0**300):
        result = _consistent(checks, f"times {scale:.1e}", plain * scale)
        apart = max(abs(getattr(result, name) / scale - getattr(right, name)) for name in ("shift", "lower", "upper"))
        checks.add("figures over the scale", apart, 64 * FLOAT64, "A power of two is exact.")
    offset, checks.label = 1e12, ""
    error = abs(paired_difference(plain + offset, np.full(40, offset)).shift - right.shift)
    checks.add("offset 1e12: shift", error, 2 * offset * FLOAT64, "Values are rounded.")
    error = abs(paired_difference(plain.astype(np.float32), np.zeros(40, np.float32)).shift - right.shift)
    checks.add("shift against float64", error, 4 * FLOAT32, "Values are rounded; medians are not.", "float32")
    checks.refused(*(partial(_compared, np.array(v)) for v in ([1e300, 2e300], [1.0, np.nan], [1e308, -1e308])))


@case("statistics: seeds that hardly vary")
def _claims(checks: Checks) -> None:
    """Seeds with the same result on one side, with results that differ in the last digit, and by 10^-150."""
    for checks.label, a, b in (
        ("one side constant", [1.0, 1.0, 1.0], [1.0, 2.0, 3.0]),
        ("last digit", [1.0, 1.0, 1 + 2e-16], [1.0, 1 + 2e-16, 1.0]),
        ("1e8 and 1e-7", [1e8, 1e8 + 1e-7, 1e8], [1e8, 1e8, 1e8 + 1e-7]),
        ("spread 1e-150", [1e-150, 2e-150, 3e-150], [1e-150, 5e-150, 2e-150]),
        ("spread 1e90", [1e90, 2e90, 3e90], [1e90, 5e90, 2e90]),
    ):
        claim = component_claim(a, b)
        checks.finite(np.array([claim.shift, claim.lower, claim.upper, claim.p], float), what="figures")
        checks.none("differences claimed", claim.verdict is Verdict.differs, "The two sides overlap.")
    checks.label, claim = "no seed changes anything", component_claim([1.0] * 3, [2.0] * 3)
    checks.none("claims", claim.verdict is not Verdict.not_claimable, "There is no spread to compare with.")


@case("statistics: p-values of 0 and 1")
def _families(checks: Checks) -> None:
    """Holm's correction of p-values of 0, of 1, of the smallest double and of ties."""
    p = np.array([0.0, 1.0, 5e-324, 0.02, 0.02, 0.5])
    adjusted = holm(p)
    checks.finite(adjusted, what="p-values")
    why = "The correction increases p, to 1 at most."
    checks.none("p-values that fell or exceed 1", (adjusted < p) | (adjusted > 1), why)
    fall = max(-np.diff(adjusted[np.argsort(p, kind="stable")]).min(), 0)
    checks.add("order that changed", fall, 0, "The correction is a running maximum.")
    checks.add("values of an empty family", holm([]).size, 0, "An empty family has no values.")
    checks.refused(partial(holm, [1.0 + 1e-12]), partial(holm, [np.nan]), partial(holm, [-1e-300]))


@case("statistics: effects of constants")
def _effects(checks: Checks) -> None:
    """Factorial studies with a constant result, with an exact effect, and with values of 10^100."""
    cells = pd.DataFrame([(a, b, s) for a in "xy" for b in "uv" for s in range(3)], columns=["a", "b", "seed"])
    second = (cells["a"] == "y").to_numpy(float)
    noise = np.random.default_rng(0).normal(size=len(cells))
    for checks.label, values, effect, bound in (
        ("constant 0.1", np.full(len(cells), 0.1), 0.0, 64 * FLOAT64),
        ("effect of 0.1", 0.3 + 0.1 * second, 0.1, 64 * FLOAT64),
        ("values of 1e100", 1e100 * (second + 1e-3 * noise), 1e100, 5e-3),
    ):
        table = factorial_effects(cells.assign(value=values), ["a", "b"])
        figures = table[["estimate", "lower", "upper", "p"]].to_numpy(float)
        checks.finite(figures, what="figures")
        error = abs(figures[0, 0] - effect) / np.abs(values).max()
        checks.add("effect of a", error, bound, "Sums of twelve; the last has noise of 1e-3 over six runs.")
