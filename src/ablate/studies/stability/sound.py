"""Losses of thousands of decibels, steps of impedance, total reflection, reverberation without end."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from ablate.anatomy import Scene, Tissue
from ablate.studies.stability.checks import FLOAT32, Case, Check
from ablate.studies.stability.frames import AHEAD, GEL, ONE_LINE, SMALL, SOFT, both, moved, products, slab, usual
from ablate.ultrasound import ConvexProbe, Frame, SimulatorSettings
from ablate.ultrasound.illumination import NODES
from ablate.ultrasound.interfaces import pressure_reflection, refracted, transmission_cosine
from ablate.ultrasound.point_spread import axial_kernel
from ablate.ultrasound.probe import sample_depths_mm

BONE = Tissue("bone", 3200, 7.8, 40.0, 0.6, 0.0, 1.0, roughness=0.0)
GAS = Tissue("gas", 330, 4e-4, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
PENCIL = ConvexProbe(fov_deg=0.002, frequency_mhz=3.0)


def _losses(device: str) -> Iterator[Check]:
    """Bone throughout: 320 dB/cm, 4800 dB one way to the end of the image."""
    probe, scene = ConvexProbe(), Scene((), BONE, "bone")
    settings = replace(SMALL, axial_samples=3072, axial_fwhm_mm=0.3)
    frames = both(scene, settings, device, probe)
    yield from usual(frames, settings, probe)
    depth_cm = sample_depths_mm(probe, settings.axial_samples) / 10
    heard = depth_cm < 0.5  # 320 dB there and back; squares of float32 underflow beyond 440
    grains = settings.scanlines / 4 * 5 / settings.axial_fwhm_mm  # near the face a beam is four lines wide
    for dtype, frame in frames.items():
        level_db = 20 * np.log10(frame.envelope[heard].astype(float)).mean(axis=1)
        slope = -np.polyfit(depth_cm[heard], level_db, 1)[0]
        yield Check(
            dtype,
            "slope of the envelope against 2 alpha f, relative",
            abs(slope / (2 * 40 * 8) - 1),
            4 * 5.57 * np.sqrt(12 / grains) / 320,
            "Four standard errors of a slope through log speckle, 5.57 dB a grain, over 320 dB.",
        )
        yield Check(
            dtype, "largest sample of what is silent", float(frame.envelope[depth_cm > 1].max()), 0,
            "Two-way losses beyond 600 dB are silence.",
        )  # fmt: skip
        column = frame.attenuation[:, 138]
        rise = np.diff(column[column > 0], prepend=np.float32(1)).max()
        yield Check(dtype, "rise of A along a line", float(rise), 0, "Sound only gets weaker on its way.")


def _step(z1: float, z2: float, device: str) -> Iterator[Check]:
    """A face between two impedances, met head on: what comes back and what goes on are all there is."""
    r = (z2 - z1) / (z2 + z1)
    here, there = (Tissue(n, 1540, z, 0.0, 0.6, 0.0, 1.0, roughness=0.0) for n, z in (("a", z1), ("b", z2)))
    quiet_here, quiet_there = (replace(t, scatterer_density=0.0) for t in (here, there))
    alike = replace(there, impedance_mrayl=z1)
    taken, free, echo = (
        both(Scene((slab(far, 50.0, 200.0),), near, "step"), ONE_LINE, device, PENCIL)
        for near, far in ((here, there), (here, alike), (quiet_here, quiet_there))
    )
    yield from usual(taken, ONE_LINE, PENCIL)
    pulse = axial_kernel(PENCIL, ONE_LINE)
    behind = slice(500, 1000)  # 73 to 146 mm
    for dtype in taken:
        on = taken[dtype].envelope[behind].sum(dtype=float) / free[dtype].envelope[behind].sum(dtype=float)
        back = echo[dtype].envelope.sum(dtype=float) / pulse.sum()
        yield Check(
            dtype, "amplitude of the echo against |R|", abs(back - abs(r)), (len(pulse) + 4) * FLOAT32,
            "Impedances, and sums over the pulse, are rounded.",
        )  # fmt: skip
        yield Check(
            dtype, "energy gone or gained, |R^2 + T - 1|", abs(back**2 + on - 1), 1e-5,
            "A direct ray keeps exactly 1 - R of its weight; sums over samples in float32 are rounded.",
        )  # fmt: skip


def _angles(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Every angle up to a ten millionth of a degree from grazing, four pairs of media, on the compiled formulas."""
    angles = np.radians(90 - np.concatenate([np.linspace(0, 90, 2001)[1:], np.logspace(-7, 0, 200)]))
    for z1, c1, z2, c2 in (
        (1.5, 1540, 7.8, 3200),
        (7.8, 3200, 1.5, 1540),
        (1.63, 1540, 4e-4, 330),
        (4e-4, 330, 8, 5000),
    ):
        rows = np.array([_at(np.cos(a), z1, c1, z2, c2) for a in angles])
        rounded = np.array([_at(np.cos(a), *(float(np.float32(v)) for v in (z1, c1, z2, c2))) for a in angles])
        label = f"Z {z1:g} to {z2:g}"
        yield Check(
            "float64", f"{label}: |R + T - 1|", float(np.abs(rows[:, 1] - 1).max()), 1e-12,
            "R and T are written independently; both are smooth in double precision.",
        )  # fmt: skip
        yield Check(
            "float64", f"{label}: length of the refracted direction", float(np.abs(rows[:, 2] - 1).max()), 1e-12,
            "Snell's law turns a direction and keeps its length.",
        )  # fmt: skip
        critical = np.sqrt(max(1 - (c1 / c2) ** 2, 0)) or 1e-9
        steepest = 2 * z1 / (z2 * critical) if c2 > c1 else 1.0
        yield Check(
            "float32", f"{label}: R of rounded media against exact ones", float(np.abs(rounded - rows)[:, 0].max()),
            steepest * 2 * np.sqrt(8 * FLOAT32) if c2 > c1 else 16 * FLOAT32,
            "Four tables are rounded; near total reflection cos t is the root of a difference of roundings, and R "
            "changes by 2 Z1 / (Z2 cos i) of it.",
        )  # fmt: skip


