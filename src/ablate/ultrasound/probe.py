"""Where a convex probe's scanlines, samples, elevational layers and pixels lie.

Probe axes: x lateral, z depth, y = z cross x elevational; the origin is the middle of the face and the centre of
curvature lies at z = -radius. Lengths are mm, angles rad.
"""

import math

import numpy as np

from ablate.ultrasound.settings import ConvexProbe, SimulatorSettings

#: Of the face, across the image plane (assumed).
FACE_HALF_WIDTH_MM = 6.0


def check_pose(pose: np.ndarray) -> np.ndarray:
    """A pose as (4, 4) float64, probe to world, mm; a ValueError when it is not a finite rigid transform."""
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


def pixel_size_mm(probe: ConvexProbe, shape: tuple[int, int]) -> tuple[float, float]:
    """Height and width, mm, of a pixel of an image of the fan's bounding box; the two axes scale independently."""
    height, width = fan_size_mm(probe)
    return height / shape[0], width / shape[1]


def face_sag_mm(probe: ConvexProbe) -> float:
    """Distance along z from the middle of the face to its edges, mm."""
    return probe.radius_mm * (1 - math.cos(math.radians(probe.fov_deg) / 2))


def pixel_coordinates_mm(probe: ConvexProbe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Centres x, (W,), and z, (H,), float64 in mm, of the pixels of an image of the fan's bounding box.

    The image begins `face_sag_mm` above the middle of the face.
    """
    rows, columns = shape
    height, width = fan_size_mm(probe)
    x = (np.arange(columns) + 0.5) * (width / columns) - width / 2
    z = (np.arange(rows) + 0.5) * (height / rows) - face_sag_mm(probe)
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


def sample_depths_mm(probe: ConvexProbe, samples: int) -> np.ndarray:
    """Depths of the axial samples, (samples,) float64, mm: the middles of equal parts of the depth."""
    return (np.arange(samples) + 0.5) * (probe.depth_mm / samples)


def layer_offsets_mm(settings: SimulatorSettings) -> np.ndarray:
    """Offsets of the layers' planes along the probe's y, (layers,) float64, mm; one layer is the image plane."""
    if settings.layers == 1:
        return np.zeros(1)
    return np.linspace(-settings.layer_extent_mm, settings.layer_extent_mm, settings.layers)


def on_face(probe: ConvexProbe, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points of the face in the image plane, (n, 3) float64, mm, and its outward unit normals there, (n, 3)."""
    normals = np.stack([np.sin(angles), np.zeros_like(angles), np.cos(angles)], axis=-1)
    return probe.radius_mm * normals - (0.0, 0.0, probe.radius_mm), normals


def face_arc(probe: ConvexProbe, count: int) -> tuple[np.ndarray, np.ndarray]:
    """`on_face` at equal angles from edge to edge, however many scanlines there are."""
    return on_face(probe, np.linspace(-0.5, 0.5, count) * math.radians(probe.fov_deg))


def face_points(probe: ConvexProbe, along: int = 29, across: int = 3) -> np.ndarray:
    """Points all over the face, (along * across, 3) float64, mm."""
    arc, _ = face_arc(probe, along)
    offsets = np.linspace(-FACE_HALF_WIDTH_MM, FACE_HALF_WIDTH_MM, across)
    return np.concatenate([arc + np.array([0.0, offset, 0.0]) for offset in offsets])


def fan_outline(probe: ConvexProbe, points: int = 41) -> np.ndarray:
    """The fan's closed border in the image plane, (2 points + 1, 3) float64, mm."""
    face, normals = face_arc(probe, points)
    deepest = face + probe.depth_mm * normals
    return np.concatenate([face, deepest[::-1], face[:1]])


def scanlines_in_plane(probe: ConvexProbe, scanlines: int, offsets_mm: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and unit directions, (planes, scanlines, 3) float64, mm, of the scanlines of planes at offsets along y."""
    planes = len(offsets_mm)
    starts, directions = (np.tile(part, (planes, 1, 1)) for part in on_face(probe, scanline_angles(probe, scanlines)))
    starts[..., 1] += np.asarray(offsets_mm)[:, None]
    return starts, directions


def to_world(pose: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (..., 3), mm, from probe to world coordinates."""
    return points @ pose[:3, :3].T + pose[:3, 3]
