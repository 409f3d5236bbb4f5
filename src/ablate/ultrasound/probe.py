"""Where a probe's scanlines, samples, elevational layers and pixels lie.

Probe axes: x lateral, z depth, y = z cross x elevational; the origin is the middle of the face. The scanlines of a
convex probe leave its face at right angles, so the centre of curvature, at z = -radius, is where they meet. Those of a
phased one meet in the origin: its fan is that of a radius of 0. Those of a linear one are parallel. Lengths are mm,
angles rad. What is different between the kinds of probe is in `fan_of`, and everything else asks there.
"""

import math
import operator
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ablate.ultrasound.settings import ConvexProbe, LinearProbe, PhasedProbe, Probe, SimulatorSettings

#: Of the face, across the image plane (assumed).
FACE_HALF_WIDTH_MM = 6.0


class Fan(NamedTuple):
    """The shape of a probe's fan; the position of a scanline is its angle, rad, or its x, mm, if all are parallel."""

    size_mm: tuple[float, float]  # height and width of the bounding box
    sag_mm: float  # along z from the middle of the face to its edges; 0 for a flat face
    reach_mm: float  # from where the scanlines meet to the deepest sample
    outer: float  # position of the last scanline
    width_mm: Callable[[np.ndarray], np.ndarray]  # from the first scanline to the last, at depths
    polar: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]  # depths and positions of points x, z
    lines: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]  # starts and directions, (n, 3) each, by positions
    #: How far a scanline that is steered by an angle, rad, goes to points at depths, mm, and how far beside them it
    #: starts, in positions.
    steered: Callable[[float, np.ndarray], tuple[np.ndarray, np.ndarray]]
    flat_face_mm: float | None = None  # where the face is not where the scanlines start


