"""Settings, probes, seeds, tissues and attenuation maps at the ends of their allowed ranges."""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ablate.anatomy import Scene, Tissue
from ablate.numerics.stability.checks import AHEAD, FLOAT32, GEL, SMALL, SOFT, Checks, case, off, slab
from ablate.ultrasound import ConvexProbe, DepthMode, Frame, LinearProbe, PhasedProbe, Probe, Simulator
from ablate.ultrasound.attenuation import DB_PER_NEPER, integral_attenuation
from ablate.ultrasound.imaging.bmode import ScanConverter
from ablate.ultrasound.probe import sample_depths_mm

HARD = Tissue("hard", 2600, 4.2, 3.0, 0.6, 0.0, 0.2, roughness=0.05, thickness_mm=0.2)
BODY = Scene((slab(SOFT, 3.0, 120.0), slab(HARD, 40.0, 50.0, 30.0)), GEL, "body")
_BETWEEN_GEL = Scene((slab(SOFT, 60.0, 100.0),), GEL, "between gel")
_SPECKLE = Scene((), replace(SOFT, attenuation_db_cm_mhz=0.0), "speckle")
_ALL_ONE: dict[str, Any] = {"rays": 1, "scanlines": 1, "axial_samples": 1, "layers": 1, "image_shape": (1, 1)}
LINES, SAMPLES, SPACING_MM = 64, 3072, 150 / 3072
STIFF_DB_MM = 1e4 * 8 / 10  # the largest attenuation allowed, at 8 MHz
SOFT_DB_MM = 0.5 * 8 / 10


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
    """Any frame with one of each, then with one of all; then with one of each on a linear and on a phased probe."""
    kinds: dict[str, Probe] = {"": ConvexProbe(), "linear, ": LinearProbe(60.0, 150.0), "phased, ": PhasedProbe()}
    for kind, probe in kinds.items():
        for changes in (*({name: value} for name, value in _ALL_ONE.items()), _ALL_ONE):
            label = ", ".join(f"{name} {value}" for name, value in changes.items())
            checks.render(BODY, replace(SMALL, **changes), probe, label=kind + label)


@case("rays to a tolerance, on one line or in one layer")
def _few_to_judge(checks: Checks) -> None:
    """The error of a line is judged by its neighbours, of which there are few or none."""
    for lines, layers in ((1, 1), (1, 3), (2, 1)):
        settings = replace(SMALL, scanlines=lines, layers=layers, rays=64, tolerance=0.1)
        checks.render(BODY, settings, label=f"{lines} lines, {layers} layers")


@case("fans and faces of every shape")
def _probes(checks: Checks) -> None:
    """Fans of 0.001 and 179 degrees, a point and a flat array as the face, depths of 1 um and 100 m; other arrays."""
    fans = ConvexProbe(fov_deg=1e-3), ConvexProbe(fov_deg=179.0)
    faces = ConvexProbe(radius_mm=1e-6), ConvexProbe(radius_mm=1e6, fov_deg=1e-3)
    for probe in (*fans, *faces, ConvexProbe(depth_mm=1e-3), ConvexProbe(depth_mm=1e5)):
        label = f"{probe.fov_deg:g} degrees, radius {probe.radius_mm:g} mm, depth {probe.depth_mm:g} mm"
        checks.render(BODY, SMALL, probe, label=label)
    for width in (1e-3, 1e4):
        checks.render(BODY, SMALL, LinearProbe(width, 100.0), label=f"linear, {width:g} mm wide")
    for aperture, degrees in ((1e-3, 80.0), (500.0, 80.0), (20.0, 170.0)):
        label = f"phased, {aperture:g} mm wide, {degrees:g} degrees"
        checks.render(BODY, SMALL, PhasedProbe(aperture, degrees), label=label)


@case("time gain beyond float32")
def _gain(checks: Checks) -> None:
    """Time gains of 240,000 and 2,400 dB: tissue is white and anechoic gel black, never NaN."""
    for tgc in (1e3, 10.0):
        settings = replace(SMALL, tgc_db_cm_mhz=tgc, noise_floor_db=-1e3)
        for frame in checks.frames(_BETWEEN_GEL, settings, label=f"tgc {tgc:g}"):
            grey = frame.image[frame.segmentation == 2] < 255
            checks.none("tissue that is not white", grey, "Its level is above the range.")
            checks.add("grey level of gel", _level_of_gel(frame), 0, "A gain does not change 0.")


@case("dynamic ranges of 1 and 800 dB")
def _display(checks: Checks) -> None:
    """Dynamic ranges of 1 and 800 dB, with noise at full level and without noise."""
    levels: dict[str, tuple[Any, ...]] = {"noise_floor_db": (0.0, -1e3), "reference_level": (1e-12,)}
    _settings(checks, _BETWEEN_GEL, {"dynamic_range_db": (1.0,), **levels})
    settings = replace(SMALL, dynamic_range_db=800.0, noise_floor_db=-1e3)
    for frame in checks.frames(_BETWEEN_GEL, settings, label="dynamic_range_db 800"):
        checks.add("grey level of gel", _level_of_gel(frame), 0, "0 is below any dynamic range.")


