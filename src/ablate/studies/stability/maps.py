"""The attenuation map's sums and percentile, scan conversion, and images of one row."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import torch

from ablate.anatomy import Scene
from ablate.studies.stability.checks import FLOAT32, Case, Check, finite, off
from ablate.studies.stability.frames import AHEAD, SMALL, SOFT, slab
from ablate.ultrasound import ConvexProbe, Simulator
from ablate.ultrasound.attenuation import DB_PER_NEPER, integral_attenuation
from ablate.ultrasound.scan_conversion import ScanConverter

LINES, SAMPLES, SPACING_MM = 64, 3072, 150 / 3072
STIFF_DB_MM = 1e4 * 8 / 10  # the largest attenuation allowed, at 8 MHz
SOFT_DB_MM = 0.5 * 8 / 10


def in_double(labels: np.ndarray, losses_db_mm: np.ndarray) -> tuple[np.ndarray, float]:
    """A by its definition, with NumPy's percentile, and the nepers lost at that percentile."""
    total = np.cumsum((losses_db_mm * SPACING_MM / DB_PER_NEPER)[labels], axis=1)
    about = float(np.sort(total, axis=None)[int(0.02 * (total.size - 1))])  # e^-3000 would be 0, and e^3000 infinite
    amplitude = np.exp(np.minimum(about - total, 700))
    scale = np.percentile(amplitude, 98)
    return np.minimum(amplitude / scale, 1), about - float(np.log(scale))


def _against_double(label: str, labels: np.ndarray, losses_db_mm: np.ndarray) -> Iterator[Check]:
    """A of some labels against its definition in double precision."""
    found = integral_attenuation(labels, losses_db_mm, SPACING_MM)
    right, scale = in_double(labels, losses_db_mm)
    yield finite("float32", found, what=f"{label}samples")
    if losses_db_mm.max() * SPACING_MM / DB_PER_NEPER * labels.shape[1] > 1e3:
        bound, why = 4 * FLOAT32, "Thousands of nepers are summed in double; increments and result are rounded."
    else:
        bound = 2 * labels.shape[1] * FLOAT32 * max(scale, 1.0)
        why = (
            "A sum of n rounded terms is off by n 2^-24 of itself, x nepers; x e^(s - x) is at most the larger of 1 "
            "and s, the nepers of the percentile."
        )
    yield Check("float32", f"{label}A against float64", off(found, right), bound, why)
    rise = float(np.diff(found, axis=1, prepend=np.float32(1)).max())
    yield Check("float32", f"{label}rise of A along a line", rise, 0, "Sound only gets weaker on its way.")


def _stiff(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Bone of 40 dB/cm/MHz throughout: 4800 dB."""
    yield from _against_double("", np.zeros((LINES, SAMPLES), np.uint8), np.array([40 * 8 / 10]))


def _decades(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Layers of random tissues whose losses span six decades."""
    random = np.random.default_rng(0)
    labels = random.integers(0, 7, (LINES, 24)).astype(np.uint8).repeat(128, axis=1)
    yield from _against_double("", labels, np.logspace(-4, 2, 7) * SOFT_DB_MM / 10)


def _shadowed(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Soft tissue behind 2.8 mm of what takes 800 dB/mm: its own loss must not drown in what was lost before."""
    labels = np.zeros((LINES, SAMPLES), np.uint8)
    labels[:, : round(2.8 / SPACING_MM)] = 1
    yield from _against_double("", labels, np.array([SOFT_DB_MM, STIFF_DB_MM]))


def _lossless(device: str) -> Iterator[Check]:  # noqa: ARG001
    """No loss at all, and one of 10^-12 dB/mm."""
    for loss in (0.0, 1e-12):
        found = integral_attenuation(np.zeros((LINES, SAMPLES), np.uint8), np.array([loss]), SPACING_MM)
        yield Check(
            "float32", f"{loss:g} dB/mm: 1 - A", float(1 - found.min()), FLOAT32, "Less than float32 tells from 1."
        )


def _few(device: str) -> Iterator[Check]:  # noqa: ARG001
    """One line, one sample, one of both, in soft tissue and in the stiffest."""
    for lines, samples in ((1, SAMPLES), (LINES, 1), (1, 1), (1, 2)):
        for name, loss in (("soft", SOFT_DB_MM), ("stiff", STIFF_DB_MM)):
            labels = np.zeros((lines, samples), np.uint8)
            yield from _against_double(f"{lines} x {samples}, {name}: ", labels, np.array([loss]))


def _conversion(device: str) -> Iterator[Check]:
    """Scan conversion of a constant, of a step, and of lines that alternate between 0 and the largest float32."""
    probe, settings = ConvexProbe(), replace(SMALL, axial_samples=SAMPLES, device=device)
    single, double = (ScanConverter(probe, settings, dtype) for dtype in (torch.float32, torch.float64))

    def pixels(convert: ScanConverter, lines: np.ndarray, dtype: torch.dtype) -> np.ndarray:
        return convert(torch.from_numpy(lines).to(device, dtype))[convert.mask]

    ones, step = np.ones((LINES, SAMPLES)), np.zeros((LINES, SAMPLES))
    step[:, SAMPLES // 2 :] = 1
    yield Check(
        "float32", "a constant against itself", off(pixels(single, ones, torch.float32), 1.0), 4 * FLOAT32,
        "Weights of four neighbours sum to 1.",
    )  # fmt: skip
    yield Check(
        "float32", "a step against float64",
        off(pixels(single, step, torch.float32), pixels(double, step, torch.float64)),
        (SAMPLES + LINES) * 2 * FLOAT32,
        "A pixel's place among n samples is off by n 2^-23 of their spacing, which is what a step of 1 changes by.",
    )  # fmt: skip
    largest = np.zeros((LINES, SAMPLES))
    largest[::2] = float(np.finfo(np.float32).max) / 4
    found = pixels(single, largest, torch.float32)
    yield finite("float32", found, what="pixels between 0 and 8e37")
    yield Check(
        "float32", "overshoot, relative", float(found.max() / largest.max() - 1), 4 * FLOAT32, "A mean is no more."
    )


def _one_row(device: str) -> Iterator[Check]:
    """Images of a pixel, a row, a column, and of a fan so thin that no pixel's centre lies in it."""
    scene = Scene((slab(SOFT, 40.0, 60.0),), SOFT, "layer")
    for shape, probe in (
        ((1, 1), ConvexProbe()),
        ((1, 277), ConvexProbe()),
        ((200, 1), ConvexProbe()),
        ((1, 1), ConvexProbe(depth_mm=1e-6)),
    ):
        settings = replace(SMALL, image_shape=shape, device=device)
        simulator = Simulator(scene, probe, settings)
        labels, attenuation = simulator.maps(AHEAD)
        label = f"{shape[0]} x {shape[1]}, {probe.depth_mm:g} mm deep"
        yield finite("float32", attenuation, what=f"{label}: pixels of A")
        wrong = int(np.count_nonzero((labels > 0) != simulator.mask)) + int(
            np.count_nonzero(attenuation[~simulator.mask])
        )
        yield Check(
            "float32",
            f"{label}: pixels of the fan that are wrong",
            wrong,
            0,
            "S and A are 0 outside it, and only there.",
        )


CASES = (
    Case("A: thousands of decibels", _stiff),
    Case("A: losses over six decades", _decades),
    Case("A: soft tissue behind 2200 dB", _shadowed),
    Case("A: no loss, and next to none", _lossless),
    Case("A: one line, one sample", _few),
    Case("scan conversion of steps and of the largest float32", _conversion),
    Case("images of a pixel, a row and a column", _one_row),
)
