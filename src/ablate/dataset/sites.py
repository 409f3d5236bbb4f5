"""Probe sites: a regular grid of poses on the outer surface of a scene, and why some of them are left out."""

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ablate.anatomy import Scene, SiteGrid
from ablate.dataset.contact import Skin, meets, press
from ablate.ultrasound import ConvexProbe, Probe


@dataclass(frozen=True)
class Pose:
    """One probe pose: a rigid transform, (4, 4) float64, mm, and the index of its (height, angle) pair.

    Frames of one site see almost the same anatomy.
    """

    probe_to_world: np.ndarray
    site: int


class Dropped(StrEnum):
    """Why a pose of the grid is not used."""

    no_skin = "the direction misses the body"
    off_body = "part of the face has no body before it"
    hard = "the face lies in bone or gas"
    off_region = "the fan misses the region of interest"


@dataclass(frozen=True)
class Placement:
    """The poses of a grid that can be used, in the order heights, angles, tilts, rolls, and how many cannot by reason.

    Every reason is a key of `dropped`; a pose counts once, under the first reason that holds.
    """

    poses: tuple[Pose, ...]
    dropped: dict[Dropped, int]

    def __str__(self) -> str:
        """One line for a log: poses and sites used, and what was dropped for which reason."""
        sites = len({pose.site for pose in self.poses})
        why = ", ".join(f"{count} {reason.value}" for reason, count in self.dropped.items() if count)
        said = f"; dropped {sum(self.dropped.values())}: {why}" if why else "; none dropped"
        return f"{len(self.poses)} probe poses at {sites} sites{said}"


def place_probe(scene: Scene, grid: SiteGrid, press_mm: float, probe: Probe | None = None) -> Placement:
    """Press the probe on the skin at every pose of a grid.

    The probe comes from outside along the mean inward normal of the skin around the point where a ray towards the
    body's axis first meets it, rolled and tilted, until the deepest part of its face lies `press_mm` under the
    undeformed skin. The skin is the first surface met, of whichever structure.

    Raises
    ------
    ValueError
        When the scene has no structure, lacks one that `grid.region` names, no pose is left, or `press_mm` is
        negative.
    """
    if not scene.structures:
        raise ValueError(f"scene '{scene.name}' has no structure to put a probe on")
    if press_mm < 0:
        raise ValueError(f"dataset.press_mm={press_mm}: allowed are 0 and more")
    probe = probe or ConvexProbe()
    skin, region = Skin(scene), _region(scene, grid)
    axis = _unit(np.asarray(grid.axis, float))
    front = np.asarray(grid.front, float)
    front = _unit(front - axis * (front @ axis))
    side = np.cross(axis, front)
    turns = [(tilt, roll) for tilt in grid.tilts_deg for roll in grid.rolls_deg]
    started: list[np.ndarray] = []
    approaches: list[np.ndarray] = []
    sites: list[int] = []
    places = [(height, angle) for height in grid.heights_mm for angle in np.deg2rad(grid.angles_deg)]
    for site, (height, angle) in enumerate(places):
        middle = skin.centre + axis * (height - skin.centre @ axis)
        contact = skin.contact(middle, np.cos(angle) * front + np.sin(angle) * side, axis)
        if contact is not None:
            point, inward = contact
            started += [_pose(point, inward, axis, tilt, roll) for tilt, roll in turns]
            approaches += [inward] * len(turns)
            sites += [site] * len(turns)
    dropped = dict.fromkeys(Dropped, 0)
    dropped[Dropped.no_skin] = len(places) * len(turns) - len(started)
    poses: tuple[Pose, ...] = ()
    if started:
        pressed = press(skin, probe, np.stack(started), np.stack(approaches), press_mm)
        kept = np.ones(len(started), bool)
        reasons = [(Dropped.off_body, ~pressed.on_body), (Dropped.hard, pressed.hard)]
        if region is not None:
            reasons.append((Dropped.off_region, ~meets(region, probe, pressed.poses)))
        for reason, holds in reasons:
            dropped[reason] = int((kept & holds).sum())
            kept &= ~holds
        poses = tuple(Pose(pressed.poses[i], sites[i]) for i in np.flatnonzero(kept))
    placement = Placement(poses, dropped)
    if not poses:
        raise ValueError(
            f"scene '{scene.name}': no probe pose can be used; check sites.heights and sites.angles ({placement})"
        )
    return placement


def probe_poses(scene: Scene, grid: SiteGrid, press_mm: float) -> tuple[Pose, ...]:
    """The usable poses of `place_probe` alone."""
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


def _pose(point: np.ndarray, inward: np.ndarray, axis: np.ndarray, tilt: float, roll: float) -> np.ndarray:
    """Face's middle at `point`, z along `inward`, rolled about z (0: x = z cross axis), then tilted about y."""
    x = _unit(np.cross(inward, axis))
    y = np.cross(inward, x)
    c, s = np.cos(np.deg2rad(roll)), np.sin(np.deg2rad(roll))
    x, y = c * x + s * y, c * y - s * x
    c, s = np.cos(np.deg2rad(tilt)), np.sin(np.deg2rad(tilt))
    x, z = c * x - s * inward, c * inward + s * x
    pose = np.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = x, y, z, point
    return pose


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v)
