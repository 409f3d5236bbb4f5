"""Where the probe may be put: a regular grid of sites on the surface of a scene."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class SiteGrid:
    """Every combination of the four lists is one pose; height and angle together are one site.

    Attributes
    ----------
    axis : 3 floats
        Long axis of the body.
    front : 3 floats
        Angle 0 looks at this side.
    heights_mm : tuple of float
        Along the axis, in the scene's coordinates.
    angles_deg : tuple of float
        About the axis, right hand, through the centre of the scene's bounds.
    tilts_deg : tuple of float
        About the probe's y: rocked within its own plane.
    rolls_deg : tuple of float
        About the probe's z; at 0 the plane is transverse (x = z cross axis), at 90 sagittal.
    region : tuple of str
        Names of the structures of interest: poses whose fan misses them all are not used. Empty: any fan will do.

    Raises
    ------
    ValueError
        When a list is empty, a value is not finite, a tilt turns the probe away from the body, or axis and front do
        not span a plane.
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    front: tuple[float, float, float] = (0.0, -1.0, 0.0)
    heights_mm: tuple[float, ...] = (0.0,)
    angles_deg: tuple[float, ...] = (0.0,)
    tilts_deg: tuple[float, ...] = (0.0,)
    rolls_deg: tuple[float, ...] = (0.0,)
    region: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for field in fields(self):
            if field.name == "region":
                continue
            values = getattr(self, field.name)
            if len(values) == 0 or not all(math.isfinite(value) for value in values):
                raise ValueError(f"site grid: {field.name} must be one or more finite numbers, not {values!r}")
        if not all(-90 < tilt < 90 for tilt in self.tilts_deg):
            raise ValueError(f"site grid: tilts_deg must lie between -90 and 90, not {self.tilts_deg!r}")
        for name in ("axis", "front"):
            if len(getattr(self, name)) != 3:
                raise ValueError(f"site grid: {name} must be 3 numbers, not {getattr(self, name)!r}")
        (a, b, c), (d, e, f) = self.axis, self.front
        normal = math.hypot(b * f - c * e, c * d - a * f, a * e - b * d)
        if normal < 1e-3 * max(math.hypot(a, b, c) * math.hypot(d, e, f), 1e-9):
            raise ValueError(f"site grid: front {self.front} must not point along axis {self.axis}")