def _sector(probe: ConvexProbe | PhasedProbe, radius: float, flat_face_mm: float | None = None) -> Fan:
    """Scanlines that meet at `radius` behind their starts."""
    half, reach = math.radians(probe.fov_deg) / 2, radius + probe.depth_mm

    def lines(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        directions = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)
        return radius * directions - (0.0, 0.0, radius), directions

    def steered(angle: float, depth_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        from_centre = radius + depth_mm
        turned = np.arcsin(radius * math.sin(angle) / from_centre)  # its angle with the radius, by the law of sines
        return from_centre * np.cos(turned) - radius * math.cos(angle), turned - angle

    return Fan(
        size_mm=(reach - radius * math.cos(half), 2 * reach * math.sin(half)),
        sag_mm=radius * (1 - math.cos(half)),
        reach_mm=reach,
        outer=half,
        width_mm=lambda depth_mm: (radius + depth_mm) * (2 * half),
        polar=lambda x, z: (np.hypot(x, z + radius) - radius, np.arctan2(x, z + radius)),
        lines=lines,
        steered=steered,
        flat_face_mm=flat_face_mm,
    )


def _rectangle(probe: LinearProbe) -> Fan:
    """Parallel scanlines."""
    wide = probe.width_mm

    def lines(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        zero = np.zeros_like(x)
        return np.stack([x, zero, zero], axis=-1), np.stack([zero, zero, zero + 1], axis=-1)

    return Fan(
        size_mm=(probe.depth_mm, wide),
        sag_mm=0.0,
        reach_mm=wide + probe.depth_mm,
        outer=wide / 2,
        width_mm=lambda depth_mm: np.full(np.shape(depth_mm), wide),
        polar=lambda x, z: (z + np.zeros_like(x), x + np.zeros_like(z)),
        lines=lines,
        steered=lambda angle, depth_mm: (depth_mm / math.cos(angle), -math.tan(angle) * depth_mm),
    )


def fan_of(probe: Probe) -> Fan:
    """The shape of the fan of a probe of any kind."""
    if isinstance(probe, LinearProbe):
        return _rectangle(probe)
    return _sector(probe, 0.0, probe.aperture_mm) if isinstance(probe, PhasedProbe) else _sector(probe, probe.radius_mm)


def check_pose(pose: np.ndarray) -> np.ndarray:
    """A pose as (4, 4) float64, probe to world, mm; a ValueError when it is not a finite rigid transform."""
    pose = np.asarray(pose, dtype=np.float64) + 0.0  # no -0.0: a hash of the bytes is that of the pose
    if pose.shape != (4, 4):
        raise ValueError(f"pose must have shape (4, 4), not {pose.shape}")
    if not np.isfinite(pose).all():
        raise ValueError("pose must be finite")
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-5:
        raise ValueError("pose must be rigid: the columns of pose[:3, :3] are not orthonormal to 1e-5")
    if np.linalg.det(rotation) < 0:
        raise ValueError("pose must be rigid: the determinant of pose[:3, :3] is -1, a mirror image")
    if np.abs(pose[3] - (0.0, 0.0, 0.0, 1.0)).max() > 1e-9:
        raise ValueError(f"pose must end with the row (0, 0, 0, 1), not {pose[3].tolist()}")
    return pose


def check_seed(seed: int) -> int:
    """A seed as an int; a ValueError when it is negative, a TypeError when it is no whole number."""
    seed = operator.index(seed)
    if seed < 0:
        raise ValueError(f"seed must be at least 0, not {seed}")
    return seed


def pixel_size_mm(probe: Probe, shape: tuple[int, int]) -> tuple[float, float]:
    """Height and width, mm, of a pixel of an image of the fan's bounding box; the two axes scale independently."""
    height, width = fan_of(probe).size_mm
    return height / shape[0], width / shape[1]


def square_pixels(probe: Probe, rows: int) -> tuple[int, int]:
    """The shape of an image of so many rows whose pixels are as wide as they are high, to half a pixel."""
    height, width = fan_of(probe).size_mm
    return rows, max(1, round(rows * width / height))


def pixel_coordinates_mm(probe: Probe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Centres x, (W,), and z, (H,), float64 in mm, of the pixels of an image of the fan's bounding box.

    The first row begins `Fan.sag_mm` above the middle of the face.
    """
    rows, columns = shape
    height, width = fan_of(probe).size_mm
    x = (np.arange(columns) + 0.5) * (width / columns) - width / 2
    z = (np.arange(rows) + 0.5) * (height / rows) - fan_of(probe).sag_mm
    return x, z


def pixel_polar(probe: Probe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Depth along its scanline and position of that scanline, twice (H, W) float64, of every pixel's centre.

    Depths are mm below the face. Positions are those of `scanline_positions`: angles, or mm for parallel scanlines.
    """
    x, z = pixel_coordinates_mm(probe, shape)
    return fan_of(probe).polar(x, z[:, None])


def fan_mask(probe: Probe, shape: tuple[int, int]) -> np.ndarray:
    """Pixels whose centre lies in the fan, (H, W) bool."""
    depth, position = pixel_polar(probe, shape)
    return (depth >= 0) & (depth <= probe.depth_mm) & (np.abs(position) <= fan_of(probe).outer)


def position_maps(
    probe: Probe, image_shape: tuple[int, int] | None, beam_shape: tuple[int, int]
) -> dict[str, np.ndarray]:
    """Where each value lies: its depth, and the position of its scanline, float32 in [-1, 1], by name.

    They are `depth` and `lateral`, of the pixels, 0 outside the fan, or without `image_shape` of beam space.
    """
    if image_shape is None:
        rows, lines = beam_shape
        depth = np.repeat((2 * (np.arange(rows) + 0.5) / rows - 1)[:, None], lines, axis=1)
        lateral = np.repeat(np.linspace(-1, 1, lines)[None] if lines > 1 else np.zeros((1, 1)), rows, axis=0)
        return {"depth": depth.astype(np.float32), "lateral": lateral.astype(np.float32)}
    depth, position = pixel_polar(probe, image_shape)
    inside = fan_mask(probe, image_shape)
    maps = {"depth": 2 * depth / probe.depth_mm - 1, "lateral": position / fan_of(probe).outer}
    return {name: np.where(inside, values, 0).astype(np.float32) for name, values in maps.items()}


def scanline_positions(probe: Probe, scanlines: int) -> np.ndarray:
    """Positions of the scanlines, (scanlines,) float64, growing with x; the outer ones bound the fan.

    They are angles, rad; for the parallel scanlines of a linear array they are x, mm.
    """
    if scanlines == 1:
        return np.zeros(1)
    last = fan_of(probe).outer
    return np.linspace(-last, last, scanlines)


def sample_depths_mm(probe: Probe, samples: int) -> np.ndarray:
    """Depths of the axial samples, (samples,) float64, mm: the middles of equal parts of the depth."""
    return (np.arange(samples) + 0.5) * (probe.depth_mm / samples)


def layer_offsets_mm(settings: SimulatorSettings) -> np.ndarray:
    """Offsets of the layers' planes along the probe's y, (layers,) float64, mm; one layer is the image plane."""
    if settings.layers == 1:
        return np.zeros(1)
    return np.linspace(-settings.layer_extent_mm, settings.layer_extent_mm, settings.layers)


def fan_lines(probe: Probe, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts, (count, 3) float64, mm, and unit directions at equal steps from edge to edge of the fan.

    They do not depend on how many scanlines there are.
    """
    return fan_of(probe).lines(np.linspace(-0.5, 0.5, count) * (2 * fan_of(probe).outer))


def face_arc(probe: Probe, count: int) -> np.ndarray:
    """Points of the face in the image plane from edge to edge, (count, 3) float64, mm: an arc, or a straight line."""
    width_mm = fan_of(probe).flat_face_mm
    if width_mm is not None:
        return np.linspace(-0.5, 0.5, count)[:, None] * (width_mm, 0.0, 0.0)
    return fan_lines(probe, count)[0]


def face_points(probe: Probe) -> np.ndarray:
    """Points all over the face, (n, 3) float64, mm: along it 29, across it its edges and its middle."""
    arc = face_arc(probe, 29)
    offsets = (-FACE_HALF_WIDTH_MM, 0.0, FACE_HALF_WIDTH_MM)
    return np.concatenate([arc + np.array([0.0, offset, 0.0]) for offset in offsets])


def fan_outline(probe: Probe) -> np.ndarray:
    """The fan's closed border in the image plane, (n, 3) float64, mm."""
    starts, directions = fan_lines(probe, 41)
    deepest = starts + probe.depth_mm * directions
    return np.concatenate([starts, deepest[::-1], starts[:1]])


def scanlines_in_plane(
    probe: Probe, scanlines: int, offsets_mm: np.ndarray, steered_rad: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """The scanlines of some planes.

    Parameters
    ----------
    probe : Probe
        Its face.
    scanlines : int
        Of each plane.
    offsets_mm : (planes,) float
        Of the planes, along the probe's y.
    steered_rad : float
        Angle that the scanlines are turned by in their plane, about their starts, towards growing x.

    Returns
    -------
    starts, directions : (planes, scanlines, 3) float64
        mm, and unit vectors.
    """
    planes = len(offsets_mm)
    line = fan_of(probe).lines(scanline_positions(probe, scanlines))
    if steered_rad:
        ahead = line[1]
        aside = np.stack([ahead[:, 2], ahead[:, 1], -ahead[:, 0]], axis=-1)
        line = line[0], math.cos(steered_rad) * ahead + math.sin(steered_rad) * aside
    starts, directions = (np.tile(part, (planes, 1, 1)) for part in line)
    starts[..., 1] += np.asarray(offsets_mm)[:, None]
    return starts, directions


def to_world(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3), mm, from probe to world coordinates."""
    return points @ pose[:3, :3].T + pose[:3, 3]