def _at(cos_i: float, z1: float, c1: float, z2: float, c2: float) -> tuple[float, float, float]:
    """R_p, R + T and the length of the refracted direction, 1 where there is none."""
    cos_t = transmission_cosine(cos_i, c1, c2)
    r = pressure_reflection(z1, z2, cos_i, cos_t)
    t = 2 * z2 * cos_i / (z2 * cos_i + z1 * cos_t)
    energy = r * r + t * t * z1 * cos_t / (z2 * cos_i)
    if cos_t == 0:
        return r, energy, 1.0
    onward = refracted((float(np.sqrt(1 - cos_i**2)), 0.0, cos_i), (0.0, 0.0, -1.0), cos_i, cos_t, c2 / c1)
    return r, energy, float(np.linalg.norm(onward))


def _total_reflection(device: str) -> Iterator[Check]:
    """A face 40 degrees off, beyond which sound is 1.7 times as fast: nothing gets there."""
    fast = Tissue("fast", 2600, 4.5, 0.0, 0.6, 0.0, 1.0, roughness=0.0, specularity=0.0)
    pose, settings = moved(tilt_deg=40), replace(ONE_LINE, rays=64)
    gel = slab(replace(GEL, specularity=0.0), -500.0, 30.0, 2000.0)  # heard from any side
    frames, echoes = (
        both(Scene((gel,), behind, "total"), settings, device, PENCIL, pose)
        for behind in (fast, replace(fast, scatterer_density=0.0))
    )
    yield from usual(frames, settings, PENCIL)
    pulse = axial_kernel(PENCIL, settings)
    beyond_mm = 30 / np.cos(np.radians(40)) + 150 / NODES + len(pulse) / 2 * 150 / settings.axial_samples
    beyond = sample_depths_mm(PENCIL, settings.axial_samples) > beyond_mm
    for dtype, frame in frames.items():
        echo = echoes[dtype].envelope.sum(dtype=float) / pulse.sum()
        yield Check(
            dtype, "amplitude of the echo against 1", abs(echo - 1), (len(pulse) + 4) * FLOAT32,
            "All of it comes back; the sum over the pulse is rounded.",
        )  # fmt: skip
        yield Check(
            dtype, "amplitude a node beyond the face", float(frame.envelope[beyond].max()), 0,
            "Nothing crosses it; light is kept at 256 depths.",
        )  # fmt: skip


