"""Scores of images that are all one grey, the same, or too small, and of features too few, too large or too alike."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from scipy.linalg import eigvals
from scipy.ndimage import gaussian_filter

from ablate.metrics import (
    Pair,
    bootstrap_interval,
    evaluate_image,
    frechet_distance,
    kernel_distance,
    mae,
    mae_smooth,
    noise_sd,
    patch_chi2,
    patches_inside,
    psnr,
    rms,
    shadow_contrast,
    speckle_features,
)
from ablate.metrics.features import GRADIENT_UNIT
from ablate.studies.stability.checks import FLOAT32, FLOAT64, Case, Check, finite, off, refused
from ablate.ultrasound import ConvexProbe, fan_mask
from ablate.ultrasound.probe import pixel_polar

SHAPE = (200, 277)
FAN = fan_mask(ConvexProbe(), SHAPE)
DEPTH_MM = pixel_polar(ConvexProbe(), SHAPE)[0]


def _grey(level: int) -> np.ndarray:
    return np.full(SHAPE, level, np.uint8)


def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, SHAPE).astype(np.uint8)


def _scores(a: np.ndarray, b: np.ndarray, mask: np.ndarray = FAN) -> dict[str, float]:
    """All metrics of a pair, with a shadow to the left and enhancement to the right."""
    attenuation = np.repeat([0.2, 1.0, 2.0], (80, 117, 80)).astype(np.float32) / 2 * np.ones(SHAPE, np.float32)
    return evaluate_image(Pair(a, b, mask, mask, attenuation, np.maximum(DEPTH_MM, 0)))


def _against(label: str, found: dict[str, float], right: dict[str, float]) -> Iterator[Check]:
    """Every score against what it must be; a score that is missing, or beyond what is listed, is a fault."""
    yield Check("uint8", f"{label}: scores missing", len(right.keys() ^ found.keys()), 0, "Each has a value here.")
    for name in right.keys() & found.keys():
        smooth = name in ("mae_smooth", "nyquist_excess")
        wrong = 0.0 if found[name] == right[name] else abs(found[name] - right[name])
        yield Check(
            "float32" if smooth else "uint8", f"{label}: {name} against {right[name]:g}", wrong,
            255 * 64 * FLOAT32 if smooth else 16 * FLOAT64 * 255,
            "Sums in float32 by an FFT of a few ten factors." if smooth else "Sums of whole numbers, and one division.",
        )  # fmt: skip


def _black_and_white(device: str) -> Iterator[Check]:  # noqa: ARG001
    """All black against all white, and either against itself."""
    same = dict.fromkeys(("mae", "mae_fan", "pchi2", "pchi2_fan", "pchi2_tissue", "shadow_contrast", "mae_smooth"), 0.0)
    same |= {"psnr": math.inf, "psnr_fan": math.inf, "nyquist_excess": 0.0}
    yield from _against("black, black", _scores(_grey(0), _grey(0)), same)
    yield from _against("white, white", _scores(_grey(255), _grey(255)), same)
    yield from _against("noise, itself", _scores(_noise(0), _noise(0)), same)
    apart = {"psnr": 0.0, "psnr_fan": 0.0, "mae": 255.0, "mae_fan": 255.0, "mae_smooth": 255.0, "pchi2": 1.0}
    apart |= {"pchi2_fan": 1.0, "pchi2_tissue": 1.0, "shadow_contrast": 0.0, "nyquist_excess": 0.0}
    yield from _against("black, white", _scores(_grey(0), _grey(255)), apart)


def _in_double(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Metrics that compute in float32 against the same in float64, on images of pure noise."""
    a, b = _noise(1), _noise(2)
    difference = (a.astype(float) - b) * FAN
    smooth, weight = (gaussian_filter(x, 4.0, mode="constant", truncate=3.0) for x in (difference, FAN.astype(float)))
    right = float(np.abs(smooth[FAN] / weight[FAN]).mean())
    yield Check(
        "float32", "mae_smooth against float64, grey levels", abs(mae_smooth(a, b, FAN) - right), 255 * 64 * FLOAT32,
        "Sums by an FFT of a few ten factors, of values up to 255.",
    )  # fmt: skip
    images = np.stack([_noise(k) for k in range(4)])
    right = float(np.sqrt(images[:, FAN].astype(np.longdouble).var(axis=0, ddof=1).mean()))
    found = noise_sd(images, FAN)
    assert found is not None
    yield Check(
        "float64", "noise_sd against long doubles, relative", abs(found / right - 1), 64 * FLOAT64, "Few roundings."
    )