def _level_of_gel(frame: Frame) -> float:
    """Find the largest grey level in the anechoic gel above the tissue."""
    return float(frame.image[:40][frame.mask[:40]].max())


@case("a hertz and a gigahertz")
def _frequencies(checks: Checks) -> None:
    """1 Hz and 1 GHz in a tissue whose attenuation grows with the fourth power of frequency: 0 and 10^16 dB/cm."""
    steep = replace(SOFT, name="steep", attenuation_db_cm_mhz=1e4, attenuation_power=4.0)
    scene = Scene((slab(steep, 60.0, 80.0),), SOFT, "steep")
    for frequency in (1e-6, 1e3):
        probe = ConvexProbe(frequency_mhz=frequency)
        for frame in checks.frames(scene, SMALL, probe, label=f"{frequency:g} MHz"):
            column = frame.attenuation[frame.mask[:, 138], 138]
            rise = np.diff(column, prepend=np.float32(1)).max()
            checks.add("rise of A along a line", rise, 0, "Attenuation only grows.")


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


@case("travel times at 1 and 100000 m/s")
def _travel_times(checks: Checks) -> None:
    """Layers with speeds of 1 and 100,000 m/s, displayed at travel times."""
    settings = replace(
        SMALL, depth_mode=DepthMode.time_of_flight, aperture_mm=0.0, elevational_aperture_mm=0.0, layers=1, scanlines=8,
        lateral_fwhm_mm=1e-6, noise_floor_db=-100.0,
    )  # fmt: skip
    pencil = ConvexProbe(fov_deg=0.002)
    spacing, z = pencil.depth_mm / settings.axial_samples, sample_depths_mm(pencil, settings.axial_samples)
    around = Tissue("around", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
    for speed, thick_mm in ((1.0, 0.05), (1e5, 1000.0)):
        layer = replace(around, name="layer", speed_m_s=speed, impedance_mrayl=1.6)
        scene = Scene((slab(layer, 30.0, 30.0 + thick_mm),), around, "layer")
        for frame in checks.frames(scene, settings, pencil, label=f"{speed:g} m/s"):
            line = np.where(z > 35, frame.envelope[:, 4], 0)  # beyond the near face's pulse
            error = abs(z[line.argmax()] - (30 + thick_mm * 1540 / speed))
            why = "An echo is divided between two samples; 1e-2 mm is 1540 times the step of a ray beyond a surface."
            checks.add("depth of the far face, mm", error, spacing + 1e-2, why)


@case("seeds at the ends of int64 and beyond")
def _seeds(checks: Checks) -> None:
    """Seeds at the ends of int64 and far beyond: the speckle of different seeds is not correlated."""
    seeds, shown = (0, 2**31, 2**63 - 1, 2**64 + 5, 10**30), []
    for seed in seeds:
        settings = replace(SMALL, path_seed=seed)
        shown.append(checks.both(_SPECKLE, settings, seed=seed))
        checks.label = f"seed {float(seed):.3g}"
        checks.any_frame(shown[-1], settings)
    checks.label = ""
    for checks.dtype in ("float32", "float64"):
        lines = np.array([frames[checks.dtype].envelope[::16, ::4].ravel() for frames in shown], float)
        alike = np.abs(np.corrcoef(lines) - np.eye(len(seeds))).max()
        why = "Five standard errors of a correlation; samples are a pulse and a beam apart."
        checks.add("correlation of the speckle of two seeds", alike, 5 / np.sqrt(lines.shape[1]), why)


@case("surfaces and textures at their wildest")
def _tissues(checks: Checks) -> None:
    """The largest roughness, thickness, specularity and texture."""
    wild = replace(
        HARD, name="wild", roughness=10.0, thickness_mm=100.0, specularity=1e6, texture_contrast_db=40.0,
        texture_mm=(1e-3, 1e6, 1.0), scatterer_mean=1e3, scatterer_sd=1e3,
    )  # fmt: skip
    checks.render(Scene((slab(wild, 40.0, 50.0),), SOFT, "wild"))


def in_double(labels: np.ndarray, losses_db_mm: np.ndarray) -> tuple[np.ndarray, float]:
    """Compute A by its definition, with NumPy's percentile, and the attenuation at that percentile, Np."""
    total = np.cumsum((losses_db_mm * SPACING_MM / DB_PER_NEPER)[labels], axis=1)
    about = float(np.sort(total, axis=None)[int(0.02 * (total.size - 1))])  # e^-3000 would be 0, and e^3000 infinite
    amplitude = np.exp(np.minimum(about - total, 700))
    scale = np.percentile(amplitude, 98)
    return np.minimum(amplitude / scale, 1), about - float(np.log(scale))


def _against_double(checks: Checks, labels: np.ndarray, losses_db_mm: np.ndarray) -> None:
    """Compare A with its definition in double precision."""
    checks.dtype = "float32"
    computed = integral_attenuation(labels, losses_db_mm, SPACING_MM)
    right, scale = in_double(labels, losses_db_mm)
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


@case("A: thousands of decibels")
def _stiff(checks: Checks) -> None:
    """Bone of 40 dB/cm/MHz everywhere: 4800 dB."""
    _against_double(checks, np.zeros((LINES, SAMPLES), np.uint8), np.array([40 * 8 / 10]))


@case("A: losses over six decades")
def _decades(checks: Checks) -> None:
    """Layers of random tissues whose attenuations span six decades."""
    random = np.random.default_rng(0)
    labels = random.integers(0, 7, (LINES, 24)).astype(np.uint8).repeat(128, axis=1)
    _against_double(checks, labels, np.logspace(-4, 2, 7) * SOFT_DB_MM / 10)


@case("A: soft tissue behind 2200 dB")
def _shadowed(checks: Checks) -> None:
    """Soft tissue behind 2.8 mm of 800 dB/mm: its own attenuation must not be rounded away."""
    labels = np.zeros((LINES, SAMPLES), np.uint8)
    labels[:, : round(2.8 / SPACING_MM)] = 1
    _against_double(checks, labels, np.array([SOFT_DB_MM, STIFF_DB_MM]))


@case("A: no loss, and next to none")
def _lossless(checks: Checks) -> None:
    """No attenuation, and 10^-12 dB/mm."""
    for loss in (0.0, 1e-12):
        computed = integral_attenuation(np.zeros((LINES, SAMPLES), np.uint8), np.array([loss]), SPACING_MM)
        checks.add(f"{loss:g} dB/mm: 1 - A", 1 - computed.min(), FLOAT32, "Float32 rounds this to 1.", "float32")


@case("A: one line, one sample")
def _few(checks: Checks) -> None:
    """One scanline, one sample, and one of both, in soft tissue and with the largest attenuation."""
    for lines, samples in ((1, SAMPLES), (LINES, 1), (1, 1), (1, 2)):
        for name, loss in (("soft", SOFT_DB_MM), ("stiff", STIFF_DB_MM)):
            checks.label = f"{lines} x {samples}, {name}"
            _against_double(checks, np.zeros((lines, samples), np.uint8), np.array([loss]))


@case("scan conversion of steps and of the largest float32")
def _conversion(checks: Checks) -> None:
    """Scan conversion of a constant, of a step, and of scanlines alternating between 0 and 8e37."""
    probe, settings = ConvexProbe(), replace(SMALL, axial_samples=SAMPLES, device=checks.device)
    checks.dtype = "float32"

    def pixels(lines: np.ndarray, dtype: torch.dtype = torch.float32) -> np.ndarray:
        convert = ScanConverter(probe, settings, dtype)
        return convert(torch.from_numpy(lines).to(checks.device, dtype))[convert.mask]

    why = "The weights of four neighbours sum to 1."
    checks.add("a constant against itself", off(pixels(np.ones((LINES, SAMPLES))), 1.0), 4 * FLOAT32, why)
    step, largest = np.zeros((2, LINES, SAMPLES))
    step[:, SAMPLES // 2 :] = 1
    error = off(pixels(step), pixels(step, torch.float64))
    why = "The position of a pixel among n samples is rounded by n 2^-23 samples, and a step changes by 1 a sample."
    checks.add("a step against float64", error, (SAMPLES + LINES) * 2 * FLOAT32, why)
    largest[::2] = float(np.finfo(np.float32).max) / 4
    image = pixels(largest)
    checks.finite(image, what="pixels between 0 and 8e37")
    overshoot = image.max() / largest.max() - 1
    checks.add("overshoot, relative", overshoot, 4 * FLOAT32, "A mean does not exceed its values.")


@case("images of a pixel, a row and a column")
def _one_row(checks: Checks) -> None:
    """Images of one pixel, one row and one column, and a fan so thin that it holds no pixel's centre."""
    scene, checks.dtype = Scene((slab(SOFT, 40.0, 60.0),), SOFT, "layer"), "float32"
    for shape, depth_mm in (((1, 1), 150.0), ((1, 277), 150.0), ((200, 1), 150.0), ((1, 1), 1e-6)):
        probe = ConvexProbe(depth_mm=depth_mm)
        simulator = Simulator(scene, probe, replace(SMALL, image_shape=shape, device=checks.device))
        labels, attenuation = simulator.maps(AHEAD)
        checks.label, outside = f"{shape[0]} x {shape[1]}, {depth_mm:g} mm deep", ~simulator.mask
        checks.finite(attenuation, what="pixels of A")
        wrong = ((labels == 0) != outside).sum() + np.count_nonzero(attenuation[outside])
        checks.add("pixels of the fan that are wrong", wrong, 0, "S and A are 0 outside the fan.")
