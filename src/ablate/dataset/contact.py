"""Where a probe touches a body, how far it can be pressed, and what lies before it."""

from dataclasses import dataclass

import numpy as np

from ablate.anatomy import Scene, TissueKind, bounds_mm
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import face_points, fan_lines
from ablate.ultrasound.surfaces.embree import Geometry
from ablate.ultrasound.surfaces.line_walk import inside_at, owners

_PATCH_MM = 12.0  # half-width of the skin patch whose mean normal the probe follows
_LINES = 32  # of a fan that is asked whether it meets something
_LEAST_SHARE = 0.1  # of them, or the fan misses it


class Skin:
    """The outside of a scene with at least one structure, to be met by rays; `centre` is that of its bounds, mm."""

    def __init__(self, scene: Scene) -> None:
        bounds = bounds_mm(s.mesh for s in scene.structures)
        self.centre = bounds.mean(axis=0)
        reach = float(np.linalg.norm(bounds[1] - bounds[0]))
        self._geometry = Geometry(scene.structures, bounds, self.centre, reach)
        hard = [s.tissue.kind in (TissueKind.bone, TissueKind.gas) for s in scene.structures]
        self._hard = np.array([False, *hard])  # first the background, whatever its tissue

    def depth(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """How deep points lie under the first surface met on the way in, (n,) float64, mm.

        Negative before it; minus infinity where the whole line meets nothing.
        """
        local = points - self.centre
        back, ahead = self._geometry.through(local, directions)
        starts = (local - back[:, None] * directions).astype(np.float32)
        hits = self._geometry.closest(starts, directions.astype(np.float32), (back + ahead).astype(np.float32))
        return np.where(hits.structure >= 0, back - hits.distance_mm, -np.inf)

    def hard_at(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Whether bone or gas owns points that are reached from outside along `directions`, (n,) bool."""
        return self._hard[owners(inside_at(self._geometry, points - self.centre, directions))]

    def within(self, starts: np.ndarray, directions: np.ndarray, reach_mm: float) -> np.ndarray:
        """Whether rays meet a surface within reach, (n,) bool."""
        local = (starts - self.centre).astype(np.float32)
        reach = np.full(len(local), reach_mm, np.float32)
        return self._geometry.closest(local, directions.astype(np.float32), reach).structure >= 0

    def contact(
        self, middle: np.ndarray, outward: np.ndarray, axis: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Skin point and inward normal, from nine parallel rays around a site; None where the middle one misses.

        `middle` lies on the body's axis, mm; the unit vector `outward` points from there to the site, `axis` along it.
        """
        across = np.cross(outward, axis)
        offsets = [(u, v) for v in (-_PATCH_MM, 0.0, _PATCH_MM) for u in (-_PATCH_MM, 0.0, _PATCH_MM)]
        starts = np.array([middle + across * u + axis * v for u, v in offsets])
        depth = self.depth(starts, np.tile(-outward, (len(starts), 1)))
        points = starts + outward * np.where(np.isfinite(depth), depth, 0.0)[:, None]
        if not np.isfinite(depth[4]):
            return None
        near = points[np.abs(depth - depth[4]) < 2 * _PATCH_MM]
        _, spread, axes = np.linalg.svd(near - near.mean(axis=0))
        normal = axes[2]
        if len(near) < 5 or spread[1] < 1e-6 or abs(normal @ outward) < 0.5:
            return points[4], -outward
        return points[4], -normal * np.sign(normal @ outward)


@dataclass(frozen=True)
class Pressed:
    """Poses after pressing, (n, 4, 4) float64, mm; for each whether all of the face has body before it, (n,) bool,
    and whether any of it lies in bone or gas, (n,) bool.
    """

    poses: np.ndarray
    on_body: np.ndarray
    hard: np.ndarray


def press(skin: Skin, probe: Probe, poses: np.ndarray, approaches: np.ndarray, press_mm: float) -> Pressed:
    """Move probes, (n, 4, 4), mm, along their approach until the deepest point of each face is `press_mm` in the skin.

    `approaches`, (n, 3), are unit vectors into the body; a probe's own z may be tilted against its approach.
    """
    face = face_points(probe)
    n, k = len(poses), len(face)
    directions = np.repeat(approaches, k, axis=0)
    depth = skin.depth(_in_world(poses, face), directions).reshape(n, k)
    on_body = np.isfinite(depth).all(axis=1)
    deepest = depth.max(axis=1)
    pressed = poses.copy()
    pressed[:, :3, 3] += np.where(np.isfinite(deepest), press_mm - deepest, 0.0)[:, None] * approaches
    hard = skin.hard_at(_in_world(pressed, face), directions).reshape(n, k)
    return Pressed(pressed, on_body, np.asarray(hard.any(axis=1)))


def meets(region: Skin, probe: Probe, poses: np.ndarray) -> np.ndarray:
    """Whether at least a tenth of a fan's lines meet a region within the imaging depth, (n,) bool."""
    starts, directions = fan_lines(probe, _LINES)
    rays = np.einsum("nij,kj->nki", poses[:, :3, :3], directions).reshape(-1, 3)
    met = region.within(_in_world(poses, starts), rays, probe.depth_mm).reshape(len(poses), _LINES)
    return met.mean(axis=1) >= _LEAST_SHARE


def _in_world(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Each of k points through each of n poses, (n * k, 3)."""
    return (np.einsum("nij,kj->nki", poses[:, :3, :3], points) + poses[:, None, :3, 3]).reshape(-1, 3)
