"""Where the probe may be put: a regular grid of sites on the surface of a scene."""

import math
from dataclasses import dataclass

MOST_POSES = 100_000  # of a grid; the paper has 6,669 frames


@dataclass(frozen=True)
class SiteGrid:
    """Every combination of the four lists is one pose; height and angle together are one site.

    Attributes
    ----------
    axis, front
        Long axis of the body, and the side that angle 0 looks at.
    heights_mm
        Along the axis, in the scene's coordinates.
    angles_deg
        About the axis, right hand, through the centre of the scene's bounds.
    tilts_deg
        About the probe's y: rocked within its own plane.
    rolls_deg
        About the probe's z; at 0 the plane is transverse (x = z cross axis), at 90 sagittal.
    region
        Names of structures: poses whose fan misses them all are not used. Without names every pose is used.

    Raises
    ------
    ValueError
        When a list is empty, a value is not finite, a tilt turns the probe away from the body, axis and front do not
        span a plane, or there are more than `MOST_POSES` poses.
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    front: tuple[float, float, float] = (0.0, -1.0, 0.0)
    heights_mm: tuple[float, ...] = (0.0,)
    angles_deg: tuple[float, ...] = (0.0,)
    tilts_deg: tuple[float, ...] = (0.0,)
    rolls_deg: tuple[float, ...] = (0.0,)
    region: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("axis", "front", "heights_mm", "angles_deg", "tilts_deg", "rolls_deg"):
            values = getattr(self, name)
            if len(values) == 0 or not all(math.isfinite(value) for value in values):
                raise ValueError(f"site grid: {name} must be one or more finite numbers, not {values!r}")
            if name in ("axis", "front") and len(values) != 3:
                raise ValueError(f"site grid: {name} must be 3 numbers, not {values!r}")
        lengths = [len(values) for values in (self.heights_mm, self.angles_deg, self.tilts_deg, self.rolls_deg)]
        if math.prod(lengths) > MOST_POSES:
            counts = "heights x angles x tilts x rolls"
            raise ValueError(f"site grid: {counts} must be at most {MOST_POSES} poses, not {math.prod(lengths)}")
        if not all(-90 < tilt < 90 for tilt in self.tilts_deg):
            raise ValueError(f"site grid: tilts_deg must lie between -90 and 90, not {self.tilts_deg!r}")
        (a, b, c), (d, e, f) = self.axis, self.front
        normal = math.hypot(b * f - c * e, c * d - a * f, a * e - b * d)
        if normal < 1e-3 * max(math.hypot(a, b, c) * math.hypot(d, e, f), 1e-9):
            raise ValueError(f"site grid: front {self.front} must not point along axis {self.axis}")
