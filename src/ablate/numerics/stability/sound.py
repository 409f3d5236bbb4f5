"""Attenuation of thousands of decibels, steps of impedance, total reflection and endless reverberation."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from ablate.anatomy import Scene, Tissue
from ablate.numerics.stability.checks import FLOAT32, Case, Check
from ablate.numerics.stability.frames import (
    AHEAD,
    GEL,
    ONE_LINE,
    PROBE,
    SMALL,
    SOFT,
    any_frame,
    both,
    checked_frames,
    moved,
    products,
    slab,
)
from ablate.ultrasound import ConvexProbe, Frame
from ablate.ultrasound.imaging.point_spread import axial_kernel
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.transport.illumination import NODES
from ablate.ultrasound.transport.interfaces import pressure_reflection, refracted, transmission_cosine

BONE = Tissue("bone", 3200, 7.8, 40.0, 0.6, 0.0, 1.0, roughness=0.0)
GAS = Tissue("gas", 330, 4e-4, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
PENCIL = ConvexProbe(fov_deg=0.002, frequency_mhz=3.0)


def _losses(device: str) -> Iterator[Check]:
    """Bone fills the fan: 320 dB/cm, or 4800 dB one way to the end of the image."""
    settings = replace(SMALL, axial_samples=3072, axial_fwhm_mm=0.3)
    frames = yield from checked_frames(Scene((), BONE, "bone"), settings, device)
    depth_cm = sample_depths_mm(PROBE, settings.axial_samples) / 10
    near = depth_cm < 0.5  # 320 dB two-way; squares of float32 underflow beyond 440 dB
    grains = settings.scanlines / 4 * 5 / settings.axial_fwhm_mm  # near the face a beam is four lines wide
    for dtype, frame in frames.items():
        error, bound = abs(_slope(frame, depth_cm, near) / (-2 * 40 * 8) - 1), 4 * 5.57 * np.sqrt(12 / grains) / 320
        why = "Four standard errors of a slope over 320 dB, fitted to log speckle (5.57 dB a speckle cell)."
        yield Check(dtype, "slope of the envelope against 2 alpha f, relative", error, bound, why)
        deepest = float(frame.envelope[depth_cm > 1].max())
        yield Check(dtype, "largest sample beyond 600 dB", deepest, 0, "Float32 is 0 there.")
        column = frame.attenuation[:, 138]
        rise = np.diff(column[column > 0], prepend=np.float32(1)).max()
        yield Check(dtype, "rise of A along a line", float(rise), 0, "Attenuation only grows with depth.")


def _slope(frame: Frame, depth_cm: np.ndarray, part: np.ndarray | slice) -> float:
    """Fit the slope of the envelope in a range of depths, dB/cm."""
    level_db = 20 * np.log10(frame.envelope[part].astype(float)).mean(axis=1)
    return float(np.polyfit(depth_cm[part], level_db, 1)[0])


def _step(z1: float, z2: float, device: str) -> Iterator[Check]:
    """A surface between two impedances at normal incidence: reflected and transmitted energy add up to 1."""
    r = (z2 - z1) / (z2 + z1)
    here, there = (Tissue(n, 1540, z, 0.0, 0.6, 0.0, 1.0, roughness=0.0) for n, z in (("a", z1), ("b", z2)))
    anechoic_here, anechoic_there = (replace(t, scatterer_density=0.0) for t in (here, there))
    alike = replace(there, impedance_mrayl=z1)
    transmitted, unchanged, echo = (
        both(Scene((slab(far, 50.0, 200.0),), near, "step"), ONE_LINE, device, PENCIL)
        for near, far in ((here, there), (here, alike), (anechoic_here, anechoic_there))
    )
    yield from any_frame(transmitted, ONE_LINE, PENCIL)
    pulse = axial_kernel(PENCIL, ONE_LINE)
    for dtype in transmitted:
        on, free = (frames[dtype].envelope[500:1000].sum(dtype=float) for frames in (transmitted, unchanged))
        back = echo[dtype].envelope.sum(dtype=float) / pulse.sum()
        why = "Impedances and sums over the pulse are rounded."
        yield Check(dtype, "amplitude of the echo against |R|", abs(back - abs(r)), (len(pulse) + 4) * FLOAT32, why)
        why = "A direct ray keeps exactly 1 - R of its weight; float32 sums over samples are rounded."
        yield Check(dtype, "energy gone or gained, |R^2 + T - 1|", abs(back**2 + on / free - 1), 1e-5, why)


def _angles(device: str) -> Iterator[Check]:  # noqa: ARG001
    """All angles up to 1e-7 degrees from grazing, for four pairs of media, by the compiled formulas."""
    angles = np.radians(90 - np.concatenate([np.linspace(0, 90, 2001)[1:], np.logspace(-7, 0, 200)]))
    pairs = (1.5, 1540, 7.8, 3200), (7.8, 3200, 1.5, 1540), (1.63, 1540, 4e-4, 330), (4e-4, 330, 8, 5000)
    for z1, c1, z2, c2 in pairs:
        rows = np.array([_at(np.cos(a), z1, c1, z2, c2) for a in angles])
        rounded = np.array([_at(np.cos(a), *np.array((z1, c1, z2, c2), np.float32).tolist()) for a in angles])
        label = f"Z {z1:g} to {z2:g}"
        why = "R and T come from independent formulas; both are smooth in double precision."
        yield Check("float64", f"{label}: |R + T - 1|", float(np.abs(rows[:, 1] - 1).max()), 1e-12, why)
        error = float(np.abs(rows[:, 2] - 1).max())
        why = "Refraction changes a direction and keeps its length."
        yield Check("float64", f"{label}: length of the refracted direction", error, 1e-12, why)
        critical = np.sqrt(max(1 - (c1 / c2) ** 2, 0)) or 1e-9
        steepest = 2 * z1 / (z2 * critical) if c2 > c1 else 1.0
        yield Check(
            "float32", f"{label}: R of rounded media against exact ones", float(np.abs(rounded - rows)[:, 0].max()),
            steepest * 2 * np.sqrt(8 * FLOAT32) if c2 > c1 else 16 * FLOAT32,
            "Four values of the media are rounded. Near total reflection cos t is the root of a difference of rounded "
            "numbers, and R changes by 2 Z1 / (Z2 cos i) times its error.",
        )  # fmt: skip


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


def _total_reflection(device: str) -> Iterator[Check]:
    """Incidence at 40 degrees on a medium whose speed of sound is 1.7 times larger: nothing is transmitted."""
    fast = Tissue("fast", 2600, 4.5, 0.0, 0.6, 0.0, 1.0, roughness=0.0, specularity=0.0)
    pose, settings = moved(tilt_deg=40), replace(ONE_LINE, rays=64)
    gel = slab(replace(GEL, specularity=0.0), -500.0, 30.0, 2000.0)  # its echo is received from any angle
    frames, echoes = (
        both(Scene((gel,), behind, "total"), settings, device, PENCIL, pose)
        for behind in (fast, replace(fast, scatterer_density=0.0))
    )
    yield from any_frame(frames, settings, PENCIL)
    pulse = axial_kernel(PENCIL, settings)
    beyond_mm = 30 / np.cos(np.radians(40)) + 150 / NODES + len(pulse) / 2 * 150 / settings.axial_samples
    beyond = sample_depths_mm(PENCIL, settings.axial_samples) > beyond_mm
    for dtype, frame in frames.items():
        echo = echoes[dtype].envelope.sum(dtype=float) / pulse.sum()
        why = "All energy is reflected; the sum over the pulse is rounded."
        yield Check(dtype, "amplitude of the echo against 1", abs(echo - 1), (len(pulse) + 4) * FLOAT32, why)
        why = "No ray crosses the surface; insonification is stored at 256 depths."
        yield Check(dtype, "amplitude a node beyond the face", float(frame.envelope[beyond].max()), 0, why)


def _grazing(device: str) -> Iterator[Check]:
    """Scanlines exactly along a surface, and 1e-6 and 0.1 degrees off it."""
    hard = Tissue("hard", 2600, 4.5, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
    scene = Scene((slab(hard, 50.0, 100.0, 300.0),), SOFT, "grazing")
    for tilt, z in ((90.0, 50.0), (90 - 1e-6, 50.0), (89.9, 49.9)):
        pose, label = moved(z_mm=z, tilt_deg=tilt), f"{90 - tilt:g} degrees off"
        yield from checked_frames(scene, SMALL, device, pose=pose, label=label)


def _cavity(device: str) -> Iterator[Check]:
    """Gel between two walls of gas that are 10 mm apart, R = 0.998: there is an echo every 5 mm, without end."""
    scene = Scene((slab(GAS, -200.0, 300.0), slab(GEL, -5.0, 5.0)), GEL, "cavity")
    settings = replace(ONE_LINE, scanlines=128, rays=256, lateral_fwhm_mm=1e-6, device=device, noise_floor_db=-100.0)
    shown = [both(scene, replace(settings, path_seed=seed), device, PENCIL) for seed in range(6)]
    yield from any_frame(shown[0], settings, PENCIL)
    depth, pulse = sample_depths_mm(PENCIL, settings.axial_samples), axial_kernel(PENCIL, settings).sum()
    periods = [(depth > begin) & (depth <= begin + 10) for begin in np.arange(12.5, 52.5, 10)]
    wall = abs((GAS.impedance_mrayl - GEL.impedance_mrayl) / (GAS.impedance_mrayl + GEL.impedance_mrayl))
    # A period of 10 mm holds two echoes of random phase; those of the k-th have met 2 k + 1 and 2 k + 2 walls.
    right = np.array([np.sqrt(np.pi) / 2 * (wall ** (2 * k + 1) + wall ** (2 * k + 2)) for k in range(1, 5)])
    for dtype in shown[0]:
        lines = [frames[dtype].envelope.mean(axis=1, dtype=float) / pulse for frames in shown]
        amplitude = np.array([[line[period].sum() for period in periods] for line in lines])
        deviation = amplitude.std(axis=0, ddof=1) / np.sqrt(len(shown))
        error = float((abs(amplitude.mean(axis=0) - right) / deviation).max())
        why = "Roulette is unbiased; Student's t of 6 path seeds exceeds 6 at one of four depths once in 140 trials."
        yield Check(dtype, "mean echo against R^k, in standard errors", error, 6, why)


def _no_loss(device: str) -> Iterator[Check]:
    """Tissue without attenuation: A is 1, and speckle has the same level at all depths."""
    scene = Scene((), replace(SOFT, attenuation_db_cm_mhz=0.0), "lossless")
    frames = yield from checked_frames(scene, SMALL, device)
    depth_cm = sample_depths_mm(PROBE, SMALL.axial_samples) / 10
    grains = 64 * 1024 / 8 / 2  # a pulse is 8 samples long, a beam at least two lines wide
    for dtype, frame in frames.items():
        least = float(frame.attenuation[frame.mask].min())
        yield Check(dtype, "1 - A", 1 - least, 2 * FLOAT32, "The weights of a pixel sum to 1.")
        error, bound = abs(_slope(frame, depth_cm, slice(20, -20))), 4 * 5.57 * np.sqrt(12 / grains) / 15
        why = "Four standard errors of a slope, fitted to log speckle (5.57 dB a speckle cell)."
        yield Check(dtype, "slope of the envelope, dB/cm", error, bound, why)


def _anechoic(device: str) -> Iterator[Check]:
    """Tissue without scatterers, or with hardly any: the image shows only the noise of the display."""
    for label, tissue in (
        ("density 0", replace(SOFT, scatterer_density=0.0)),
        ("variance 0", replace(SOFT, scatterer_density=1.0, scatterer_mean=1.0, scatterer_sd=0.0)),
        ("density 1e-9", replace(SOFT, scatterer_density=1e-9)),
        ("deviation 1e-112", replace(SOFT, scatterer_sd=1e-112)),
    ):
        scene = Scene((slab(tissue, 10.0, 100.0),), tissue, "anechoic")
        frames = yield from checked_frames(scene, SMALL, device, label=label)
        for dtype, frame in frames.items():
            yield Check(dtype, f"{label}: largest sample", float(frame.envelope.max()), 0, "There is no scatterer.")


def _steady(device: str) -> Iterator[Check]:
    """Scatterers whose mean is a million times their deviation: the mean gives no speckle."""
    steady = replace(SOFT, scatterer_density=1.0, scatterer_mean=1e3, scatterer_sd=1e-3)
    plain = both(Scene((), replace(steady, scatterer_mean=0.0), "plain"), SMALL, device)
    for dtype, frame in both(Scene((), steady, "steady"), SMALL, device).items():
        error = float(np.abs(frame.envelope - plain[dtype].envelope).max() / plain[dtype].envelope.max())
        bound = products(SMALL) ** 1.5 * FLOAT32
        why = "Speckle is made from s - E s, which does not depend on the mean."
        yield Check(dtype, "against scatterers of mean 0, of the largest", error, bound, why)


def _uniform(scene: Scene, pose: np.ndarray, words: str | None, device: str) -> Iterator[Check]:
    """The fan lies in one medium; a warning tells of a medium that the probe cannot see through."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        frames = both(scene, SMALL, device, pose=pose)
    yield from any_frame(frames, SMALL)
    told_right = sum(words in str(w.message) for w in told) if words else 2 - len(told)
    yield Check("float32", "warnings missing or too many", abs(2 - told_right), 0, "Each simulator warns once.")
    for dtype, frame in frames.items():
        labels = np.unique(frame.segmentation[frame.mask])
        yield Check(dtype, "labels besides the one", len(labels) - 1, 0, "The fan holds one medium.")