def _grazing(device: str) -> Iterator[Check]:
    """Scanlines that run a millionth of a degree off, and exactly along, the faces of a slab."""
    hard = Tissue("hard", 2600, 4.5, 0.5, 0.6, 0.0, 1.0, roughness=0.0)
    scene = Scene((slab(hard, 50.0, 100.0, 300.0),), SOFT, "grazing")
    for tilt, z in ((90.0, 50.0), (90 - 1e-6, 50.0), (89.9, 49.9)):
        frames = both(scene, SMALL, device, pose=moved(z_mm=z, tilt_deg=tilt))
        label = f"{90 - tilt:g} degrees off"
        for check in usual(frames, SMALL):
            yield replace(check, quantity=f"{label}: {check.quantity}")


def _cavity(device: str) -> Iterator[Check]:
    """Gel between two walls of gas 10 mm apart, R = 0.998: echoes come every 5 mm for ever."""
    scene = Scene((slab(GAS, -200.0, 300.0), slab(GEL, -5.0, 5.0)), GEL, "cavity")
    settings = replace(ONE_LINE, scanlines=128, rays=256, lateral_fwhm_mm=1e-6, device=device, noise_floor_db=-100.0)
    seeds = range(6)
    kept: dict[str, list[np.ndarray]] = {"float32": [], "float64": []}
    for seed in seeds:
        frames = both(scene, replace(settings, path_seed=seed), device, PENCIL)
        if seed == 0:
            yield from usual(frames, settings, PENCIL)
        for dtype, frame in frames.items():
            kept[dtype].append(_periods(frame, settings))
    wall = abs((GAS.impedance_mrayl - GEL.impedance_mrayl) / (GAS.impedance_mrayl + GEL.impedance_mrayl))
    # Periods of 10 mm hold two echoes with the mean magnitude of noise; the k-th met 2 k + 1 and 2 k + 2 walls.
    right = np.array([np.sqrt(np.pi) / 2 * (wall ** (2 * k + 1) + wall ** (2 * k + 2)) for k in range(1, 5)])
    for dtype, found in kept.items():
        amplitude = np.array(found)[:, 1:5]
        error = amplitude.std(axis=0, ddof=1) / np.sqrt(len(seeds))
        yield Check(
            dtype, "mean echo against R^k, in standard errors",
            float((abs(amplitude.mean(axis=0) - right) / error).max()), 6,
            "Student's t of 6 path seeds exceeds 6 at one of four depths in 1 of 140 trials; roulette is unbiased.",
        )  # fmt: skip


def _periods(frame: Frame, settings: SimulatorSettings) -> np.ndarray:
    """Sum of the echoes in each centimetre, mean over the lines."""
    depth = sample_depths_mm(PENCIL, settings.axial_samples)
    pulse = axial_kernel(PENCIL, settings).sum()
    line = frame.envelope.mean(axis=1, dtype=float) / pulse
    edges = np.arange(2.5, 60, 10)
    return np.array([line[(depth > a) & (depth <= a + 10)].sum() for a in edges])


