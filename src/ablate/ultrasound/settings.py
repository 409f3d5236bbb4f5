"""What a frame is made with, the simulator's settings and the probe, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from functools import partial
from typing import Any, ClassVar

from ablate.setting import Checked, check_settings, did_you_mean, setting, shown

#: Part of every data set's identity: raise it when the same settings give another image.
SIMULATOR_VERSION = 12
#: That an operator can add to the gain of a picture, or take away.
MOST_GAIN_DB = 100.0


class PlanMode(StrEnum):
    """Whether the simulator leaves out what a scene does not need."""

    auto = "auto"
    full = "full"


class TimeGain(StrEnum):
    """The curve of the time gain: `tgc_db_cm_mhz` at all depths, or as an operator sets it for a patient."""

    fixed = "fixed"
    patient = "patient"


class DepthMode(StrEnum):
    """Where an echo is drawn: at its path length, or at its travel time shown at 1540 m/s."""

    geometric = "geometric"
    time_of_flight = "time_of_flight"


class SimulatorPrecision(StrEnum):
    """Floating point of the signal chain; rays and their crossings are float32, as Embree is."""

    float32 = "float32"
    float64 = "float64"


#: Lengths of three ranges.
_size_mm = partial(setting, least=1e-6, most=1e3, unit="mm")
_offset_mm = partial(setting, least=0, most=1e3, unit="mm")
_distance_mm = partial(setting, least=1e-3, most=1e6, unit="mm")
#: Time gain at 8 equal distances from the face to the imaging depth, dB, as the sliders of a scanner's panel.
Sliders = tuple[float, float, float, float, float, float, float, float]


@dataclass(frozen=True)
class LimitedGain:
    """A time gain that a receiver gives up to `most_db`: a slope, dB/cm/MHz one way, or a curve, dB two ways."""

    gain: float | tuple[float, ...]
    most_db: float


# The largest counts are far beyond any use: what exceeds them is a slip, and would end for want of memory after the
# anatomy is built.
@dataclass(frozen=True)
class SimulatorSettings:
    """How a frame is computed; the defaults are the paper's where it says, else assumed.

    The elevational width of the pulse grows with sqrt(1 + ((z - focus_mm) / focal_range_mm)^2), as that of a lens. The
    lateral one follows from the probe (`point_spread.lateral_sigma`). Widths that are None follow from the frequency
    (`pulse.pulse_widths`). A value that is not allowed is a ValueError that names it and what is allowed.
    """

    scanlines: int = setting(192, "Scanlines of a frame.", least=1, most=2**14)
    axial_samples: int = setting(3072, "Samples of a scanline.", least=1, most=2**18)
    samples_per_row: int = setting(
        2, "Samples of a scanline whose mean grey level is a row in beam space; pixels lie between rows.", least=1
    )
    rays: int = setting(32, "Rays of a scanline and layer.", least=1, most=2**20)
    layers: int = setting(3, "Elevational layers; of an odd number one is the image plane.", least=1, most=2**10)
    image_shape: tuple[int, int] = setting(
        (1000, 1386), "Rows and columns of the image.", least=1, most=2**14, unit="px"
    )
    tgc: TimeGain = setting(
        TimeGain.fixed, "Time gain: by depth alone, or one curve for all frames of an anatomy (`with_patient_gain`)."
    )
    tgc_db_cm_mhz: float = setting(
        0.4, "Time gain of `tgc=fixed`, one way; twice this is applied.", least=0, most=1e3, unit="dB/cm/MHz"
    )
    time_gain_db: Sliders | None = setting(
        None,
        "Time gain of your own, two ways, at 8 equal distances from the face to the imaging depth, in place of `tgc`.",
        least=-300,
        most=300,
        unit="dB",
    )
    most_gain_db: float | None = setting(
        None,
        "Most time gain, two ways, that the receiver gives; null: any, as no scanner does.",
        least=0,
        most=300,
        unit="dB",
    )
    noise_level_db: float = setting(
        -177.0,
        "Root mean square of the receiver's noise before the time gain, at all depths and frequencies, against the "
        "echo of a flat perfect reflector seen face on; -110 is a scanner's (docs/simulator.md).",
        least=-1e3,
        most=100,
        unit="dB",
    )
    dynamic_range_db: float = setting(60.0, "Between black and white.", least=1, most=1e3, unit="dB")
    reference_level: float = setting(0.1, "Amplitude that is shown as white.", least=1e-12, most=1e12)
    axial_fwhm_mm: float | None = _size_mm(
        0.30, "Length of the pulse, full width at half maximum; null: of frequency and `bandwidth`, or two pixels."
    )
    lateral_fwhm_mm: float | None = _size_mm(
        0.8,
        "Width of the pulse in the image plane at `focus_mm`; null: of the wavelength and the active aperture, or two "
        "pixels.",
    )
    elevational_fwhm_mm: float | None = _size_mm(
        2.5, "Width of the pulse across the image plane at `focus_mm`; null: of the wavelength and `element_height_mm`."
    )
    bandwidth: float = setting(0.7, "Bandwidth of the pulse at -6 dB over its frequency (assumed).", least=0.01, most=2)
    element_height_mm: float = _size_mm(13.0, "Height of the elements across the image plane (assumed).")
    focus_mm: float = _distance_mm(70.0, "Depth at which rays meet.")
    focal_range_mm: float = _distance_mm(
        40.0, "Distance from the focus at which the pulse is sqrt(2) as wide across the image plane."
    )
    sidelobe_db: float = setting(
        -27.0,
        "Power that comes through side lobes, against that of the main lobe (docs/against_pymust.md).",
        least=-1e3,
        most=0,
        unit="dB",
    )
    active_aperture_mm: float = _offset_mm(
        16.0, "Span of the elements that see a point, which decides how soft a shadow is; 0: one element (assumed)."
    )
    f_number: float = setting(
        1.5, "A nearer point is seen by fewer elements, over its depth divided by this (assumed).", least=0.1, most=100
    )
    aperture_mm: float = _offset_mm(0.2, "Half width within which the rays of a scanline start.")
    elevational_aperture_mm: float = _offset_mm(1.5, "Half width across the plane within which rays start.")
    layer_extent_mm: float = _offset_mm(1.5, "The layers' planes lie within this distance of the image plane.")
    scatterer_pitch_mm: float = _size_mm(0.1, "Distance of neighbours in the lattice of scatterers.")
    scatterer_level_db: float = setting(
        -50.0,
        "Amplitude of a scatterer of unit variance against the echo of a flat perfect reflector seen face on (assumed: "
        "no source).",
        least=-300,
        most=100,
        unit="dB",
    )
    depth_mode: DepthMode = setting(DepthMode.geometric, "Where an echo is drawn.")
    compound_angles: int = setting(
        1, "Directions that scanlines are steered to, whose envelopes are averaged: an odd number.", least=1, most=9
    )
    compound_steer_deg: float = setting(
        10.0, "Largest of these angles to either side; they are evenly spaced.", least=0, most=30, unit="degrees"
    )
    plan: PlanMode = setting(PlanMode.auto, "Whether what a scene does not need is left out.", incidental=True)
    precision: SimulatorPrecision = setting(SimulatorPrecision.float32, "Floating point of the signal chain.")
    device: str = setting(
        "cpu",
        "Device of the point spread function; `auto` is a GPU if there is one.",
        choices=("auto", "cpu", "cuda"),
        incidental=True,
    )
    path_seed: int = setting(0, "Seed of the Monte-Carlo paths.", least=0)

    def __post_init__(self) -> None:
        check_settings(self)
        if self.axial_samples > self.samples_per_row and self.axial_samples % self.samples_per_row:
            allowed = f"multiples of samples_per_row={self.samples_per_row}"
            raise ValueError(f"axial_samples={self.axial_samples}: allowed are {allowed}")
        if self.compound_angles % 2 == 0:
            raise ValueError(f"compound_angles={self.compound_angles}: allowed are 1, 3, 5, 7, 9")
        if self.compound_angles > 1 and self.depth_mode is DepthMode.time_of_flight:
            raise ValueError(f"compound_angles={self.compound_angles}: allowed with depth_mode=time_of_flight is 1")

    def check_probe(self, probe: Probe) -> None:
        """Refuse, by a ValueError, what a probe cannot do: to be steered, or to focus without an aperture."""
        if self.compound_angles > 1 and isinstance(probe, PhasedProbe):
            why = "its scanlines diverge from one point"
            raise ValueError(f"compound_angles={self.compound_angles}: allowed with a phased probe is 1, because {why}")
        if self.lateral_fwhm_mm is None and self.active_aperture_mm == 0 and not isinstance(probe, PhasedProbe):
            raise ValueError("active_aperture_mm=0.0: allowed with lateral_fwhm_mm=null are numbers above 0")

    @property
    def beam_shape(self) -> tuple[int, int]:
        """Rows and scanlines of a frame in beam space."""
        return -(-self.axial_samples // self.samples_per_row), self.scanlines

    @property
    def time_gain(self) -> float | tuple[float, ...] | LimitedGain:
        """What `time_gain.time_gain_db` takes: a slope, dB/cm/MHz one way, or a curve, dB two ways, and its limit."""
        gain = self.tgc_db_cm_mhz if self.time_gain_db is None else self.time_gain_db
        return gain if self.most_gain_db is None else LimitedGain(gain, self.most_gain_db)

    @classmethod
    def low_quality(cls, **changes: object) -> SimulatorSettings:
        """Settings of the low-quality image L: one ray, layer and angle where `changes` do not say otherwise."""
        return cls(**({"rays": 1, "layers": 1, "compound_angles": 1} | changes))  # type: ignore[arg-type]


class ProbeKind(StrEnum):
    """Shape of the array, and with it that of the image: a curved fan, a rectangle, a sector from one point."""

    convex = "convex"
    linear = "linear"
    phased = "phased"


_span_mm = partial(setting, least=1e-6, most=1e6, unit="mm")
_depth_mm = partial(_span_mm, about="Imaging depth from the face.")
_frequency = partial(setting, about="Frequency, for attenuation and the pulse.", least=1e-6, most=1e3, unit="MHz")


@dataclass(frozen=True)
class ConvexProbe(Checked):
    """A curved array; with these defaults the fan's bounding box is 217.96 x 157.23 mm."""

    kind: ClassVar[ProbeKind] = ProbeKind.convex
    radius_mm: float = _span_mm(40.0, "Radius of curvature of the face.")
    fov_deg: float = setting(70.0, "Opening angle of the fan.", least=1e-3, most=179, unit="degrees")
    depth_mm: float = _depth_mm(150.0)
    frequency_mhz: float = _frequency(8.0)


