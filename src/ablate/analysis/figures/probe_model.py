"""A probe and its fan as meshes in world coordinates, to be drawn."""

import numpy as np
import trimesh

from ablate.ultrasound import Probe
from ablate.ultrasound.probe import face_arc, face_sag_mm, fan_size_mm, to_world

_HALF_WIDTH_MM = 7.0
_BODY_MM = ((1.0, 14.0), (0.5, 36.0), (0.42, 85.0))  # share of the face's width, and how far behind its edges
_FACE_MM = 0.5  # in front of the body, so that it is seen


def probe_body(probe: Probe, pose: np.ndarray) -> trimesh.Trimesh:
    """The housing: as wide as the face, tapering to a handle; a closed prism. `pose` is probe to world, (4, 4), mm."""
    arc = _arc(probe)
    edge, height = arc[-1]
    back = np.array([[share * edge, height - behind] for share, behind in _BODY_MM])
    outline = np.concatenate([arc, back, back[::-1] * (-1, 1)])
    middle = np.array([[0.0, outline[:, 1].max() - 15.0]])
    points = _both_sides(np.concatenate([outline, middle]))
    n = len(outline)
    i = np.arange(n)
    j = np.roll(i, -1)
    cap = np.stack([i, j, np.full(n, n)], axis=-1)
    walls = [np.stack([i, j, i + n + 1], axis=-1), np.stack([j, j + n + 1, i + n + 1], axis=-1)]
    return trimesh.Trimesh(to_world(pose, points), np.concatenate([cap, cap + n + 1, *walls]), process=False)


def probe_face(probe: Probe, pose: np.ndarray) -> trimesh.Trimesh:
    """The face, an open strip."""
    arc = _arc(probe) + np.array([0.0, _FACE_MM])
    i = np.arange(len(arc) - 1)
    n = len(arc)
    faces = np.concatenate([np.stack([i, i + 1, i + n], axis=-1), np.stack([i + 1, i + n + 1, i + n], axis=-1)])
    return trimesh.Trimesh(to_world(pose, _both_sides(arc)), faces, process=False)


def first_column_mark(probe: Probe, pose: np.ndarray, radius_mm: float = 4.0) -> trimesh.Trimesh:
    """A ball on the housing's side that the image's first column shows."""
    edge, height = _arc(probe)[0]
    ball = trimesh.creation.icosphere(2, radius=radius_mm)
    ball.apply_translation(to_world(pose, np.array([edge - 0.5 * radius_mm, 0.0, height - 9.0])))
    return ball


def fan_plane(probe: Probe, pose: np.ndarray) -> trimesh.Trimesh:
    """The rectangle that the image fills, as two triangles."""
    height, width = fan_size_mm(probe)
    top = -face_sag_mm(probe)
    corners = np.array([[x, 0, z] for z in (top, top + height) for x in (-width / 2, width / 2)])
    return trimesh.Trimesh(to_world(pose, corners), [[0, 1, 2], [1, 3, 2]], process=False)


def _arc(probe: Probe) -> np.ndarray:
    """The face in the image plane from the first column's side, (41, 2): x and z, mm."""
    return face_arc(probe, 41)[:, [0, 2]]


def _both_sides(flat: np.ndarray) -> np.ndarray:
    """Points of the image plane moved to either side of it, (2 n, 3), mm."""
    return np.concatenate([np.insert(flat, 1, y, axis=1) for y in (-_HALF_WIDTH_MM, _HALF_WIDTH_MM)])
