"""How the probe is held: five degrees of freedom on the skin, and the pose that they give."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation
from trimesh import unitize
from trimesh.bounds import corners

from ablate.anatomy import Scene, bounds_mm
from ablate.dataset.sites import Skin, press, turned_pose
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import face_points, to_world

_SEARCHES = 6  # for the hold of a pose, or that looks at a point: each takes most of what is left of the distance
_MOST_TURNED_DEG = 45.0
_DEEPEST_MM = 10.0  # that all of the face is under the skin: a transducer dents it by less


@dataclass(frozen=True)
class Hold:
    """Where the probe stands and how it is turned against the skin there.

    `height_mm` is along the body's axis and `angle_deg` about it, from the front. `roll_deg` turns the probe about its
    own axis (0 transverse, 90 sagittal), `rock_deg` within its image plane, `tilt_deg` out of it.
    """

    height_mm: float
    angle_deg: float
    roll_deg: float = 0.0
    rock_deg: float = 0.0
    tilt_deg: float = 0.0


class Hand:
    """Holds the probe on the skin of a scene.

    Parameters
    ----------
    scene : Scene
        The body.
    axis : (3,) tuple of float
        Its long axis.
    front : (3,) tuple of float
        The side that angle 0 looks at.
    press_mm : float
        How far the deepest part of the face is pressed in.
    probe : Probe
        The probe that is held.
    """

    def __init__(
        self, scene: Scene, axis: tuple[float, ...], front: tuple[float, ...], press_mm: float, probe: Probe
    ) -> None:
        self._skin = Skin(scene)
        self._press_mm = press_mm
        self._probe = probe
        self.axis = unitize(np.asarray(axis, float))
        across = np.asarray(front, float)
        self.front = unitize(across - self.axis * (across @ self.axis))
        self._side = np.cross(self.axis, self.front)
        along = corners(bounds_mm(s.mesh for s in scene.structures)) @ self.axis
        self.heights_mm = (float(along.min()), float(along.max()))

    def take(self, probe: Probe, press_mm: float) -> None:
        """Take another probe, which is pressed in by so much."""
        self._probe = probe
        self._press_mm = press_mm

    def place(self, hold: Hold) -> tuple[np.ndarray, str] | None:
        """Press the probe on the skin; None where the body has no skin at that height and angle.

        Returns the pose, (4, 4) float64, mm, and what is wrong with it; empty if the face lies on the skin.
        """
        contact = self._skin.contact(hold.height_mm, np.deg2rad(hold.angle_deg), self.axis, self.front)
        if contact is None:
            return None
        point, inward = contact
        pose = turned_pose(point, inward, self.axis, hold.rock_deg, hold.roll_deg)
        pose[:3, :3] @= Rotation.from_euler("X", hold.tilt_deg, degrees=True).as_matrix()
        poses, on_body, hard = press(self._skin, self._probe, pose[None], inward[None], self._press_mm)
        return poses[0], _words(bool(on_body[0]), bool(hard[0]))

    def aim(self, point: np.ndarray, angles_deg: Iterable[float]) -> np.ndarray | None:
        """The pose whose beam axis goes through a point at its height, from the nearest of some angles about the body.

        None if at every angle a part of the face is off the skin or on bone or gas, the point is deeper than the image,
        or the probe would be turned by more than `_MOST_TURNED_DEG`.
        """
        aimed = [self._aim_from(point, float(angle)) for angle in angles_deg]
        usable = [depth_and_pose for depth_and_pose in aimed if depth_and_pose is not None]
        return min(usable, key=lambda depth_and_pose: depth_and_pose[0])[1] if usable else None

    def _aim_from(self, point: np.ndarray, angle_deg: float) -> tuple[float, np.ndarray] | None:
        """The depth of a point, mm, and the pose that looks at it from one angle; None as for `aim`."""
        hold = Hold(self.site_of(point)[0], angle_deg)
        for _ in range(_SEARCHES):
            placed = self.place(hold)
            if placed is None:
                return None
            pose, words = placed
            away = (point - pose[:3, 3]) @ pose[:3, :3]
            rock, tilt = np.rad2deg(np.arctan2(away[:2], away[2]))
            hold = replace(hold, rock_deg=hold.rock_deg + float(rock), tilt_deg=hold.tilt_deg - float(tilt))
        depth_mm = float(away[2])
        on_axis = np.hypot(*away[:2]) < 1 and 0 < depth_mm < self._probe.depth_mm
        turned_deg = max(abs(hold.rock_deg), abs(hold.tilt_deg))
        return (depth_mm, pose) if not words and on_axis and turned_deg <= _MOST_TURNED_DEG else None

    def judge(self, pose: np.ndarray) -> str:
        """Say what is wrong with the contact of a pose that was not pressed; empty if nothing is."""
        face = to_world(pose, face_points(self._probe))
        inwards = np.tile(pose[:3, 2], (len(face), 1))
        depth = self._skin.depth(face, inwards)
        hard = bool(self._skin.hard_at(face, inwards).any())
        if depth.min() > max(_DEEPEST_MM, self._press_mm):
            return f"inside the body: the face is {depth.min():.0f} mm under the skin"
        return _words(bool(np.isfinite(depth).all() and depth.max() > 0), hard)

    def hold_of(self, pose: np.ndarray) -> Hold:
        """Find the hold that comes nearest to a pose: the same turn, the face as near as pressing allows."""
        target = pose[:3, 3]
        aim = target.copy()
        for _ in range(_SEARCHES):
            height, angle = self.site_of(aim)
            contact = self._skin.contact(height, np.deg2rad(angle), self.axis, self.front)
            if contact is None:
                return Hold(height, angle)
            inward = contact[1]
            turn = Rotation.from_matrix(turned_pose(*contact, self.axis)[:3, :3].T @ pose[:3, :3])
            hold = Hold(height, angle, *turn.as_euler("ZYX", degrees=True).tolist())
            held = self.place(hold)
            assert held is not None
            off = target - held[0][:3, 3]
            aim = aim + off - inward * (off @ inward)
        return hold

    def site_of(self, point: np.ndarray) -> tuple[float, float]:
        """Height along the axis, mm, and angle about it, degrees, of a point."""
        off = point - self._skin.centre
        return float(point @ self.axis), float(np.rad2deg(np.arctan2(off @ self._side, off @ self.front)))


def _words(on_body: bool, hard: bool) -> str:
    if not on_body:
        return "off the body: part of the face has no skin under it"
    return "in bone or gas: the face lies in what lets hardly any sound out" if hard else ""
