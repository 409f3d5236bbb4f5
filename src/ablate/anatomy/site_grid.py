"""Where the probe may be put: a regular grid of sites on the surface of a scene."""

import math
from dataclasses import dataclass

MOST_POSES = 100_000  # of a grid; the paper has 6,669 frames


@dataclass(frozen=True)
class SiteGrid:
    """A grid of probe poses: each combination of the four lists is one; height and angle together are one site.

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
        When a list is empty, a value is not finite or stands twice, a tilt turns the probe away from the body, axis and
        front do not span a plane, or there are more than `MOST_POSES` poses.
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
        turns = [[turn % 360 for turn in turns] for turns in (self.angles_deg, self.tilts_deg, self.rolls_deg)]
        if any(len(set(values)) < len(values) for values in (self.heights_mm, *turns)):
            raise ValueError("site grid: a height, angle, tilt or roll stands twice; -180 and 180 degrees are the same")
        count = len(self.heights_mm) * len(self.angles_deg) * len(self.tilts_deg) * len(self.rolls_deg)
        if count > MOST_POSES:
            raise ValueError(f"site grid: heights x angles x tilts x rolls: at most {MOST_POSES} poses, not {count}")
        if not all(-90 < tilt < 90 for tilt in self.tilts_deg):
            raise ValueError(f"site grid: tilts_deg must lie between -90 and 90, not {self.tilts_deg!r}")
        (a, b, c), (d, e, f) = self.axis, self.front
        normal = math.hypot(b * f - c * e, c * d - a * f, a * e - b * d)
        if normal < 1e-3 * max(math.hypot(a, b, c) * math.hypot(d, e, f), 1e-9):
            raise ValueError(f"site grid: front {self.front} must not point along axis {self.axis}")


def fetal_sites() -> SiteGrid:
    """Probe sites that look at the uterus of `fetal_abdomen` through the mother's front: mm and degrees."""
    return SiteGrid(
        heights_mm=tuple(float(height) for height in range(-60, 75, 15)),
        angles_deg=tuple(float(angle) for angle in range(-48, 49, 12)),
        tilts_deg=(-15.0, 0.0, 15.0),
        rolls_deg=(0.0, 90.0),
        region=("uterus",),
    )
