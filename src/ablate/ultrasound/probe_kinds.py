"""The probes that can be simulated: a convex, a linear and a phased array, and their plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from typing import Any

from ablate.validation import check_number, shown


class ProbeKind(StrEnum):
    """Shape of the array, and with it that of the image: a curved fan, a rectangle, a sector from one point."""

    convex = "convex"
    linear = "linear"
    phased = "phased"


@dataclass(frozen=True)
class ConvexProbe:
    """A curved array; with these defaults the fan's bounding box is 217.96 x 157.23 mm.

    `radius_mm` is the face's radius of curvature, `fov_deg` the opening angle of the fan, `depth_mm` the imaging depth
    from the face, and `frequency_mhz` the frequency that attenuation is computed at.

    Raises
    ------
    ValueError
        When a value is not finite or outside its range; the message names it.
    """

    radius_mm: float = 40.0
    fov_deg: float = 70.0
    depth_mm: float = 150.0
    frequency_mhz: float = 8.0

    def __post_init__(self) -> None:
        check_number("radius_mm", self.radius_mm, 1e-6, 1e6)
        check_number("fov_deg", self.fov_deg, 1e-3, 179.0)
        _check_depth_and_frequency(self)


@dataclass(frozen=True)
class LinearProbe:
    """A flat array whose scanlines are parallel; its image is a rectangle as wide as the array.

    `width_mm` is the span of the elements, from the first scanline to the last. The active aperture opens with depth,
    at a constant f-number, so the beam is as wide at all depths (Szabo, Diagnostic Ultrasound Imaging, 2014, ch. 7).

    Raises
    ------
    ValueError
        When a value is not finite or outside its range; the message names it.
    """

    width_mm: float = 38.0
    depth_mm: float = 50.0
    frequency_mhz: float = 7.5

    def __post_init__(self) -> None:
        check_number("width_mm", self.width_mm, 1e-6, 1e6)
        _check_depth_and_frequency(self)


@dataclass(frozen=True)
class PhasedProbe:
    """A small flat array whose scanlines all leave the middle of its face, steered to either side: a sector.

    `aperture_mm` is the span of the elements, all of which make every beam, and `fov_deg` the opening angle of the
    sector. The beam's width grows with depth and, because the aperture is seen from aside, as 1 / cos of the steering
    angle (Szabo, Diagnostic Ultrasound Imaging, 2014, ch. 7). Nearer than `aperture_mm` it is as wide as there: the
    f-number is at least 1.

    Raises
    ------
    ValueError
        When a value is not finite or outside its range; the message names it.
    """

    aperture_mm: float = 20.0
    fov_deg: float = 80.0
    depth_mm: float = 150.0
    frequency_mhz: float = 2.5

    def __post_init__(self) -> None:
        check_number("aperture_mm", self.aperture_mm, 1e-6, 1e6)
        check_number("fov_deg", self.fov_deg, 1e-3, 170.0)
        _check_depth_and_frequency(self)


Probe = ConvexProbe | LinearProbe | PhasedProbe
PROBES: dict[ProbeKind, type[ConvexProbe] | type[LinearProbe] | type[PhasedProbe]] = {
    ProbeKind.convex: ConvexProbe,
    ProbeKind.linear: LinearProbe,
    ProbeKind.phased: PhasedProbe,
}


#: Every value that some probe has, with its default; None where not all kinds have it.
PROBE_KEYS: dict[str, float | None] = {
    "radius_mm": None,
    "width_mm": None,
    "aperture_mm": None,
    "fov_deg": None,
    "depth_mm": ConvexProbe.depth_mm,
    "frequency_mhz": ConvexProbe.frequency_mhz,
}


def _check_depth_and_frequency(probe: Probe) -> None:
    check_number("depth_mm", probe.depth_mm, 1e-6, 1e6)
    check_number("frequency_mhz", probe.frequency_mhz, 1e-6, 1e3)


def probe_values(probe: Probe) -> dict[str, Any]:
    """A probe as JSON can hold it. The kind of a convex one is left out, as it was before there were others."""
    kind = next(kind for kind, cls in PROBES.items() if isinstance(probe, cls))
    return ({} if kind is ProbeKind.convex else {"kind": kind.name}) | asdict(probe)


def probe_from(values: Mapping[str, Any]) -> Probe:
    """The inverse of `probe_values`; null stands for a default, and for what a probe of this kind has not.

    Raises
    ------
    ValueError
        For an unknown kind, a value that a probe of this kind has not, or one outside its range.
    """
    given = {name: value for name, value in values.items() if value is not None}
    kind = given.pop("kind", ProbeKind.convex)
    if kind not in PROBES:
        raise ValueError(f"probe.kind={shown(kind)}: allowed are {', '.join(PROBES)}")
    cls = PROBES[ProbeKind(kind)]
    own = [field.name for field in fields(cls)]
    for name, value in given.items():
        if name not in own:
            raise ValueError(f"probe.{name}={shown(value)}: a {kind} probe has {', '.join(own)}")
    return cls(**given)
