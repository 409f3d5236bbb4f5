"""Sums and percentile of the attenuation map, scan conversion, and images of one row."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from ablate.anatomy import Scene
from ablate.numerics.stability.checks import FLOAT32, Case, Check, finite, off
from ablate.numerics.stability.frames import AHEAD, SMALL, SOFT, slab
from ablate.ultrasound import ConvexProbe, Simulator
from ablate.ultrasound.imaging.bmode import ScanConverter
from ablate.ultrasound.maps.attenuation import DB_PER_NEPER, integral_attenuation

LINES, SAMPLES, SPACING_MM = 64, 3072, 150 / 3072
STIFF_DB_MM = 1e4 * 8 / 10  # the largest attenuation allowed, at 8 MHz
SOFT_DB_MM = 0.5 * 8 / 10


def in_double(labels: np.ndarray, losses_db_mm: np.ndarray) -> tuple[np.ndarray, float]:
    """Compute A by its definition, with NumPy's percentile, and the attenuation at that percentile, Np."""
    total = np.cumsum((losses_db_mm * SPACING_MM / DB_PER_NEPER)[labels], axis=1)
    about = float(np.sort(total, axis=None)[int(0.02 * (total.size - 1))])  # e^-3000 would be 0, and e^3000 infinite
    amplitude = np.exp(np.minimum(about - total, 700))
    scale = np.percentile(amplitude, 98)
    return np.minimum(amplitude / scale, 1), about - float(np.log(scale))


def _against_double(label: str, labels: np.ndarray, losses_db_mm: np.ndarray) -> Iterator[Check]:
    """Compare A with its definition in double precision."""
    found = integral_attenuation(labels, losses_db_mm, SPACING_MM)
    right, scale = in_double(labels, losses_db_mm)
    yield finite("float32", found, what=f"{label}samples")
    if losses_db_mm.max() * SPACING_MM / DB_PER_NEPER * labels.shape[1] > 1e3:
        bound = 4 * FLOAT32
        why = "Thousands of nepers are summed in float64; increments and result are rounded."
    else:
        bound = 2 * labels.shape[1] * FLOAT32 * max(scale, 1.0)
        why = (
            "A sum x of n rounded terms has an error of n 2^-24 x. With s, the attenuation of the percentile in Np, "
            "x e^(s - x) is at most the larger of 1 and s."
        )
    yield Check("float32", f"{label}A against float64", off(found, right), bound, why)
    rise = float(np.diff(found, axis=1, prepend=np.float32(1)).max())
    yield Check("float32", f"{label}rise of A along a line", rise, 0, "Attenuation only grows with depth.")


def _stiff(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Bone of 40 dB/cm/MHz everywhere: 4800 dB."""
    yield from _against_double("", np.zeros((LINES, SAMPLES), np.uint8), np.array([40 * 8 / 10]))


def _decades(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Layers of random tissues whose attenuations span six decades."""
    random = np.random.default_rng(0)
    labels = random.integers(0, 7, (LINES, 24)).astype(np.uint8).repeat(128, axis=1)
    yield from _against_double("", labels, np.logspace(-4, 2, 7) * SOFT_DB_MM / 10)


def _shadowed(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Soft tissue behind 2.8 mm of 800 dB/mm: its own attenuation must not be rounded away."""
    labels = np.zeros((LINES, SAMPLES), np.uint8)
    labels[:, : round(2.8 / SPACING_MM)] = 1
    yield from _against_double("", labels, np.array([SOFT_DB_MM, STIFF_DB_MM]))


def _lossless(device: str) -> Iterator[Check]:  # noqa: ARG001
    """No attenuation, and 10^-12 dB/mm."""
    for loss in (0.0, 1e-12):
        found = integral_attenuation(np.zeros((LINES, SAMPLES), np.uint8), np.array([loss]), SPACING_MM)
        error = float(1 - found.min())
        yield Check("float32", f"{loss:g} dB/mm: 1 - A", error, FLOAT32, "Float32 rounds this to 1.")


def _few(device: str) -> Iterator[Check]:  # noqa: ARG001
    """One scanline, one sample, and one of both, in soft tissue and with the largest attenuation."""
    for lines, samples in ((1, SAMPLES), (LINES, 1), (1, 1), (1, 2)):
        for name, loss in (("soft", SOFT_DB_MM), ("stiff", STIFF_DB_MM)):
            labels = np.zeros((lines, samples), np.uint8)
            yield from _against_double(f"{lines} x {samples}, {name}: ", labels, np.array([loss]))


def _conversion(device: str) -> Iterator[Check]:
    """Scan conversion of a constant, of a step, and of scanlines alternating between 0 and 8e37."""
    probe, settings = ConvexProbe(), replace(SMALL, axial_samples=SAMPLES, device=device)
    single, double = (ScanConverter(probe, settings, dtype) for dtype in (torch.float32, torch.float64))

    def pixels(convert: ScanConverter, lines: np.ndarray, dtype: torch.dtype) -> np.ndarray:
        return convert(torch.from_numpy(lines).to(device, dtype))[convert.mask]

    ones, step = np.ones((LINES, SAMPLES)), np.zeros((LINES, SAMPLES))
    step[:, SAMPLES // 2 :] = 1
    why = "The weights of four neighbours sum to 1."
    yield Check("float32", "a constant against itself", off(pixels(single, ones, torch.float32), 1.0), 4 * FLOAT32, why)
    error = off(pixels(single, step, torch.float32), pixels(double, step, torch.float64))
    why = "The position of a pixel among n samples is rounded by n 2^-23 samples, and a step changes by 1 a sample."
    yield Check("float32", "a step against float64", error, (SAMPLES + LINES) * 2 * FLOAT32, why)
    largest = np.zeros((LINES, SAMPLES))
    largest[::2] = float(np.finfo(np.float32).max) / 4
    found = pixels(single, largest, torch.float32)
    yield finite("float32", found, what="pixels between 0 and 8e37")
    overshoot = float(found.max() / largest.max() - 1)
    yield Check("float32", "overshoot, relative", overshoot, 4 * FLOAT32, "A mean does not exceed its values.")


def _one_row(device: str) -> Iterator[Check]:
    """Images of one pixel, one row and one column, and a fan so thin that it holds no pixel's centre."""
    scene = Scene((slab(SOFT, 40.0, 60.0),), SOFT, "layer")
    for shape, depth_mm in (((1, 1), 150.0), ((1, 277), 150.0), ((200, 1), 150.0), ((1, 1), 1e-6)):
        probe = ConvexProbe(depth_mm=depth_mm)
        simulator = Simulator(scene, probe, replace(SMALL, image_shape=shape, device=device))
        labels, attenuation = simulator.maps(AHEAD)
        label = f"{shape[0]} x {shape[1]}, {depth_mm:g} mm deep"
        yield finite("float32", attenuation, what=f"{label}: pixels of A")
        outside = ~simulator.mask
        wrong = int(((labels == 0) != outside).sum() + np.count_nonzero(attenuation[outside]))
        yield Check("float32", f"{label}: pixels of the fan that are wrong", wrong, 0, "S and A are 0 outside the fan.")


CASES = (
    Case("A: thousands of decibels", _stiff),
    Case("A: losses over six decades", _decades),
    Case("A: soft tissue behind 2200 dB", _shadowed),
    Case("A: no loss, and next to none", _lossless),
    Case("A: one line, one sample", _few),
    Case("scan conversion of steps and of the largest float32", _conversion),
    Case("images of a pixel, a row and a column", _one_row),
)