def _no_loss(device: str) -> Iterator[Check]:
    """Tissue that takes nothing: A is 1, and speckle as bright at the end as at the start."""
    settings = SMALL
    frames = both(Scene((), replace(SOFT, attenuation_db_cm_mhz=0.0), "lossless"), settings, device)
    yield from usual(frames, settings)
    mask = frames["float32"].mask
    depth_cm = sample_depths_mm(ConvexProbe(), settings.axial_samples) / 10
    grains = 64 * 1024 / 8 / 2  # a pulse is 8 samples long, a beam two lines wide at the least
    for dtype, frame in frames.items():
        yield Check(
            dtype, "1 - A", float(1 - frame.attenuation[mask].min()), 2 * FLOAT32, "Weights of pixels sum to 1."
        )
        level_db = 20 * np.log10(frame.envelope.astype(float)).mean(axis=1)
        slope = np.polyfit(depth_cm[20:-20], level_db[20:-20], 1)[0]
        yield Check(
            dtype, "slope of the envelope, dB/cm", abs(float(slope)), 4 * 5.57 * np.sqrt(12 / grains) / 15,
            "Four standard errors of a slope through log speckle, 5.57 dB a grain.",
        )  # fmt: skip


def _silence(device: str) -> Iterator[Check]:
    """Tissue without scatterers, or with next to none: only the display's noise is left."""
    for label, tissue in (
        ("density 0", replace(SOFT, scatterer_density=0.0)),
        ("variance 0", replace(SOFT, scatterer_density=1.0, scatterer_mean=1.0, scatterer_sd=0.0)),
        ("density 1e-9", replace(SOFT, scatterer_density=1e-9)),
        ("deviation 1e-112", replace(SOFT, scatterer_sd=1e-112)),
    ):
        frames = both(Scene((slab(tissue, 10.0, 100.0),), tissue, "silent"), SMALL, device)
        for check in usual(frames, SMALL):
            yield replace(check, quantity=f"{label}: {check.quantity}")
        for dtype, frame in frames.items():
            yield Check(dtype, f"{label}: largest sample", float(frame.envelope.max()), 0, "Nothing scatters.")


def _steady(device: str) -> Iterator[Check]:
    """Scatterers a million times stronger on average than their variance: the mean is no speckle, and cancels."""
    steady = replace(SOFT, scatterer_density=1.0, scatterer_mean=1e3, scatterer_sd=1e-3)
    plain = replace(steady, scatterer_mean=0.0)
    for dtype, frame in both(Scene((), steady, "steady"), SMALL, device).items():
        other = both(Scene((), plain, "plain"), SMALL, device)[dtype]
        yield Check(
            dtype, "against scatterers of mean 0, of the largest", float(
                np.abs(frame.envelope - other.envelope).max() / other.envelope.max()
            ), products(SMALL, ConvexProbe()) ** 1.5 * FLOAT32,
            "Speckle is that of s - E s, which the mean cannot move.",
        )  # fmt: skip


def _uniform(scene: Scene, pose: np.ndarray, words: str | None, device: str) -> Iterator[Check]:
    """A fan within one medium; what a probe cannot see through is told."""
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", UserWarning)
        frames = both(scene, SMALL, device, pose=pose)
    yield from usual(frames, SMALL)
    told_right = sum(words in str(w.message) for w in told) if words else 2 - len(told)
    yield Check("float32", "warnings missing or too many", abs(2 - told_right), 0, "One a simulator, in plain words.")
    for dtype, frame in frames.items():
        labels = np.unique(frame.segmentation[frame.mask])
        yield Check(dtype, "labels besides the one", len(labels) - 1, 0, "The fan holds one medium.")


_IN_GEL = Scene((slab(SOFT, 300.0, 400.0),), SOFT, "around gel"), Scene((), GEL, "gel")

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
    Case("zero scatterers", _silence),
    Case("scatterers of large mean and little variance", _steady),
    Case("a fan entirely in gel", partial(_uniform, Scene((), GEL, "gel"), AHEAD, None)),
    Case(
        "a fan entirely in bone",
        partial(_uniform, Scene((slab(BONE, -50.0, 200.0, 600.0),), GEL, "bone"), AHEAD, "bone"),
    ),
    Case(
        "a fan entirely outside the scene",
        partial(_uniform, Scene((slab(SOFT, -50.0, -10.0),), GEL, "past"), moved(z_mm=200.0), "looks past the scene"),
    ),
)
