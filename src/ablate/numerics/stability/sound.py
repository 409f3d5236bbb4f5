"""Attenuation of thousands of decibels, steps of impedance, total reflection and endless reverberation."""

import warnings
from dataclasses import replace

import numpy as np
import trimesh

from ablate.anatomy import Scene, Structure, Tissue
from ablate.numerics.stability.checks import AHEAD, FLOAT32, GEL, PROBE, SMALL, SOFT, Checks, case, moved, slab
from ablate.ultrasound import ConvexProbe, Frame, SimulatorSettings
from ablate.ultrasound.imaging.point_spread import axial_kernel
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.transport.lines import NODES
from ablate.ultrasound.transport.scattering import pressure_reflection, refracted, transmission_cosine

BONE = Tissue("bone", 3200, 7.8, 40.0, 0.6, 0.0, 1.0, roughness=0.0)
GAS = Tissue("gas", 330, 4e-4, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
PENCIL = ConvexProbe(fov_deg=0.002, frequency_mhz=3.0)
#: One scanline along its axis.
ONE_LINE = SimulatorSettings(
    scanlines=1, axial_samples=1024, rays=8, layers=1, image_shape=(64, 89), axial_fwhm_mm=1.2,
    noise_level_db=-300.0, tgc_db_cm_mhz=0.0, aperture_mm=0.0, elevational_aperture_mm=0.0,
)  # fmt: skip


@case("bone of 40 dB/cm/MHz across 150 mm")
def _losses(checks: Checks) -> None:
    """Bone fills the fan: 320 dB/cm, or 4800 dB one way to the end of the image."""
    pulse_mm = 0.3
    settings = replace(SMALL, axial_samples=3072, axial_fwhm_mm=pulse_mm)
    depth_cm = sample_depths_mm(PROBE, settings.axial_samples) / 10
    near = depth_cm < 0.5  # 320 dB two-way; squares of float32 underflow beyond 440 dB
    grains = settings.scanlines / 4 * 5 / pulse_mm  # near the face a beam is four lines wide
    for frame in checks.frames(Scene((), BONE, "bone"), settings):
        error = abs(_slope(frame, depth_cm, near) / (-2 * 40 * 8) - 1)
        bound = 4 * 5.57 * np.sqrt(12 / grains) / 320
        why = "Four standard errors of a slope over 320 dB, fitted to log speckle (5.57 dB a speckle cell)."
        checks.add("slope of the envelope against 2 alpha f, relative", error, bound, why)
        checks.add("largest sample beyond 600 dB", frame.envelope[depth_cm > 1].max(), 0, "Float32 is 0 there.")
        column = frame.attenuation[:, 138]
        rise = np.diff(column[column > 0], prepend=np.float32(1)).max()
        checks.add("rise of A along a line", rise, 0, "Attenuation only grows with depth.")


def _slope(frame: Frame, depth_cm: np.ndarray, part: np.ndarray | slice) -> float:
    """Fit the slope of the envelope in a range of depths, dB/cm."""
    level_db = 20 * np.log10(frame.envelope[part].astype(float)).mean(axis=1)
    return float(np.polyfit(depth_cm[part], level_db, 1)[0])


@case("a faint step, which turns no ray", 1.63, 1.70)
@case("an impedance step of 1 to 20000", 8.0, 4e-4)
@case("an impedance step of 20000 to 1", 4e-4, 8.0)
@case("air behind soft tissue", 1.63, 4e-4)
def _step(checks: Checks, z1: float, z2: float) -> None:
    """A surface between two impedances at normal incidence: reflected and transmitted energy add up to 1."""
    r = (z2 - z1) / (z2 + z1)
    before, behind = (Tissue(n, 1540, z, 0.0, 0.6, 0.0, 1.0, roughness=0.0) for n, z in (("a", z1), ("b", z2)))
    anechoic_before, anechoic_behind = (replace(t, scatterer_density=0.0) for t in (before, behind))
    alike = replace(behind, impedance_mrayl=z1)
    transmitted, unchanged, echo = (
        checks.both(Scene((slab(far, 50.0, 200.0),), near, "step"), ONE_LINE, PENCIL)
        for near, far in ((before, behind), (before, alike), (anechoic_before, anechoic_behind))
    )
    checks.any_frame(transmitted, ONE_LINE, PENCIL)
    pulse = axial_kernel(PENCIL, ONE_LINE)
    for checks.dtype in transmitted:
        on, free = (frames[checks.dtype].envelope[500:1000].sum(dtype=float) for frames in (transmitted, unchanged))
        back = echo[checks.dtype].envelope.sum(dtype=float) / pulse.sum()
        why = "Impedances and sums over the pulse are rounded."
        checks.add("amplitude of the echo against |R|", abs(back - abs(r)), (len(pulse) + 4) * FLOAT32, why)
        why = "A direct ray keeps exactly 1 - R of its weight; float32 sums over samples are rounded."
        checks.add("energy gone or gained, |R^2 + T - 1|", abs(back**2 + on / free - 1), 1e-5, why)


@case("grazing incidence, by the formulas")
def _angles(checks: Checks) -> None:
    """All angles up to 1e-7 degrees from grazing, for four pairs of media, by the compiled formulas."""
    angles = np.radians(90 - np.concatenate([np.linspace(0, 90, 2001)[1:], np.logspace(-7, 0, 200)]))
    pairs = (1.5, 1540, 7.8, 3200), (7.8, 3200, 1.5, 1540), (1.63, 1540, 4e-4, 330), (4e-4, 330, 8, 5000)
    for z1, c1, z2, c2 in pairs:
        rows = np.array([_at(np.cos(a), z1, c1, z2, c2) for a in angles])
        rounded = np.array([_at(np.cos(a), *np.array((z1, c1, z2, c2), np.float32).tolist()) for a in angles])
        checks.label = f"Z {z1:g} to {z2:g}"
        why = "R and T come from independent formulas; both are smooth in double precision."
        checks.add("|R + T - 1|", np.abs(rows[:, 1] - 1).max(), 1e-12, why)
        why = "Refraction changes a direction and keeps its length."
        checks.add("length of the refracted direction", np.abs(rows[:, 2] - 1).max(), 1e-12, why)
        critical = np.sqrt(max(1 - (c1 / c2) ** 2, 0)) or 1e-9
        steepest = 2 * z1 / (z2 * critical) if c2 > c1 else 1.0
        bound = steepest * 2 * np.sqrt(8 * FLOAT32) if c2 > c1 else 16 * FLOAT32
        why = (
            "Four values of the media are rounded. Near total reflection cos t is the root of a difference of rounded "
            "numbers, and R changes by 2 Z1 / (Z2 cos i) times its error."
        )
        checks.add("R of rounded media against exact ones", np.abs(rounded - rows)[:, 0].max(), bound, why, "float32")


def _at(cos_i: float, z1: float, c1: float, z2: float, c2: float) -> tuple[float, float, float]:
    """Compute R_p, R + T and the length of the refracted direction (1 where there is none)."""
    cos_t = transmission_cosine(cos_i, c1, c2)
    r = pressure_reflection(z1, z2, cos_i, cos_t)
    t = 2 * z2 * cos_i / (z2 * cos_i + z1 * cos_t)
    energy = r * r + t * t * z1 * cos_t / (z2 * cos_i)
    if cos_t == 0:
        return r, energy, 1.0
    onward = refracted((float(np.sqrt(1 - cos_i**2)), 0.0, cos_i), (0.0, 0.0, -1.0), cos_i, cos_t, c2 / c1)
    return r, energy, float(np.linalg.norm(onward))


@case("total reflection")
def _total_reflection(checks: Checks) -> None:
    """Incidence at 40 degrees on a medium whose speed of sound is 1.7 times larger: nothing is transmitted."""
    fast = Tissue("fast", 2600, 4.5, 0.0, 0.6, 0.0, 1.0, roughness=0.0, specularity=0.0)
    pose = moved(tilt_deg=40)
    settings = replace(ONE_LINE, rays=64)
    gel = slab(replace(GEL, specularity=0.0), -500.0, 30.0, 2000.0)  # its echo is received from any angle
    echoes = checks.both(Scene((gel,), replace(fast, scatterer_density=0.0), "total"), settings, PENCIL, pose)
    pulse = axial_kernel(PENCIL, settings)
    beyond_mm = 30 / np.cos(np.radians(40)) + 150 / NODES + len(pulse) / 2 * 150 / settings.axial_samples
    beyond = sample_depths_mm(PENCIL, settings.axial_samples) > beyond_mm
    for frame in checks.frames(Scene((gel,), fast, "total"), settings, PENCIL, pose):
        echo = echoes[checks.dtype].envelope.sum(dtype=float) / pulse.sum()
        why = "All energy is reflected; the sum over the pulse is rounded."
        checks.add("amplitude of the echo against 1", abs(echo - 1), (len(pulse) + 4) * FLOAT32, why)
        why = "No ray crosses the surface; insonification is stored at 256 depths."
        checks.add("amplitude a node beyond the face", frame.envelope[beyond].max(), 0, why)


@case("grazing incidence, scanlines along a face")
def _grazing(checks: Checks) -> None:
    """Scanlines along a surface and 1e-6 and 0.1 degrees off it; a surface and a sphere that touch the probe's face."""
    hard = Tissue("hard", 2600, 4.5, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
    for tilt, z in ((90.0, 50.0), (90 - 1e-6, 50.0), (89.9, 49.9), (0.0, 50.0)):
        scene = Scene((slab(hard, 50.0, 100.0),), SOFT, "grazing")
        checks.render(scene, pose=moved(z_mm=z, tilt_deg=tilt), label=f"{90 - tilt:g} degrees off")
    sphere = trimesh.creation.icosphere(5, PROBE.radius_mm).apply_translation((0, 0, -PROBE.radius_mm))
    checks.render(Scene((Structure(sphere, hard),), SOFT, "sphere"), label="sphere")


@case("a closed cavity with R near 1")
def _cavity(checks: Checks) -> None:
    """Gel between two walls of gas that are 10 mm apart, R = 0.998: there is an echo every 5 mm, without end."""
    scene = Scene((slab(GAS, -200.0, 300.0), slab(GEL, -5.0, 5.0)), GEL, "cavity")
    settings = replace(ONE_LINE, scanlines=128, rays=256, lateral_fwhm_mm=1e-6, noise_level_db=-120.0)
    shown = [checks.both(scene, replace(settings, path_seed=seed), PENCIL) for seed in range(6)]
    checks.any_frame(shown[0], settings, PENCIL)
    depth = sample_depths_mm(PENCIL, settings.axial_samples)
    pulse = axial_kernel(PENCIL, settings).sum()
    periods = [(depth > begin) & (depth <= begin + 10) for begin in np.arange(12.5, 52.5, 10)]
    wall = abs((GAS.impedance_mrayl - GEL.impedance_mrayl) / (GAS.impedance_mrayl + GEL.impedance_mrayl))
    # A period of 10 mm holds two echoes of random phase; those of the k-th have met 2 k + 1 and 2 k + 2 walls.
    right = np.array([np.sqrt(np.pi) / 2 * (wall ** (2 * k + 1) + wall ** (2 * k + 2)) for k in range(1, 5)])
    for checks.dtype in shown[0]:
        lines = [frames[checks.dtype].envelope.mean(axis=1, dtype=float) / pulse for frames in shown]
        amplitude = np.array([[line[period].sum() for period in periods] for line in lines])
        deviation = amplitude.std(axis=0, ddof=1) / np.sqrt(len(shown))
        error = (abs(amplitude.mean(axis=0) - right) / deviation).max()
        why = "Roulette is unbiased; Student's t of 6 path seeds exceeds 6 at one of four depths once in 140 trials."
        checks.add("mean echo against R^k, in standard errors", error, 6, why)


@case("zero attenuation")
def _no_loss(checks: Checks) -> None:
    """Tissue without attenuation: A is 1, and speckle has the same level at all depths."""
    depth_cm = sample_depths_mm(PROBE, SMALL.axial_samples) / 10
    grains = 64 * 1024 / 8 / 2  # a pulse is 8 samples long, a beam at least two lines wide
    for frame in checks.frames(Scene((), replace(SOFT, attenuation_db_cm_mhz=0.0), "lossless")):
        least = float(frame.attenuation[frame.mask].min())
        checks.add("1 - A", 1 - least, 2 * FLOAT32, "The weights of a pixel sum to 1.")
        error = abs(_slope(frame, depth_cm, slice(20, -20)))
        bound = 4 * 5.57 * np.sqrt(12 / grains) / 15
        why = "Four standard errors of a slope, fitted to log speckle (5.57 dB a speckle cell)."
        checks.add("slope of the envelope, dB/cm", error, bound, why)


@case("zero scatterers")
def _anechoic(checks: Checks) -> None:
    """Tissue without scatterers, or with hardly any: the image shows only the noise of the display."""
    for label, tissue in (
        ("density 0", replace(SOFT, scatterer_density=0.0)),
        ("variance 0", replace(SOFT, scatterer_density=1.0, scatterer_mean=1.0, scatterer_sd=0.0)),
        ("density 1e-9", replace(SOFT, scatterer_density=1e-9)),
        ("deviation 1e-112", replace(SOFT, scatterer_sd=1e-112)),
    ):
        for frame in checks.frames(Scene((slab(tissue, 10.0, 100.0),), tissue, "anechoic"), label=label):
            checks.add("largest sample", frame.envelope.max(), 0, "There is no scatterer.")


@case("scatterers of large mean and little variance")
def _steady(checks: Checks) -> None:
    """Scatterers whose mean is a million times their deviation: the mean gives no speckle."""
    steady = replace(SOFT, scatterer_density=1.0, scatterer_mean=1e3, scatterer_sd=1e-3)
    plain = checks.both(Scene((), replace(steady, scatterer_mean=0.0), "plain"))
    frames = checks.both(Scene((), steady, "steady"))
    for checks.dtype, frame in frames.items():
        why = "Speckle is made from s - E s, which does not depend on the mean."
        checks.same_envelope("against scatterers of mean 0, of the largest", frame, plain[checks.dtype], why)


_IN_BONE = Scene((slab(BONE, -50.0, 200.0, 600.0),), GEL, "bone")
_BESIDE = Scene((slab(SOFT, -50.0, -10.0),), GEL, "past")


@case("a fan entirely outside the scene", _BESIDE, moved(z_mm=200.0), "looks past the scene")
@case("a fan entirely in bone", _IN_BONE, AHEAD, "bone")
@case("a fan entirely in gel", Scene((), GEL, "gel"), AHEAD, None)
def _uniform(checks: Checks, scene: Scene, pose: np.ndarray, words: str | None) -> None:
    """The fan lies in one medium; a warning tells of a medium that the probe cannot see through."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        frames = checks.both(scene, pose=pose)
    checks.any_frame(frames, SMALL)
    told_right = sum(words in str(w.message) for w in told) if words else 2 - len(told)
    checks.add("warnings missing or too many", abs(2 - told_right), 0, "Each simulator warns once.")
    for checks.dtype, frame in frames.items():
        labels = np.unique(frame.segmentation[frame.mask])
        checks.add("labels besides the one", len(labels) - 1, 0, "The fan holds one medium.")
