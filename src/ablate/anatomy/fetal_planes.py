"""Where the probe is held to see the fetus in the standard planes of a second-trimester examination."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ablate.anatomy.fetal_frame import LIE_ROTATION, abdomen_plane, curl, head_plane, to_world
from ablate.anatomy.fetal_organs import HEART_AXES, HEART_CENTER
from ablate.anatomy.fetal_skeleton import leg
from ablate.anatomy.mother import PLACENTA_TOWARDS, UTERUS_CENTER, UTERUS_RADII, torso

MOST_OBLIQUE_DEG = 35.0  # between the beam and the skin's normal
_ANGLES_DEG = np.arange(-72.0, 73.0, 3.0)  # about the mother's long axis, 0 in front
_HEIGHTS_MM = np.arange(-105.0, 106.0, 5.0)


@dataclass(frozen=True)
class _Plane:
    """A point to look at, the plane's normal, and, where it matters, the best direction of the beam (any sign)."""

    point: np.ndarray
    normal: np.ndarray
    beam: np.ndarray | None = None


def fetal_planes(seed: int = 0, press_mm: float = 8.0) -> dict[str, np.ndarray]:
    """Probe poses that show the standard planes of `fetal_abdomen(seed=seed)`, as well as the skin allows.

    The probe is on the mother's skin, its beam points at the middle of the structure, and its image plane is turned
    into the wanted plane; of all places on her front and flanks the one is taken where both fit best.

    Parameters
    ----------
    seed : int
        That of `fetal_abdomen`.
    press_mm : float
        How far the middle of the probe's face lies under the undeformed skin, mm.

    Returns
    -------
    dict of str to (4, 4) float64
        Probe to world, mm: `head` (BPD and HC), `abdomen` (AC), `four_chambers`, `femur`, `spine` (sagittal), and
        `placenta`.

    Raises
    ------
    ValueError
        When `seed` is negative.
    """
    if seed < 0:
        raise ValueError(f"fetal_planes: seed must be at least 0, not {seed}")
    return {name: _pose(plane, press_mm) for name, plane in _planes().items()}


def _planes() -> dict[str, _Plane]:
    head, head_normal = head_plane()
    abdomen, abdomen_normal = abdomen_plane()
    heart, base = to_world(curl(np.stack([HEART_CENTER, HEART_CENTER + 0.1 * HEART_AXES[:, 2]])))
    hip, knee = to_world(np.stack(leg(1.0)[:2]))
    spine = to_world(curl(np.array([[0.0, 12.0, 5.0]])))[0]
    towards = np.array(PLACENTA_TOWARDS) / np.linalg.norm(PLACENTA_TOWARDS)
    placenta = np.array(UTERUS_CENTER) + 0.8 * np.array(UTERUS_RADII) * towards
    return {
        "head": _Plane(head, head_normal, LIE_ROTATION[:, 0]),
        "abdomen": _Plane(abdomen, abdomen_normal),
        "four_chambers": _Plane(heart, _unit(base - heart)),
        "femur": _Plane((hip + knee) / 2, _unit(np.cross(knee - hip, [0.0, 1.0, 0.0])), np.cross(knee - hip, [0, 0, 1])),
        "spine": _Plane(spine, LIE_ROTATION[:, 0], LIE_ROTATION[:, 1]),
        "placenta": _Plane(placenta, np.array([1.0, 0.0, 0.0]), towards),
    }


def _pose(plane: _Plane, press_mm: float) -> np.ndarray:
    """The pose on the skin that fits the plane best."""
    skin, inward = _skin()
    beam = plane.point - skin
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    off_plane = np.arcsin(np.clip(np.abs(beam @ plane.normal), 0.0, 1.0))
    oblique = np.arccos(np.clip((beam * inward).sum(1), -1.0, 1.0))
    cost = (off_plane / np.deg2rad(8.0)) ** 2 + (oblique / np.deg2rad(20.0)) ** 2
    cost += (np.linalg.norm(plane.point - skin, axis=1) / 120.0) ** 2
    cost += 1e3 * (oblique > np.deg2rad(MOST_OBLIQUE_DEG))
    if plane.beam is not None:
        cost += 2.0 * (1.0 - (beam @ _unit(plane.beam)) ** 2)
    best = int(np.argmin(cost))
    z = beam[best]
    y = _unit(plane.normal - z * (plane.normal @ z))
    x = np.cross(y, z)
    if x @ (1.0, 0.0, -1.0) < 0.0:  # the mother's left or her feet are on the image's right
        x, y = -x, -y
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, y, z], axis=1)
    pose[:3, 3] = skin[best] + press_mm * inward[best]
    return pose


def _skin() -> tuple[np.ndarray, np.ndarray]:
    """Places on the mother's front and flanks (n, 3), mm, and their inward normals (n, 3)."""
    height, angle = (a.ravel() for a in np.meshgrid(_HEIGHTS_MM, np.deg2rad(_ANGLES_DEG), indexing="ij"))
    outward = np.stack([np.sin(angle), -np.cos(angle), np.zeros_like(angle)], axis=1)
    low, high = np.zeros(len(angle)), np.full(len(angle), 200.0)
    for _ in range(30):
        middle = (low + high) / 2
        inside = torso(middle * outward[:, 0], middle * outward[:, 1], height) < 0
        low, high = np.where(inside, middle, low), np.where(inside, high, middle)
    points = low[:, None] * outward + height[:, None] * (0.0, 0.0, 1.0)
    steps = 0.5 * np.eye(3)
    slope = np.stack([torso(*(points + step).T) - torso(*(points - step).T) for step in steps], axis=1)
    return points, -slope / np.linalg.norm(slope, axis=1, keepdims=True)


def _unit(vector: np.ndarray) -> np.ndarray:
    return np.asarray(vector, float) / np.linalg.norm(vector)
