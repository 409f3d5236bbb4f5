"""Settings, probes, seeds, tissues and attenuation maps at the ends of their allowed ranges."""

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
_BETWEEN_GEL = Scene((slab(SOFT, 60.0, 100.0),), GEL, "between gel")
_SPECKLE = Scene((), replace(SOFT, attenuation_db_cm_mhz=0.0), "speckle")
_ALL_ONE: dict[str, Any] = {"rays": 1, "scanlines": 1, "axial_samples": 1, "layers": 1, "image_shape": (1, 1)}
LINES = 64
SAMPLES = 3072
SPACING_MM = 150 / SAMPLES
STIFF_DB_MM = 1e4 * 8 / 10  # the largest attenuation allowed, at 8 MHz
SOFT_DB_MM = 0.5 * 8 / 10


_WILD = replace(
    HARD, name="wild", roughness=10.0, thickness_mm=100.0, specularity=1e6, texture_contrast_db=40.0,
    texture_mm=(1e-3, 1e6, 1.0), scatterer_mean=1e3, scatterer_sd=1e3,
)  # fmt: skip


@case("surfaces and textures at their wildest", Scene((slab(_WILD, 40.0, 50.0),), SOFT, "wild"), {"rays": (8,)})
@case("scatterers 300 dB under and 100 dB over a mirror", BODY, {"scatterer_level_db": (-300.0, 100.0)})
@case("lattices of a nanometre and of a metre", _SPECKLE, {"scatterer_pitch_mm": (1e-6, 1e3)})
@case(
    "an aperture of a point and of two metres", BODY,
    {"aperture_mm": (0.0, 1e3), "elevational_aperture_mm": (1e3,), "layer_extent_mm": (1e3,)},
)  # fmt: skip
@case("a focus on the face and a kilometre away", BODY, {"focus_mm": (1e-3, 1e6), "focal_range_mm": (1e-3, 1e6)})
def _settings(checks: Checks, scene: Scene, tried: dict[str, tuple[Any, ...]]) -> None:
    """Any frame, with each of these values of the settings in turn."""
    for name, values in tried.items():
        for value in values:
            checks.render(scene, replace(SMALL, **{name: value}), label=f"{name} {value:g}")


@case("one ray, one line, one sample, one pixel")
def _ones(checks: Checks) -> None:
    """One of each, then one of all, on a probe of each kind."""
    kinds: dict[str, Probe] = {"": ConvexProbe(), "linear, ": LinearProbe(60.0, 150.0), "phased, ": PhasedProbe()}
    for kind, probe in kinds.items():
        for changes in (*({name: value} for name, value in _ALL_ONE.items()), _ALL_ONE):
            label = ", ".join(f"{name} {value}" for name, value in changes.items())
            checks.render(BODY, replace(SMALL, **changes), probe, label=kind + label)


@case("fans and faces of every shape")
def _probes(checks: Checks) -> None:
    """Fans of 0.001 and 179 degrees, a point and a flat array as the face, depths of 1 um and 100 m; other arrays."""
    convex = {"fov_deg": (1e-3, 179.0), "radius_mm": (1e-6,), "depth_mm": (1e-3, 1e5)}
    probes: dict[str, Probe] = {f"{n} {v:g}": ConvexProbe(**{n: v}) for n, values in convex.items() for v in values}
    probes["radius_mm 1e+06"] = ConvexProbe(radius_mm=1e6, fov_deg=1e-3)
    probes |= {f"linear, {width:g} mm wide": LinearProbe(width, 100.0) for width in (1e-3, 1e4)}
    for aperture, degrees in ((1e-3, 80.0), (500.0, 80.0), (20.0, 170.0)):
        probes[f"phased, {aperture:g} mm wide, {degrees:g} degrees"] = PhasedProbe(aperture, degrees)
    for label, probe in probes.items():
        checks.render(BODY, SMALL, probe, label=label)


@case("time gain and dynamic range beyond float32")
def _display(checks: Checks) -> None:
    """Gains of 240,000 and 2,400 dB, ranges of 1 and 800 dB: tissue is white and anechoic gel black, never NaN."""
    tried: dict[str, tuple[Any, ...]] = {"tgc_db_cm_mhz": (1e3, 10.0), "dynamic_range_db": (800.0,)}
    for name, values in tried.items():
        for value in values:
            settings = replace(SMALL, noise_level_db=-1e3, **{name: value})
            for frame in checks.frames(_BETWEEN_GEL, settings, label=f"{name} {value:g}"):
                if name == "tgc_db_cm_mhz":
                    grey = frame.image[frame.segmentation == 2] < 255
                    checks.none("tissue that is not white", grey, "Its level is above the range.")
                gel = frame.image[:40][frame.mask[:40]].max()  # above the tissue
                checks.add("grey level of gel", gel, 0, "A gain does not change 0, which is below any dynamic range.")
    levels = {"dynamic_range_db": (1.0,), "noise_level_db": (0.0, -1e3), "reference_level": (1e-12,)}
    _settings(checks, _BETWEEN_GEL, levels)


@case("pulses of a nanometre and of a metre")
def _pulses(checks: Checks) -> None:
    """Pulses and beams of a nanometre and of a metre; the power of speckle stays that of its scatterers."""
    power = 10 ** (SMALL.scatterer_level_db / 10) * _SPECKLE.background.scatter_power
    thin = replace(SMALL, axial_fwhm_mm=1e-6)
    cells = thin.scanlines * thin.axial_samples / 4  # a beam is at most four lines wide
    for frame in checks.frames(_SPECKLE, thin, label="axial_fwhm_mm 1e-06"):
        error = abs((frame.envelope.astype(float) ** 2).mean() / power - 1)
        why = "Five standard errors; the deviation of a cell's power is its mean."
        checks.add("power of speckle, relative", error, 5 / np.sqrt(cells), why)
    widths = {"lateral_fwhm_mm": (1e-6, 1e3), "elevational_fwhm_mm": (1e-6, 1e3)}
    _settings(checks, _SPECKLE, {"axial_fwhm_mm": (1e3,), **widths})


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