_IN_BONE = Scene((slab(BONE, -50.0, 200.0, 600.0),), GEL, "bone")
_BESIDE = Scene((slab(SOFT, -50.0, -10.0),), GEL, "past")
CASES = (
    Case("bone of 40 dB/cm/MHz across 150 mm", _losses),
    Case("air behind soft tissue", partial(_step, 1.63, 4e-4)),
    Case("an impedance step of 20000 to 1", partial(_step, 4e-4, 8.0)),
    Case("an impedance step of 1 to 20000", partial(_step, 8.0, 4e-4)),
    Case("a faint step, which turns no ray", partial(_step, 1.63, 1.70)),
    Case("grazing incidence, by the formulas", _angles),
    Case("total reflection", _total_reflection),
    Case("grazing incidence, scanlines along a face", _grazing),
    Case("a closed cavity with R near 1", _cavity),
    Case("zero attenuation", _no_loss),
    Case("zero scatterers", _anechoic),
    Case("scatterers of large mean and little variance", _steady),
    Case("a fan entirely in gel", partial(_uniform, Scene((), GEL, "gel"), AHEAD, None)),
    Case("a fan entirely in bone", partial(_uniform, _IN_BONE, AHEAD, "bone")),
    Case("a fan entirely outside the scene", partial(_uniform, _BESIDE, moved(z_mm=200.0), "looks past the scene")),
)