def _shadows(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Attenuation of 0 everywhere, of the smallest float32, and of both signs of zero."""
    tiny = float(np.finfo(np.float32).tiny)
    for label, value in (("0", 0.0), ("the smallest float32", tiny), ("-0", -0.0)):
        attenuation = np.full(SHAPE, value, np.float32)
        found = shadow_contrast(_noise(1), _noise(2), attenuation, FAN, FAN, np.maximum(DEPTH_MM, 0))
        yield Check(
            "float32", f"A is {label}: shadows found", int(found is not None), 0, "Nothing differs from its depth."
        )


def _empty(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Empty masks and histograms, images smaller than a patch, a fan of one pixel."""
    none, one = np.zeros(SHAPE, bool), np.zeros(SHAPE, bool)
    one[100, 138] = True
    black, white = _grey(0), _grey(255)
    yield refused(
        "uint8",
        lambda: psnr(black, white, none),
        lambda: mae(black, white, none),
        lambda: mae_smooth(black, white, none),
        lambda: psnr(black[:0], white[:0]),
        lambda: speckle_features(black[None], none),
    )
    few = _scores(black, white, none)
    yield Check(
        "uint8", "no fan: scores besides those of the whole image", len(few.keys() - {"psnr", "mae", "pchi2"}), 0, ""
    )
    for bins in (1, 50, 256):  # of one grey all but one are empty: 0 / 0
        chi2 = patch_chi2(black, white, bins=bins)
        yield Check(
            "uint8", f"{bins} bins: chi-square against its value", off(chi2, float(bins > 1)), 0, "0 / 0 counts 0."
        )
    small = rms(patch_chi2(black[:19, :19], white[:19, :19]))
    yield Check("uint8", "smaller than a patch: scores", int(small is not None), 0, "There is no patch to judge.")
    outside = rms(patch_chi2(black, white), patches_inside(none))
    yield Check("uint8", "no patch in the fan: scores", int(outside is not None), 0, "There is no patch to judge.")
    spread = noise_sd(np.stack([black, white]), none)
    yield Check("uint8", "no tissue: spreads", int(spread is not None), 0, "There is no pixel to judge.")
    yield Check(
        "float32", "a fan of one pixel: mae_smooth against 255", abs(mae_smooth(black, white, one) - 255),
        255 * 64 * FLOAT32 / (1 / (2 * math.pi * 16)), "The Gaussian's own peak, 1/100, is divided by.",
    )  # fmt: skip


def _large(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Twenty-five million pixels, black against white: sums of squares reach 1.6 10^12."""
    black, white = np.zeros((5000, 5000), np.uint8), np.full((5000, 5000), 255, np.uint8)
    yield Check("uint8", "psnr against 0 dB", abs(psnr(black, white)), 0, "Sums of squares are 64-bit integers.")
    yield Check("uint8", "mae against 255", abs(mae(black, white) - 255), 0, "Sums are 64-bit integers.")


def _frechet(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Fewer samples than features, two samples, one, and none that differs."""
    random = np.random.default_rng(0)
    one = random.normal(size=(1, 8))
    yield refused("float64", *(lambda d=d: d(one, one) for d in (frechet_distance, kernel_distance)))
    for n, d in ((5, 20), (2, 20), (40, 4)):
        x, y = random.normal(size=(n, d)), 1.5 * random.normal(size=(n + 1, d)) + 0.2
        a, b = (np.atleast_2d(np.cov(v.T)) for v in (x, y))
        root = np.sqrt(np.maximum(eigvals(a @ b).real, 0)).sum()  # a zero eigenvalue may come out as 10^-16
        right = ((x.mean(axis=0) - y.mean(axis=0)) ** 2).sum() + np.trace(a) + np.trace(b) - 2 * root
        found = frechet_distance(x, y)
        yield Check(
            "float64", f"{n} of {d}: against eigenvalues, relative", abs(found / right - 1), d * np.sqrt(FLOAT64) / 4,
            "The reference takes roots of eigenvalues that are right to 2^-53 only: 2^-26.5 each.",
        )  # fmt: skip
        single = frechet_distance(x.astype(np.float32), y.astype(np.float32))
        yield Check(
            "float32", f"{n} of {d}: against float64, relative", abs(single / found - 1), 16 * d * FLOAT32,
            "Only the features are rounded: the distance is computed in double.",
        )  # fmt: skip
        yield Check(
            "float64", f"{n} of {d}: of a set to itself", frechet_distance(x, x), 64 * d * FLOAT64 * np.trace(a),
            "Two traces and a nuclear norm cancel.",
        )  # fmt: skip
    alike = np.ones((6, 5))
    low, high = bootstrap_interval(frechet_distance, alike, alike, resamples=20)
    distances = (frechet_distance(alike, alike), kernel_distance(alike, alike), low, high)
    yield finite("float64", np.array(distances), what="without variance: distances")
    yield Check(
        "float64", "without variance: largest distance", max(map(abs, distances)), 64 * FLOAT64 * 8, "All are alike."
    )


def _scales(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Features of 10^-30 and 10^30, beside an offset of 10^8, of deviations over ten decades, and beyond all bounds."""
    random = np.random.default_rng(1)
    x, y = random.normal(size=(50, 6)), random.normal(size=(40, 6)) * 1.3 + 0.4
    right = frechet_distance(x, y)
    for scale in (2.0**-100, 2.0**100):
        found = frechet_distance(x * scale, y * scale) / scale**2
        yield Check(
            "float64", f"scale {scale:.1e}: relative", abs(found / right - 1), 64 * FLOAT64, "It is of second degree."
        )
    offset = 1e8
    yield Check(
        "float64", "offset 1e8: relative", abs(frechet_distance(x + offset, y + offset) / right - 1),
        64 * offset * FLOAT64,
        "The offset leaves features right to 10^8 2^-53.",
    )  # fmt: skip
    deviations = np.logspace(-5, 5, 6)
    found = frechet_distance(x * deviations, x * deviations)
    yield Check(
        "float64", "ten decades: of a set to itself, of its variance", found / deviations[-1] ** 2, 64 * 6 * FLOAT64,
        "Covariances are never formed, whose smallest entries the largest would drown.",
    )  # fmt: skip
    yield refused(
        "float64",
        *(
            lambda d=d, v=v: d(x * v, y)
            for d in (frechet_distance, kernel_distance)
            for v in (1e60, 1e200, np.nan, np.inf)
        ),
    )


def _textures(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Texture features of one grey, of a lone white pixel, of a checkerboard and of noise."""
    lone, board = _grey(0), (np.indices(SHAPE).sum(axis=0) % 2 * 255).astype(np.uint8)
    lone[24, 24] = 255
    features = speckle_features(np.stack([_grey(0), _grey(255), lone, board, _noise(3)]))
    yield finite("float64", features, what="features")
    yield Check(
        "float64", "largest feature", float(np.abs(features).max()), 255 / GRADIENT_UNIT,
        "A checkerboard's mean gradient is 255 grey levels; nothing else goes as far.",
    )  # fmt: skip
    excess = evaluate_image(Pair(board, _grey(0), FAN))["nyquist_excess"]
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
