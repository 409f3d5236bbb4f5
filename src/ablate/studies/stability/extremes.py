"""Settings, seeds and tissues at the ends of what is allowed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ablate.anatomy import Scene, Tissue
from ablate.studies.stability.checks import Case, Check, labelled
from ablate.studies.stability.frames import GEL, SMALL, SOFT, both, slab, usual
from ablate.ultrasound import ConvexProbe, DepthMode
from ablate.ultrasound.probe import sample_depths_mm

HARD = Tissue("hard", 2600, 4.2, 3.0, 0.6, 0.0, 0.2, roughness=0.05, thickness_mm=0.2)
BODY = Scene((slab(SOFT, 3.0, 120.0), slab(HARD, 40.0, 50.0, 30.0)), GEL, "body")
_SPECKLE = Scene((), replace(SOFT, attenuation_db_cm_mhz=0.0), "speckle")
#: A single one of each, then of all.
_ONES: tuple[Mapping[str, Any], ...] = (
    {"rays": 1},
    {"scanlines": 1},
    {"axial_samples": 1},
    {"layers": 1},
    {"image_shape": (1, 1)},
    {"rays": 1, "scanlines": 1, "axial_samples": 1, "layers": 1, "image_shape": (1, 1)},
)


def _tried(
    scene: Scene, changes: tuple[Mapping[str, Any], ...], device: str, probe: ConvexProbe | None = None
) -> Iterator[Check]:
    """What must hold of any frame, with each change of the settings in turn."""
    for change in changes:
        settings = replace(SMALL, **change)
        label = ", ".join(
            f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in change.items()
        )
        yield from labelled(label, usual(both(scene, settings, device, probe), settings, probe))


def _probes(device: str) -> Iterator[Check]:
    """A fan of a thousandth of a degree and one of nearly half a turn, a needle's tip and a flat array."""
    for probe in (
        ConvexProbe(fov_deg=1e-3),
        ConvexProbe(fov_deg=179.0),
        ConvexProbe(radius_mm=1e-6),
        ConvexProbe(radius_mm=1e6, fov_deg=1e-3),
        ConvexProbe(depth_mm=1e-3),
        ConvexProbe(depth_mm=1e5),
    ):
        label = f"{probe.fov_deg:g} degrees, radius {probe.radius_mm:g} mm, depth {probe.depth_mm:g} mm"
        yield from labelled(label, usual(both(BODY, SMALL, device, probe), SMALL, probe))


def _gain(device: str) -> Iterator[Check]:
    """A gain of 240 000 dB, and one of 2400 over silence: white and black, never NaN."""
    for tgc in (1e3, 10.0):
        settings = replace(SMALL, tgc_db_cm_mhz=tgc, noise_floor_db=-1e3)
        frames = both(Scene((slab(SOFT, 60.0, 100.0),), GEL, "between gel"), settings, device)
        yield from labelled(f"tgc {tgc:g}", usual(frames, settings))
        for dtype, frame in frames.items():
            deep = frame.image[frame.segmentation == 2]
            yield Check(
                dtype, f"tgc {tgc:g}: tissue that is not white", int((deep < 255).sum()), 0, "It is beyond white."
            )
            gel = frame.image[:40][frame.mask[:40]]
            yield Check(dtype, f"tgc {tgc:g}: brightest silence", float(gel.max()), 0, "No gain lifts silence.")


def _display(device: str) -> Iterator[Check]:
    """Dynamic ranges of 1 dB and of 800 dB, noise at full level and none."""
    scene = Scene((slab(SOFT, 60.0, 100.0),), GEL, "between gel")
    changes = ({"dynamic_range_db": 1.0}, {"noise_floor_db": 0.0}, {"noise_floor_db": -1e3}, {"reference_level": 1e-12})
    yield from _tried(scene, changes, device)
    settings = replace(SMALL, dynamic_range_db=800.0, noise_floor_db=-1e3)
    frames = both(scene, settings, device)
    yield from labelled("dynamic_range_db 800", usual(frames, settings))
    for dtype, frame in frames.items():
        gel = frame.image[:40][frame.mask[:40]]
        yield Check(
            dtype, "dynamic_range_db 800: brightest silence", float(gel.max()), 0, "Silence is under any range."
        )


def _frequencies(device: str) -> Iterator[Check]:
    """A hertz and a gigahertz, with losses that grow as its fourth power: none, and 10^16 dB/cm."""
    steep = replace(SOFT, name="steep", attenuation_db_cm_mhz=1e4, attenuation_power=4.0)
    scene = Scene((slab(steep, 60.0, 80.0),), SOFT, "steep")
    for frequency in (1e-6, 1e3):
        probe = ConvexProbe(frequency_mhz=frequency)
        frames = both(scene, SMALL, device, probe)
        yield from labelled(f"{frequency:g} MHz", usual(frames, SMALL, probe))
        for dtype, frame in frames.items():
            column = frame.attenuation[frame.mask[:, 138], 138]
            rise = float(np.diff(column, prepend=np.float32(1)).max())
            yield Check(dtype, f"{frequency:g} MHz: rise of A along a line", rise, 0, "Sound only gets weaker.")


