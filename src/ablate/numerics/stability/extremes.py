"""Settings, probes, seeds and tissues at the ends of their allowed ranges."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ablate.anatomy import Scene, Tissue
from ablate.numerics.stability.checks import Case, Check, labelled, none
from ablate.numerics.stability.frames import GEL, SMALL, SOFT, any_frame, both, checked_frames, slab
from ablate.ultrasound import ConvexProbe, DepthMode, Frame
from ablate.ultrasound.probe import sample_depths_mm

HARD = Tissue("hard", 2600, 4.2, 3.0, 0.6, 0.0, 0.2, roughness=0.05, thickness_mm=0.2)
BODY = Scene((slab(SOFT, 3.0, 120.0), slab(HARD, 40.0, 50.0, 30.0)), GEL, "body")
_BETWEEN_GEL = Scene((slab(SOFT, 60.0, 100.0),), GEL, "between gel")
_SPECKLE = Scene((), replace(SOFT, attenuation_db_cm_mhz=0.0), "speckle")
_APERTURES = {"aperture_mm": (0.0, 1e3), "elevational_aperture_mm": (1e3,), "layer_extent_mm": (1e3,)}
_ALL_ONE: dict[str, Any] = {"rays": 1, "scanlines": 1, "axial_samples": 1, "layers": 1, "image_shape": (1, 1)}
#: One of each, then one of all.
_ONES = (*({name: value} for name, value in _ALL_ONE.items()), _ALL_ONE)


def _tried(scene: Scene, changes: Iterable[Mapping[str, Any]], device: str) -> Iterator[Check]:
    """Any frame, with each change of the settings in turn."""
    for change in changes:
        shown = {name: f"{value:g}" if isinstance(value, float) else value for name, value in change.items()}
        label = ", ".join(f"{name} {value}" for name, value in shown.items())
        yield from checked_frames(scene, replace(SMALL, **change), device, label=label)


def _changes_of(name: str, scene: Scene, **values: tuple[float, ...]) -> Case:
    """Make the case of a scene with each of these values of the settings in turn."""
    changes = tuple({setting: value} for setting, several in values.items() for value in several)
    return Case(name, partial(_tried, scene, changes))


def _probes(device: str) -> Iterator[Check]:
    """Fans of 0.001 and 179 degrees, a point and a flat array as the face, depths of 1 um and 100 m."""
    fans = ConvexProbe(fov_deg=1e-3), ConvexProbe(fov_deg=179.0)
    faces = ConvexProbe(radius_mm=1e-6), ConvexProbe(radius_mm=1e6, fov_deg=1e-3)
    for probe in (*fans, *faces, ConvexProbe(depth_mm=1e-3), ConvexProbe(depth_mm=1e5)):
        label = f"{probe.fov_deg:g} degrees, radius {probe.radius_mm:g} mm, depth {probe.depth_mm:g} mm"
        yield from checked_frames(BODY, SMALL, device, probe, label=label)


def _gain(device: str) -> Iterator[Check]:
    """Time gains of 240,000 and 2,400 dB: tissue is white and anechoic gel black, never NaN."""
    for tgc in (1e3, 10.0):
        settings = replace(SMALL, tgc_db_cm_mhz=tgc, noise_floor_db=-1e3)
        frames = yield from checked_frames(_BETWEEN_GEL, settings, device, label=f"tgc {tgc:g}")
        for dtype, frame in frames.items():
            grey = frame.image[frame.segmentation == 2] < 255
            yield none(dtype, f"tgc {tgc:g}: tissue that is not white", grey, "Its level is above the range.")
            yield Check(dtype, f"tgc {tgc:g}: grey level of gel", _level_of_gel(frame), 0, "A gain does not change 0.")


def _display(device: str) -> Iterator[Check]:
    """Dynamic ranges of 1 and 800 dB, with noise at full level and without noise."""
    changes = ({"dynamic_range_db": 1.0}, {"noise_floor_db": 0.0}, {"noise_floor_db": -1e3}, {"reference_level": 1e-12})
    yield from _tried(_BETWEEN_GEL, changes, device)
    settings, label = replace(SMALL, dynamic_range_db=800.0, noise_floor_db=-1e3), "dynamic_range_db 800"
    frames = yield from checked_frames(_BETWEEN_GEL, settings, device, label=label)
    for dtype, frame in frames.items():
        yield Check(dtype, f"{label}: grey level of gel", _level_of_gel(frame), 0, "0 is below any dynamic range.")


def _level_of_gel(frame: Frame) -> float:
    """Find the largest grey level in the anechoic gel above the tissue."""
    return float(frame.image[:40][frame.mask[:40]].max())


def _frequencies(device: str) -> Iterator[Check]:
    """1 Hz and 1 GHz in a tissue whose attenuation grows with the fourth power of frequency: 0 and 10^16 dB/cm."""
    steep = replace(SOFT, name="steep", attenuation_db_cm_mhz=1e4, attenuation_power=4.0)
    scene = Scene((slab(steep, 60.0, 80.0),), SOFT, "steep")
    for frequency in (1e-6, 1e3):
        probe = ConvexProbe(frequency_mhz=frequency)
        frames = yield from checked_frames(scene, SMALL, device, probe, label=f"{frequency:g} MHz")
        for dtype, frame in frames.items():
            column = frame.attenuation[frame.mask[:, 138], 138]
            rise = float(np.diff(column, prepend=np.float32(1)).max())
            yield Check(dtype, f"{frequency:g} MHz: rise of A along a line", rise, 0, "Attenuation only grows.")


def _pulses(device: str) -> Iterator[Check]:
    """Pulses and beams of a nanometre and of a metre; the power of speckle stays that of its scatterers."""
    widths = ("axial_fwhm_mm", "lateral_fwhm_mm", "elevational_fwhm_mm")
    power = 10 ** (SMALL.scatterer_level_db / 10) * _SPECKLE.background.scatter_power
    for name in widths:
        for width in (1e-6, 1e3):
            change: dict[str, Any] = {name: width}
            settings, label = replace(SMALL, **change), f"{name} {width:g}"
            frames = yield from checked_frames(_SPECKLE, settings, device, label=label)
            if (name, width) != ("axial_fwhm_mm", 1e-6):
                continue
            cells = settings.scanlines * settings.axial_samples / 4  # a beam is at most four lines wide
            for dtype, frame in frames.items():
                found = float((frame.envelope.astype(float) ** 2).mean()) / power
                why = "Five standard errors; the deviation of a cell's power is its mean."
                yield Check(dtype, f"{label}: power of speckle, relative", abs(found - 1), 5 / np.sqrt(cells), why)


def _travel_times(device: str) -> Iterator[Check]:
    """Layers with speeds of 1 and 100,000 m/s, displayed at travel times."""
    settings = replace(
        SMALL, depth_mode=DepthMode.time_of_flight, aperture_mm=0.0, elevational_aperture_mm=0.0, layers=1, scanlines=8,
        lateral_fwhm_mm=1e-6, noise_floor_db=-100.0,
    )  # fmt: skip
    pencil = ConvexProbe(fov_deg=0.002)
    spacing = pencil.depth_mm / settings.axial_samples
    for speed, thick_mm in ((1.0, 0.05), (1e5, 1000.0)):
        around = Tissue("around", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
        layer = replace(around, name="layer", speed_m_s=speed, impedance_mrayl=1.6)
        scene = Scene((slab(layer, 30.0, 30.0 + thick_mm),), around, "layer")
        frames = yield from checked_frames(scene, settings, device, pencil, label=f"{speed:g} m/s")
        shown = 30 + thick_mm * 1540 / speed
        z = sample_depths_mm(pencil, settings.axial_samples)
        for dtype, frame in frames.items():
            line = np.where(z > 35, frame.envelope[:, 4], 0)  # beyond the near face's pulse
            error = abs(float(z[line.argmax()]) - shown)
            why = "An echo is divided between two samples; 1e-2 mm is 1540 times the step of a ray beyond a surface."
            yield Check(dtype, f"{speed:g} m/s: depth of the far face, mm", error, spacing + 1e-2, why)


def _seeds(device: str) -> Iterator[Check]:
    """Seeds at the ends of int64 and far beyond: the speckle of different seeds is not correlated."""
    seeds = (0, 2**31, 2**63 - 1, 2**64 + 5, 10**30)
    settings = [replace(SMALL, path_seed=seed) for seed in seeds]
    shown = [both(_SPECKLE, s, device, seed=seed) for s, seed in zip(settings, seeds, strict=True)]
    for frames, s in zip(shown, settings, strict=True):
        yield from labelled(f"seed {float(s.path_seed):.3g}", any_frame(frames, s))
    for dtype in ("float32", "float64"):
        lines = np.array([f[dtype].envelope[::16, ::4].ravel() for f in shown], float)
        alike = np.abs(np.corrcoef(lines) - np.eye(len(seeds))).max()
        why = "Five standard errors of a correlation; samples are a pulse and a beam apart."
        yield Check(dtype, "correlation of the speckle of two seeds", float(alike), 5 / np.sqrt(lines.shape[1]), why)


def _tissues(device: str) -> Iterator[Check]:
    """The largest roughness, thickness, specularity and texture."""
    wild = replace(
        HARD, name="wild", roughness=10.0, thickness_mm=100.0, specularity=1e6, texture_contrast_db=40.0,
        texture_mm=(1e-3, 1e6, 1.0), scatterer_mean=1e3, scatterer_sd=1e3,
    )  # fmt: skip
    yield from checked_frames(Scene((slab(wild, 40.0, 50.0),), SOFT, "wild"), SMALL, device)


CASES = (
    Case("one ray, one line, one sample, one pixel", partial(_tried, BODY, _ONES)),
    Case("fans and faces of every shape", _probes),
    Case("time gain beyond float32", _gain),
    Case("dynamic ranges of 1 and 800 dB", _display),
    Case("a hertz and a gigahertz", _frequencies),
    Case("pulses of a nanometre and of a metre", _pulses),
    _changes_of("a focus on the face and a kilometre away", BODY, focus_mm=(1e-3, 1e6), focal_range_mm=(1e-3, 1e6)),
    _changes_of("an aperture of a point and of two metres", BODY, **_APERTURES),
    _changes_of("lattices of a nanometre and of a metre", _SPECKLE, scatterer_pitch_mm=(1e-6, 1e3)),
    _changes_of("scatterers 300 dB under and 100 dB over a mirror", BODY, scatterer_level_db=(-300.0, 100.0)),
    Case("travel times at 1 and 100000 m/s", _travel_times),
    Case("seeds at the ends of int64 and beyond", _seeds),
    Case("surfaces and textures at their wildest", _tissues),
)