@dataclass(frozen=True)
class LinearProbe(Checked):
    """A flat array whose scanlines are parallel; its image is a rectangle as wide as the array.

    The active aperture opens with depth, at a constant f-number, so the beam is as wide at all depths (Szabo,
    Diagnostic Ultrasound Imaging, 2014, ch. 7).
    """

    kind: ClassVar[ProbeKind] = ProbeKind.linear
    width_mm: float = _span_mm(38.0, "Span of the elements, from the first scanline to the last.")
    depth_mm: float = _depth_mm(50.0)
    frequency_mhz: float = _frequency(7.5)


@dataclass(frozen=True)
class PhasedProbe(Checked):
    """A small flat array whose scanlines all leave the middle of its face, steered to either side: a sector.

    The beam's width grows with depth and, because the aperture is seen from aside, as 1 / cos of the steering angle
    (Szabo, Diagnostic Ultrasound Imaging, 2014, ch. 7). Nearer than `aperture_mm` it is as wide as there: the f-number
    is at least 1.
    """

    kind: ClassVar[ProbeKind] = ProbeKind.phased
    aperture_mm: float = _span_mm(20.0, "Span of the elements: nearer than this the beam is as wide as at this depth.")
    fov_deg: float = setting(80.0, "Opening angle of the sector.", least=1e-3, most=170, unit="degrees")
    depth_mm: float = _depth_mm(150.0)
    frequency_mhz: float = _frequency(2.5)


