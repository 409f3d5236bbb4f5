"""What pictures of a scene share: a colour for each tissue, by what it is to ultrasound, and the probe as meshes."""

from collections.abc import Sequence

import numpy as np
import trimesh
from matplotlib.colors import hsv_to_rgb

from ablate.anatomy import Tissue, TissueKind
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import face_arc, to_world

Colour = tuple[float, float, float]

BACKGROUND: Colour = (0.88, 0.90, 0.92)
BONE: Colour = (0.95, 0.90, 0.76)
GAS: Colour = (0.50, 0.55, 0.62)
BLOOD: Colour = (0.75, 0.10, 0.15)
_GOLDEN = 0.618034
_SATURATIONS, _VALUES = (0.35, 0.60, 0.48), (0.93, 0.72)
_BLOOD_POWER = 0.02  # what scatters less is red: blood, and the thalamus, which is not a fluid
_HALF_WIDTH_MM = 7.0  # of the probe
_BODY_MM = ((1.0, 14.0), (0.5, 36.0), (0.42, 85.0))  # share of the face's width, and how far behind its edges
_FACE_MM = 0.5  # in front of the body, so that it is seen


def tissue_colours(tissues: Sequence[Tissue]) -> list[Colour]:
    """A colour in [0, 1]^3 a tissue, for all of `Scene.tissues`, of which the first is the background.

    The background is pale, bone ivory, gas grey, blood red; clear fluids are blue and all others warm.
    """
    colours: list[Colour] = []
    fluids = others = 0
    colour: Colour | np.ndarray
    for i, tissue in enumerate(tissues):
        if tissue.kind is TissueKind.bone:
            colour = BONE
        elif tissue.kind is TissueKind.gas:
            colour = GAS
        elif i == 0:
            colour = BACKGROUND
        elif tissue.scatter_power == 0:
            colour = hsv_to_rgb((0.52 + 0.045 * (fluids % 4), 0.5, 0.9))
            fluids += 1
        elif tissue.scatter_power < _BLOOD_POWER:
            colour = BLOOD
        else:
            hue = (0.9 + 0.24 * (others * _GOLDEN % 1)) % 1  # from pink over red to yellow
            colour = hsv_to_rgb((hue, _SATURATIONS[others % 3], _VALUES[others % 2]))
            others += 1
        red, green, blue = map(float, colour)
        colours.append((red, green, blue))
    return colours


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


def _arc(probe: Probe) -> np.ndarray:
    """The face in the image plane from the first column's side, (41, 2): x and z, mm."""
    return face_arc(probe, 41)[:, [0, 2]]


def _both_sides(flat: np.ndarray) -> np.ndarray:
    """Points of the image plane moved to either side of it, (2 n, 3), mm."""
    return np.concatenate([np.insert(flat, 1, y, axis=1) for y in (-_HALF_WIDTH_MM, _HALF_WIDTH_MM)])
