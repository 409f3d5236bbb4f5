"""Probe sites: a regular grid of poses, pressed on the outer surface of a scene, and why some of them are left out."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import product
from typing import Any

import numpy as np
from trimesh import unitize

from ablate.anatomy import Scene, SiteGrid, TissueKind, bounds_mm
from ablate.ultrasound import ConvexProbe, Probe
from ablate.ultrasound.probe import face_points, fan_lines

_PATCH_MM = 12.0  # half-width of the skin patch whose mean normal the probe follows
_LINES = 32  # of a fan that is asked whether it meets something
_LEAST_SHARE = 0.1  # of them, or the fan misses it


class Skin:
    """The outside of a scene with at least one structure, to be met by rays; `centre` is that of its bounds, mm."""

    def __init__(self, scene: Scene) -> None:
        from ablate.ultrasound.surfaces.geometry import Geometry  # pairs made elsewhere need no Embree

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
        from ablate.ultrasound.surfaces.line_walk import inside_at, owners

        return self._hard[owners(inside_at(self._geometry, points - self.centre, directions))]

    def seen_from(self, probe: Probe, poses: np.ndarray) -> np.ndarray:
        """Whether at least a tenth of a fan's lines meet a surface within the imaging depth, (n,) bool."""
        starts, directions = fan_lines(probe, _LINES)
        local = (_in_world(poses, starts) - self.centre).astype(np.float32)
        rays = np.einsum("nij,kj->nki", poses[:, :3, :3], directions).reshape(-1, 3).astype(np.float32)
        hits = self._geometry.closest(local, rays, np.full(len(local), probe.depth_mm, np.float32))
        return (hits.structure >= 0).reshape(len(poses), _LINES).mean(axis=1) >= _LEAST_SHARE

    def contact(
        self, height_mm: float, angle: float, axis: np.ndarray, front: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Skin point and inward normal of a site, from nine parallel rays around it.

        Parameters
        ----------
        height_mm : float
            Of the site along the body's axis.
        angle : float, rad
            Of the site about the axis, from the front.
        axis, front : (3,) float
            Unit vectors of the body.

        Returns
        -------
        (3,) float, mm, and (3,) float, or None
            None where the middle ray misses.
        """
        middle = self.centre + axis * (height_mm - self.centre @ axis)
        outward = np.cos(angle) * front + np.sin(angle) * np.cross(axis, front)
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


def press(
    skin: Skin, probe: Probe, poses: np.ndarray, approaches: np.ndarray, press_mm: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Move probes along their approach until the deepest point of each face lies in the skin.

    Parameters
    ----------
    skin : Skin
    probe : Probe
    poses : (n, 4, 4) float, mm
        Probe to world.
    approaches : (n, 3) float
        Unit vectors into the body; a probe's own z may be tilted against its approach.
    press_mm : float
        How deep that point lies.

    Returns
    -------
    poses : (n, 4, 4) float64, mm
    on_body : (n,) bool
        Whether all of the face has body before it.
    hard : (n,) bool
        Whether any of it lies in bone or gas.
    """
    if not np.isfinite(press_mm):
        raise ValueError(f"press_mm={press_mm}: allowed are finite numbers")
    face = face_points(probe)
    shape = (len(poses), len(face))
    directions = np.repeat(approaches, len(face), axis=0)
    depth = skin.depth(_in_world(poses, face), directions).reshape(shape)
    on_body = np.isfinite(depth).all(axis=1)
    deepest = depth.max(axis=1)
    pressed = poses.copy()
    pressed[:, :3, 3] += np.where(np.isfinite(deepest), press_mm - deepest, 0.0)[:, None] * approaches
    hard = skin.hard_at(_in_world(pressed, face), directions).reshape(shape)
    return pressed, on_body, np.asarray(hard.any(axis=1))


def _in_world(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Each of k points through each of n poses, (n * k, 3)."""
    return (np.einsum("nij,kj->nki", poses[:, :3, :3], points) + poses[:, None, :3, 3]).reshape(-1, 3)


class Dropped(StrEnum):
    """Why a pose of the grid is not used."""

    no_skin = "the direction misses the body"
    off_body = "part of the face has no body before it"
    hard = "the face lies in bone or gas"
    off_region = "the fan misses the region of interest"


@dataclass(frozen=True)
class Placement:
    """The poses of a grid that can be used, in the order heights, angles, tilts, rolls, and how many cannot by reason.

    `poses`, (n, 4, 4) float64, lead from probe to world, mm. `sites`, (n,) int64, are the indices of their (height,
    angle) pairs: frames of one site see almost the same anatomy. Every reason is a key of `dropped`; a pose counts
    once, under the first reason that holds.
    """

    poses: np.ndarray
    sites: np.ndarray
    dropped: dict[Dropped, int]

    def __str__(self) -> str:
        """One line for a log: poses and sites used, and what was dropped for which reason."""
        why = ", ".join(f"{count} {reason.value}" for reason, count in self.dropped.items() if count)
        dropped = f"; dropped {sum(self.dropped.values())}: {why}" if why else "; none dropped"
        return f"{len(self.poses)} probe poses at {len(np.unique(self.sites))} sites{dropped}"


def resample_grid(grid: SiteGrid, counts: Sequence[int] | None) -> SiteGrid:
    """The same ranges with other counts of heights, angles, tilts and rolls, equally spaced; None keeps the grid.

    A count of one keeps the middle of its range, and a range of one value has that value alone. Angles and rolls
    that do not rise go round: 340, 0, 20 is a range of 40 degrees.
    """
    if counts is None:
        return grid
    spread: dict[str, Any] = {}
    for name, count in zip(("heights_mm", "angles_deg", "tilts_deg", "rolls_deg"), counts, strict=True):
        given = np.asarray(getattr(grid, name), float)
        if name in ("angles_deg", "rolls_deg") and (np.diff(given) < 0).any():
            given = np.unwrap(given, period=360)
        lower = min(given)
        upper = max(given)
        places = np.linspace(lower, upper, count) if count > 1 else [(lower + upper) / 2]
        spread[name] = tuple(np.unique(places).tolist())
    return replace(grid, **spread)


def place_probe(scene: Scene, grid: SiteGrid, press_mm: float, probe: Probe | None = None) -> Placement:
    """Press the probe on the skin at every pose of a grid.

    The probe comes from outside along the mean inward normal of the skin around the point where a ray towards the
    body's axis first meets it, rolled and tilted, until the deepest part of its face lies `press_mm` under the
    undeformed skin. The skin is the first surface met, of whichever structure.

    Parameters
    ----------
    scene : Scene
    grid : SiteGrid
        Heights, angles, tilts and rolls, and the region that a fan must meet.
    press_mm : float
    probe : Probe, optional
        `ConvexProbe()` without it.

    Raises
    ------
    ValueError
        When the scene has no structure, lacks one that `grid.region` names, or no pose is left.
    """
    if not scene.structures:
        raise ValueError(f"scene '{scene.name}' has no structure to put a probe on")
    probe = probe or ConvexProbe()
    skin = Skin(scene)
    region = _region(scene, grid)
    started, approaches, sites = _on_skin(skin, grid)
    dropped = dict.fromkeys(Dropped, 0)
    asked_for = len(grid.heights_mm) * len(grid.angles_deg) * len(grid.tilts_deg) * len(grid.rolls_deg)
    dropped[Dropped.no_skin] = asked_for - len(sites)
    kept = np.ones(len(sites), bool)
    poses = started
    if len(sites):
        poses, on_body, hard = press(skin, probe, started, approaches, press_mm)
        reasons = {Dropped.off_body: ~on_body, Dropped.hard: hard}
        if region is not None:
            reasons[Dropped.off_region] = ~region.seen_from(probe, poses)
        for reason, holds in reasons.items():
            dropped[reason] = int((kept & holds).sum())
            kept &= ~holds
    placement = Placement(poses[kept], sites[kept], dropped)
    if not kept.any():
        raise ValueError(
            f"scene '{scene.name}': no probe pose can be used; check sites.heights and sites.angles ({placement})"
        )
    return placement


def _on_skin(skin: Skin, grid: SiteGrid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses on the skin, (n, 4, 4), approaches, (n, 3), and sites, (n,) int64, of a grid where its rays meet skin."""
    axis = unitize(np.asarray(grid.axis, float))
    front = np.asarray(grid.front, float)
    front = unitize(front - axis * (front @ axis))
    poses: list[np.ndarray] = []
    approaches: list[np.ndarray] = []
    sites: list[int] = []
    for site, (height, angle) in enumerate(product(grid.heights_mm, np.deg2rad(grid.angles_deg))):
        contact = skin.contact(height, angle, axis, front)
        if contact is None:
            continue
        point, inward = contact
        for tilt, roll in product(grid.tilts_deg, grid.rolls_deg):
            poses.append(turned_pose(point, inward, axis, tilt, roll))
            approaches.append(inward)
            sites.append(site)
    return np.reshape(poses, (-1, 4, 4)), np.reshape(approaches, (-1, 3)), np.array(sites, np.int64)


def probe_poses(scene: Scene, grid: SiteGrid, press_mm: float) -> np.ndarray:
    """The usable poses, (n, 4, 4) float64, of `place_probe` alone."""
    return place_probe(scene, grid, press_mm).poses


def _region(scene: Scene, grid: SiteGrid) -> Skin | None:
    """The surfaces that a fan should meet; None where the grid names none."""
    if not grid.region:
        return None
    names = [str(s.mesh.metadata.get("name")) for s in scene.structures]
    unknown = sorted(set(grid.region) - set(names))
    if unknown:
        raise ValueError(f"scene '{scene.name}': sites.region: no structure '{unknown[0]}'; known: {', '.join(names)}")
    chosen = tuple(s for s, name in zip(scene.structures, names, strict=True) if name in grid.region)
    return Skin(replace(scene, structures=chosen))


def turned_pose(
    point: np.ndarray, inward: np.ndarray, axis: np.ndarray, tilt: float = 0.0, roll: float = 0.0
) -> np.ndarray:
    """The pose of a probe on the skin.

    Parameters
    ----------
    point : (3,) float, mm
        The middle of the face.
    inward, axis : (3,) float
        Unit vectors: z before the probe is tilted, and the long axis of the body.
    tilt, roll : float, degrees
        It is rolled about z, from x = z cross axis, and then tilted about y.

    Returns
    -------
    (4, 4) float64, mm
        Probe to world.
    """
    across = unitize(np.cross(inward, axis))
    along = np.cross(inward, across)
    rolled = np.deg2rad(roll)
    x = np.cos(rolled) * across + np.sin(rolled) * along
    y = np.cos(rolled) * along - np.sin(rolled) * across
    tilted = np.deg2rad(tilt)
    z = np.cos(tilted) * inward + np.sin(tilted) * x
    x = np.cos(tilted) * x - np.sin(tilted) * inward
    return np.vstack([np.column_stack([x, y, z, point]), [0.0, 0.0, 0.0, 1.0]])
