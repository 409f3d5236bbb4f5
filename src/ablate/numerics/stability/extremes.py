"""Frames of one ray, line, sample or pixel, and attenuation maps at the ends of their range."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ablate.anatomy import Scene, Tissue
from ablate.numerics.stability.checks import FLOAT32, GEL, SMALL, SOFT, Checks, case, off, slab
from ablate.ultrasound import ConvexProbe, LinearProbe, PhasedProbe, Probe
from ablate.ultrasound.attenuation import DB_PER_NEPER, integral_attenuation

HARD = Tissue("hard", 2600, 4.2, 3.0, 0.6, 0.0, 0.2, roughness=0.05, thickness_mm=0.2)
BODY = Scene((slab(SOFT, 3.0, 120.0), slab(HARD, 40.0, 50.0, 30.0)), GEL, "body")
_ALL_ONE: dict[str, Any] = {"rays": 1, "scanlines": 1, "axial_samples": 1, "layers": 1, "image_shape": (1, 1)}
LINES = 64
SAMPLES = 3072
SPACING_MM = 150 / SAMPLES
STIFF_DB_MM = 1e4 * 8 / 10  # the largest attenuation allowed, at 8 MHz
SOFT_DB_MM = 0.5 * 8 / 10


@case("one ray, one line, one sample, one pixel")
def _ones(checks: Checks) -> None:
    """One of each, then one of all, on a probe of each kind."""
    kinds: dict[str, Probe] = {"": ConvexProbe(), "linear, ": LinearProbe(60.0, 150.0), "phased, ": PhasedProbe()}
    for kind, probe in kinds.items():
        for changes in (*({name: value} for name, value in _ALL_ONE.items()), _ALL_ONE):
            label = ", ".join(f"{name} {value}" for name, value in changes.items())
            checks.render(BODY, replace(SMALL, **changes), probe, label=kind + label)


def _against_double(checks: Checks, labels: np.ndarray, losses_db_mm: np.ndarray) -> None:
    """Compare A with its definition in double precision, with NumPy's percentile."""
    checks.dtype = "float32"
    computed = integral_attenuation(labels, losses_db_mm, SPACING_MM)
    total = np.cumsum((losses_db_mm * SPACING_MM / DB_PER_NEPER)[labels], axis=1)
    about = float(np.sort(total, axis=None)[int(0.02 * (total.size - 1))])  # e^-3000 would be 0, and e^3000 infinite
    amplitude = np.exp(np.minimum(about - total, 700))
    percentile = np.percentile(amplitude, 98)
    right = np.minimum(amplitude / percentile, 1)
    scale = about - float(np.log(percentile))  # in Np
    checks.finite(computed, what="samples")
    if losses_db_mm.max() * SPACING_MM / DB_PER_NEPER * labels.shape[1] > 1e3:
        bound = 4 * FLOAT32
        why = "Thousands of nepers are summed in float64; increments and result are rounded."
    else:
        bound = 2 * labels.shape[1] * FLOAT32 * max(scale, 1.0)
        why = (
            "A sum x of n rounded terms has an error of n 2^-24 x. With s, the attenuation of the percentile in Np, "
            "x e^(s - x) is at most the larger of 1 and s."
        )
    checks.add("A against float64", off(computed, right), bound, why)
    rise = np.diff(computed, axis=1, prepend=np.float32(1)).max()
    checks.add("rise of A along a line", rise, 0, "Attenuation only grows with depth.")


@case("A: soft tissue behind 2200 dB", [1, 0], [round(2.8 / SPACING_MM), SAMPLES], [SOFT_DB_MM, STIFF_DB_MM])
@case("A: losses over six decades", range(7), [SAMPLES // 7] * 7, np.logspace(-4, 2, 7) * SOFT_DB_MM / 10)
@case("A: thousands of decibels", [0], [SAMPLES], [40 * 8 / 10])
def _layers(checks: Checks, tissues: Sequence[int], samples: Sequence[int], losses_db_mm: Sequence[float]) -> None:
    """Layers of tissue: 4800 dB of bone; losses over six decades; soft tissue that must keep its own behind 2200 dB."""
    labels = np.repeat(np.array(tissues, np.uint8), samples)[:SAMPLES]
    _against_double(checks, np.tile(labels, (LINES, 1)), np.array(losses_db_mm))


@case("A: one line, one sample, no loss")
def _few(checks: Checks) -> None:
    """One scanline, one sample, and one of both, with the smallest and the largest attenuation."""
    for lines, samples in ((LINES, SAMPLES), (1, SAMPLES), (LINES, 1), (1, 1), (1, 2)):
        for name, loss in (("no loss", 0.0), ("1e-12 dB/mm", 1e-12), ("soft", SOFT_DB_MM), ("stiff", STIFF_DB_MM)):
            checks.label = f"{lines} x {samples}, {name}"
            _against_double(checks, np.zeros((lines, samples), np.uint8), np.array([loss]))