def _pulses(device: str) -> Iterator[Check]:
    """Pulses and beams of a nanometre and of a metre; speckle keeps the power of its scatterers."""
    widths = ("axial_fwhm_mm", "lateral_fwhm_mm", "elevational_fwhm_mm")
    power = 10 ** (SMALL.scatterer_level_db / 10) * _SPECKLE.background.scatter_power
    for name in widths:
        for width in (1e-6, 1e3):
            change: dict[str, Any] = {name: width}
            settings = replace(SMALL, **change)
            frames = both(_SPECKLE, settings, device)
            label = f"{name} {width:g}"
            yield from labelled(label, usual(frames, settings))
            if (name, width) != ("axial_fwhm_mm", 1e-6):
                continue
            grains = settings.scanlines * settings.axial_samples / 4  # a beam is at most four lines wide
            for dtype, frame in frames.items():
                found = float((frame.envelope.astype(float) ** 2).mean()) / power
                yield Check(
                    dtype, f"{label}: power of speckle, relative", abs(found - 1), 5 / np.sqrt(grains),
                    "Five standard errors: the power of a grain deviates by its mean.",
                )  # fmt: skip


def _travel_times(device: str) -> Iterator[Check]:
    """Layers of 1 m/s and of 100 000 m/s, drawn at the travel times through them."""
    settings = replace(
        SMALL, depth_mode=DepthMode.time_of_flight, aperture_mm=0.0, elevational_aperture_mm=0.0, layers=1
    )
    settings = replace(settings, scanlines=8, lateral_fwhm_mm=1e-6, noise_floor_db=-100.0)
    pencil = ConvexProbe(fov_deg=0.002)
    spacing = pencil.depth_mm / settings.axial_samples
    for speed, thick_mm in ((1.0, 0.05), (1e5, 1000.0)):
        around = Tissue("around", 1540, 1.5, 0.0, 0.0, 0.0, 0.0, roughness=0.0)
        layer = replace(around, name="layer", speed_m_s=speed, impedance_mrayl=1.6)
        scene = Scene((slab(layer, 30.0, 30.0 + thick_mm),), around, "layer")
        frames = both(scene, settings, device, pencil)
        yield from labelled(f"{speed:g} m/s", usual(frames, settings, pencil))
        shown = 30 + thick_mm * 1540 / speed
        z = sample_depths_mm(pencil, settings.axial_samples)
        for dtype, frame in frames.items():
            line = np.where(z > 35, frame.envelope[:, 4], 0)  # beyond the near face's pulse
            yield Check(
                dtype, f"{speed:g} m/s: depth of the far face, mm", abs(float(z[line.argmax()]) - shown),
                spacing + 1e-2,
                "An echo is split between two samples; 1e-2 mm are 1540 times float32's step beyond a surface.",
            )  # fmt: skip


def _seeds(device: str) -> Iterator[Check]:
    """Seeds at the ends of int64 and far beyond: speckle of the same power, and none like another's."""
    seeds = (0, 2**31, 2**63 - 1, 2**64 + 5, 10**30)
    settings = [replace(SMALL, path_seed=seed) for seed in seeds]
    shown = [both(_SPECKLE, s, device, seed=seed) for s, seed in zip(settings, seeds, strict=True)]
    for frames, s in zip(shown, settings, strict=True):
        yield from labelled(f"seed {float(s.path_seed):.3g}", usual(frames, s))
    for dtype in ("float32", "float64"):
        lines = np.array([f[dtype].envelope[::16, ::4].ravel() for f in shown], float)
        alike = np.abs(np.corrcoef(lines) - np.eye(len(seeds))).max()
        yield Check(
            dtype, "correlation of the speckle of two seeds", float(alike), 5 / np.sqrt(lines.shape[1]),
            "Five standard errors of a correlation over samples a pulse and a beam apart.",
        )  # fmt: skip


def _tissues(device: str) -> Iterator[Check]:
    """Roughness, thickness, specularity and texture at their largest."""
    wild = replace(
        HARD, name="wild", roughness=10.0, thickness_mm=100.0, specularity=1e6, texture_contrast_db=40.0,
        texture_mm=(1e-3, 1e6, 1.0), scatterer_mean=1e3, scatterer_sd=1e3,
    )  # fmt: skip
    yield from usual(both(Scene((slab(wild, 40.0, 50.0),), SOFT, "wild"), SMALL, device), SMALL)


CASES = (
    Case("one ray, one line, one sample, one pixel", partial(_tried, BODY, _ONES)),
    Case("fans and faces of every shape", _probes),
    Case("time gain beyond float32", _gain),
    Case("dynamic ranges of 1 and 800 dB", _display),
    Case("a hertz and a gigahertz", _frequencies),
    Case("pulses of a nanometre and of a metre", _pulses),
    Case(
        "a focus on the face and a kilometre away",
        partial(
            _tried, BODY, ({"focus_mm": 1e-3}, {"focus_mm": 1e6}, {"focal_range_mm": 1e-3}, {"focal_range_mm": 1e6})
        ),
    ),
    Case(
        "an aperture of a point and of two metres",
        partial(
            _tried,
            BODY,
            ({"aperture_mm": 0.0}, {"aperture_mm": 1e3}, {"elevational_aperture_mm": 1e3}, {"layer_extent_mm": 1e3}),
        ),
    ),
    Case(
        "lattices of a nanometre and of a metre",
        partial(_tried, _SPECKLE, ({"scatterer_pitch_mm": 1e-6}, {"scatterer_pitch_mm": 1e3})),
    ),
    Case(
        "scatterers 300 dB under and 100 dB over a mirror",
        partial(_tried, BODY, ({"scatterer_level_db": -300.0}, {"scatterer_level_db": 100.0})),
    ),
    Case("travel times at 1 and 100000 m/s", _travel_times),
    Case("seeds at the ends of int64 and beyond", _seeds),
    Case("surfaces and textures at their wildest", _tissues),
)
