"""The probes that can be simulated: a convex, a linear and a phased array, and their plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import Any, ClassVar

from ablate.setting import check_settings, setting
from ablate.validation import shown


class ProbeKind(StrEnum):
    """Shape of the array, and with it that of the image: a curved fan, a rectangle, a sector from one point."""

    convex = "convex"
    linear = "linear"
    phased = "phased"


def _depth(default: float) -> Any:
    return setting(default, "Imaging depth from the face.", least=1e-6, most=1e6, unit="mm")


def _frequency(default: float) -> Any:
    return setting(default, "Frequency that attenuation is computed at.", least=1e-6, most=1e3, unit="MHz")


@dataclass(frozen=True)
class ConvexProbe:
    """A curved array; with these defaults the fan's bounding box is 217.96 x 157.23 mm.

    A value that is not finite or outside its range is a ValueError that names it.
    """

    kind: ClassVar[ProbeKind] = ProbeKind.convex
    radius_mm: float = setting(40.0, "Radius of curvature of the face.", least=1e-6, most=1e6, unit="mm")
    fov_deg: float = setting(70.0, "Opening angle of the fan.", least=1e-3, most=179, unit="degrees")
    depth_mm: float = _depth(150.0)
    frequency_mhz: float = _frequency(8.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class LinearProbe:
    """A flat array whose scanlines are parallel; its image is a rectangle as wide as the array.

    The active aperture opens with depth, at a constant f-number, so the beam is as wide at all depths (Szabo,
    Diagnostic Ultrasound Imaging, 2014, ch. 7). A value that is not finite or outside its range is a ValueError that
    names it.
    """

    kind: ClassVar[ProbeKind] = ProbeKind.linear
    width_mm: float = setting(
        38.0, "Span of the elements, from the first scanline to the last.", least=1e-6, most=1e6, unit="mm"
    )
    depth_mm: float = _depth(50.0)
    frequency_mhz: float = _frequency(7.5)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class PhasedProbe:
    """A small flat array whose scanlines all leave the middle of its face, steered to either side: a sector.

    The beam's width grows with depth and, because the aperture is seen from aside, as 1 / cos of the steering angle
    (Szabo, Diagnostic Ultrasound Imaging, 2014, ch. 7). Nearer than `aperture_mm` it is as wide as there: the f-number
    is at least 1. A value that is not finite or outside its range is a ValueError that names it.
    """

    kind: ClassVar[ProbeKind] = ProbeKind.phased
    aperture_mm: float = setting(
        20.0, "Span of the elements, all of which make every beam.", least=1e-6, most=1e6, unit="mm"
    )
    fov_deg: float = setting(80.0, "Opening angle of the sector.", least=1e-3, most=170, unit="degrees")
    depth_mm: float = _depth(150.0)
    frequency_mhz: float = _frequency(2.5)

    def __post_init__(self) -> None:
        check_settings(self)


Probe = ConvexProbe | LinearProbe | PhasedProbe
PROBES: dict[ProbeKind, type[ConvexProbe] | type[LinearProbe] | type[PhasedProbe]] = {
    cls.kind: cls for cls in (ConvexProbe, LinearProbe, PhasedProbe)
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


def probe_from(values: Mapping[str, Any]) -> Probe:
    """A probe from its values, as `plain` gives them; null is a default, or what a probe of this kind has not.

    Raises
    ------
    ValueError
        For an unknown kind, a value that a probe of this kind has not, or one outside its range.
    """
    given = {name: value for name, value in values.items() if value is not None}
    kind = given.pop("kind", ProbeKind.convex)
    if kind not in PROBES:
        raise ValueError(f"kind={shown(kind)}: allowed are {', '.join(PROBES)}")
    cls = PROBES[ProbeKind(kind)]
    own = [field.name for field in fields(cls)]
    for name, value in given.items():
        if name not in own:
            raise ValueError(f"{name}={shown(value)}: a {kind} probe has {', '.join(own)}")
    return cls(**given)
