"""The rays of a frame as they leave the probe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ablate.ultrasound.draws import Draws
from ablate.ultrasound.embree import Geometry
from ablate.ultrasound.probe import layer_offsets_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import ConvexProbe, SimulatorSettings
from ablate.ultrasound.walk import inside_at

_STEEPEST_RAD = 0.3


@dataclass(frozen=True)
class ProbeRays:
    """Scanlines and rays in probe coordinates, the same for every pose.

    Attributes
    ----------
    starts, directions : (groups, 3) float64, mm
        Of the scanlines: the element on the face, and where it looks; layer by layer.
    origins, ray_directions : (groups * rays, 3) float64, mm
    """

    starts: np.ndarray
    directions: np.ndarray
    origins: np.ndarray
    ray_directions: np.ndarray


@dataclass(frozen=True)
class Bundle:
    """Scanlines and rays in the geometry's coordinates; a group is one scanline of one layer, layer by layer.

    Attributes
    ----------
    starts, directions : (groups, 3) float64
        Of the scanlines: the element on the face, and where it looks.
    origins, ray_directions : (groups * rays, 3) float32
    inside : (groups * rays, words) uint32
    """

    starts: np.ndarray
    directions: np.ndarray
    origins: np.ndarray
    ray_directions: np.ndarray
    inside: np.ndarray


def probe_rays(probe: ConvexProbe, settings: SimulatorSettings, draws: Draws) -> ProbeRays:
    """Rays spread over the aperture, all at `focus_mm` from the focal point of their scanline and layer.

    Because path lengths to the focus agree, a point at the focus stays a point.
    """
    starts, directions = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings))
    starts, directions = starts.reshape(-1, 3), directions.reshape(-1, 3)
    lateral = np.stack([directions[:, 2], np.zeros(len(directions)), -directions[:, 0]], axis=-1)
    jitter = (2 * draws.aperture() - 1).astype(np.float64)
    half_angles = np.array([settings.aperture_mm, settings.elevational_aperture_mm]) / settings.focus_mm
    tilt_x, tilt_y = np.minimum(half_angles, _STEEPEST_RAD)[:, None, None] * jitter
    rays = directions[:, None] + np.tan(tilt_x)[..., None] * lateral[:, None] + np.tan(tilt_y)[..., None] * (0, 1, 0)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    origins = (starts + settings.focus_mm * directions)[:, None] - settings.focus_mm * rays
    return ProbeRays(starts, directions, origins.reshape(-1, 3), rays.reshape(-1, 3))


def leave_probe(geometry: Geometry, rays: ProbeRays, pose: np.ndarray) -> Bundle:
    """The rays at a pose; which structures each starts inside of is found by crossings, from outside everything.

    Parameters
    ----------
    geometry : Geometry
    rays : ProbeRays
    pose : (4, 4) float64
        Probe to the geometry's coordinates, mm.

    Returns
    -------
    Bundle
    """
    rotation = pose[:3, :3]
    starts, directions = to_world(pose, rays.starts), rays.directions @ rotation.T
    origins, ray_directions = to_world(pose, rays.origins), rays.ray_directions @ rotation.T
    return Bundle(
        starts=starts,
        directions=directions,
        origins=origins.astype(np.float32),
        ray_directions=ray_directions.astype(np.float32),
        inside=_inside(geometry, starts, directions, origins, ray_directions),
    )


def _inside(
    geometry: Geometry, starts: np.ndarray, directions: np.ndarray, origins: np.ndarray, rays: np.ndarray
) -> np.ndarray:
    """The sets at the rays' origins: those of their element, unless some surface lies between.

    Then each ray of that group is followed from outside in its own direction: along the face, which nearly lies in
    the skin, a crossing can be missed, and a ray without the loss of its tissue outshines all others.
    """
    of_group = len(origins) // len(starts)
    inside = np.repeat(inside_at(geometry, starts, directions), of_group, axis=0)
    element = np.repeat(starts, of_group, axis=0)
    aside = origins - element
    length = np.sqrt(np.einsum("ij,ij->i", aside, aside))
    towards = (aside / np.maximum(length, 1e-12)[:, None]).astype(np.float32)
    between = geometry.closest(element.astype(np.float32), towards, length.astype(np.float32)).structure >= 0
    unsure = np.flatnonzero(np.repeat(between.reshape(-1, of_group).any(axis=1), of_group))
    inside[unsure] = inside_at(geometry, origins[unsure], rays[unsure])
    return inside
