"""Where a convex probe's scanlines, samples, elevational layers and pixels lie.

Probe axes: x lateral, z depth, y = z cross x elevational; the origin is the middle of the face and the centre of
curvature lies at z = -radius. Lengths are mm, angles rad.
"""

from __future__ import annotations

import math

import numpy as np

from ablate.ultrasound.settings import ConvexProbe, SimulatorSettings


def check_pose(pose: np.ndarray) -> np.ndarray:
    """A pose as (4, 4) float64, probe to world, mm.

    Raises
    ------
    ValueError
        When it is not a finite rigid transform.
    """
    pose = np.asarray(pose, dtype=np.float64)
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


def fan_size_mm(probe: ConvexProbe) -> tuple[float, float]:
    """Height and width of the fan's bounding box, mm."""
    half = math.radians(probe.fov_deg) / 2
    outer = probe.radius_mm + probe.depth_mm
    return outer - probe.radius_mm * math.cos(half), 2 * outer * math.sin(half)


def pixel_coordinates_mm(probe: ConvexProbe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Centres of the pixels of an image of the fan's bounding box.

    Returns
    -------
    x : (W,) float64, mm
    z : (H,) float64, mm
        Row 0 lies radius (1 - cos(fov / 2)) above the middle of the face.
    """
    rows, columns = shape
    height, width = fan_size_mm(probe)
    sag = probe.radius_mm * (1 - math.cos(math.radians(probe.fov_deg) / 2))
    x = (np.arange(columns) + 0.5) * (width / columns) - width / 2
    z = (np.arange(rows) + 0.5) * (height / rows) - sag
    return x, z


def pixel_polar(probe: ConvexProbe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Depth below the face (H, W) float64, mm, and angle (H, W) float64, rad, of every pixel's centre."""
    x, z = pixel_coordinates_mm(probe, shape)
    from_centre = z[:, None] + probe.radius_mm
    return np.hypot(x, from_centre) - probe.radius_mm, np.arctan2(x, from_centre)


def fan_mask(probe: ConvexProbe, shape: tuple[int, int]) -> np.ndarray:
    """Pixels whose centre lies in the fan, (H, W) bool."""
    depth, angle = pixel_polar(probe, shape)
    half = math.radians(probe.fov_deg) / 2
    return (depth >= 0) & (depth <= probe.depth_mm) & (np.abs(angle) <= half)


def scanline_angles(probe: ConvexProbe, scanlines: int) -> np.ndarray:
    """Angles of the scanlines, (scanlines,) float64, rad, growing with x; the outer ones bound the fan."""
    if scanlines == 1:
        return np.zeros(1)
    half = math.radians(probe.fov_deg) / 2
    return np.linspace(-half, half, scanlines)


def scanline_spacing_mm(probe: ConvexProbe, scanlines: int, depth_mm: np.ndarray) -> np.ndarray:
    """Distance between neighbouring scanlines at some depths, mm; infinite where there is one line only."""
    if scanlines == 1:
        return np.full_like(depth_mm, np.inf)
    return (probe.radius_mm + depth_mm) * math.radians(probe.fov_deg) / (scanlines - 1)


def sample_depths_mm(probe: ConvexProbe, samples: int) -> np.ndarray:
    """Depths of the axial samples, (samples,) float64, mm: the middles of equal parts of the depth."""
    return (np.arange(samples) + 0.5) * (probe.depth_mm / samples)


def layer_offsets_mm(settings: SimulatorSettings) -> np.ndarray:
    """Offsets of the layers' planes along the probe's y, (layers,) float64, mm; one layer is the image plane."""
    if settings.layers == 1:
        return np.zeros(1)
    return np.linspace(-settings.layer_extent_mm, settings.layer_extent_mm, settings.layers)


def scanlines_in_plane(probe: ConvexProbe, scanlines: int, offsets_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and unit directions of the scanlines of parallel planes, in probe coordinates.

    Parameters
    ----------
    probe : ConvexProbe
    scanlines : int
    offsets_mm : (planes,) float
        Along y.

    Returns
    -------
    starts, directions : (planes, scanlines, 3) float64, mm
    """
    angle = scanline_angles(probe, scanlines)
    direction = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=-1)
    directions = np.broadcast_to(direction, (len(offsets_mm), scanlines, 3)).copy()
    starts = probe.radius_mm * directions - (0.0, 0.0, probe.radius_mm)
    starts[..., 1] += np.asarray(offsets_mm)[:, None]
    return starts, directions


def to_world(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3), mm, from probe to world coordinates."""
    return points @ pose[:3, :3].T + pose[:3, 3]
