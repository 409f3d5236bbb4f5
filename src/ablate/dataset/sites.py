"""Probe sites: a regular grid of poses on the outer surface of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import trimesh
from trimesh.ray.ray_pyembree import RayMeshIntersector

from ablate.anatomy import Scene, SiteGrid

_PATCH_MM = 12.0  # half-width of the skin patch whose mean normal the probe follows


@dataclass(frozen=True)
class Pose:
    """One probe pose.

    Attributes
    ----------
    probe_to_world : (4, 4) float64
        Rigid transform, mm.
    site : int
        Index of the (height, angle) pair it belongs to; frames of one site see almost the same anatomy.
    """

    probe_to_world: np.ndarray
    site: int


def resample_grid(grid: SiteGrid, counts: Sequence[int] | None) -> SiteGrid:
    """The same ranges with other counts.

    Parameters
    ----------
    grid : SiteGrid
    counts : sequence of 4 int, or None
        Number of heights, angles, tilts and rolls; None keeps the grid.

    Returns
    -------
    SiteGrid
        A count of one keeps the middle of its range; equal spacing otherwise.

    Raises
    ------
    ValueError
        When a count is below one.
    """
    if counts is None:
        return grid
    if len(counts) != 4 or min(counts) < 1:
        raise ValueError(f"dataset.grid={list(counts)}: four counts of at least 1 (heights, angles, tilts, rolls)")

    def spread(values: Sequence[float], count: int) -> tuple[float, ...]:
        low, high = min(values), max(values)
        if count == 1:
            return ((low + high) / 2,)
        return tuple(float(v) for v in np.linspace(low, high, count))

    heights, angles, tilts, rolls = counts
    return replace(
        grid,
        heights_mm=spread(grid.heights_mm, heights),
        angles_deg=spread(grid.angles_deg, angles),
        tilts_deg=spread(grid.tilts_deg, tilts),
        rolls_deg=spread(grid.rolls_deg, rolls),
    )


def probe_poses(scene: Scene, grid: SiteGrid, press_mm: float) -> tuple[Pose, ...]:
    """Poses of the whole grid, in the order heights, angles, tilts, rolls; directions that miss are dropped.

    The probe's face touches the outermost surface that a ray from outside towards the body's axis meets, is
    pressed in by `press_mm`, and looks along the mean inward normal of the skin around it.

    Parameters
    ----------
    scene : Scene
        With at least one structure.
    grid : SiteGrid
    press_mm : float
        How far the middle of the face lies under the undeformed skin, mm.

    Raises
    ------
    ValueError
        When the scene has no structure, or no site of the grid meets the body.
    """
    if not scene.structures:
        raise ValueError(f"scene '{scene.name}' has no structure to put a probe on")
    body = trimesh.util.concatenate([s.mesh for s in scene.structures])
    surface = RayMeshIntersector(body)
    low, high = body.bounds
    centre, reach = (low + high) / 2, float(np.linalg.norm(high - low))
    axis = _unit(np.asarray(grid.axis, float))
    front = np.asarray(grid.front, float)
    front = _unit(front - axis * (front @ axis))
    side = np.cross(axis, front)
    poses: list[Pose] = []
    site = 0
    for height in grid.heights_mm:
        middle = centre + axis * (height - centre @ axis)
        for angle in np.deg2rad(grid.angles_deg):
            outward = np.cos(angle) * front + np.sin(angle) * side
            contact = _contact(surface, middle, outward, axis, reach)
            if contact is not None:
                point, depth = contact
                for tilt in grid.tilts_deg:
                    for roll in grid.rolls_deg:
                        poses.append(Pose(_pose(point, depth, axis, tilt, roll, press_mm), site))
            site += 1
    if not poses:
        raise ValueError(f"scene '{scene.name}': no probe site meets the body; check sites.heights and sites.angles")
    return tuple(poses)


def _contact(
    surface: RayMeshIntersector, middle: np.ndarray, outward: np.ndarray, axis: np.ndarray, reach: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Skin point and inward normal, from nine parallel rays around the site; None where the middle one misses."""
    across = np.cross(outward, axis)
    offsets = [(u, v) for v in (-_PATCH_MM, 0.0, _PATCH_MM) for u in (-_PATCH_MM, 0.0, _PATCH_MM)]
    starts = np.array([middle + outward * reach + across * u + axis * v for u, v in offsets])
    directions = np.tile(-outward, (len(starts), 1))
    points, rays, _ = surface.intersects_location(starts, directions, multiple_hits=False)
    if 4 not in rays:
        return None
    point = points[list(rays).index(4)]
    near = points[np.abs((points - point) @ outward) < 2 * _PATCH_MM]
    if len(near) < 3:
        return point, -outward
    _, spread, axes = np.linalg.svd(near - near.mean(0))
    normal = axes[2]
    if len(near) < 5 or spread[1] < 1e-6 or abs(normal @ outward) < 0.5:
        return point, -outward
    return point, -normal * np.sign(normal @ outward)


def _pose(
    point: np.ndarray, depth: np.ndarray, axis: np.ndarray, tilt: float, roll: float, press_mm: float
) -> np.ndarray:
    """Transform with z along `depth`, rolled about z (0: x = z cross axis), then tilted about the probe's y."""
    x = _unit(np.cross(depth, axis))
    y = np.cross(depth, x)
    c, s = np.cos(np.deg2rad(roll)), np.sin(np.deg2rad(roll))
    x, y = c * x + s * y, c * y - s * x
    c, s = np.cos(np.deg2rad(tilt)), np.sin(np.deg2rad(tilt))
    x, z = c * x - s * depth, c * depth + s * x
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2] = x, y, z
    pose[:3, 3] = point + press_mm * depth
    return pose


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