Probe = ConvexProbe | LinearProbe | PhasedProbe
PROBES: dict[ProbeKind, type[Probe]] = {cls.kind: cls for cls in (ConvexProbe, LinearProbe, PhasedProbe)}
#: Every value that some probe has, with its default; None where not all kinds have it.
PROBE_KEYS: dict[str, float | None] = {
    **dict.fromkeys(("radius_mm", "width_mm", "aperture_mm", "fov_deg")),
    **{name: getattr(ConvexProbe, name) for name in ("depth_mm", "frequency_mhz")},
}


def probe_from(values: Mapping[str, Any]) -> Probe:
    """A probe from its values, as `plain` gives them; null is a default, or what a probe of this kind has not.

    A ValueError for an unknown kind, a value that a probe of this kind has not, or one outside its range.
    """
    given = {name: value for name, value in values.items() if value is not None}
    kind = given.pop("kind", ProbeKind.convex)
    if kind not in PROBES:
        raise ValueError(f"kind={shown(kind)}: allowed are {', '.join(PROBES)}{did_you_mean(kind, PROBES)}")
    cls = PROBES[ProbeKind(kind)]
    allowed = [field.name for field in fields(cls)]
    for name, value in given.items():
        if name not in allowed:
            raise ValueError(f"{name}={shown(value)}: a {kind} probe has {', '.join(allowed)}")
    return cls(**given)
