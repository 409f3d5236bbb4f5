"""What pictures of a scene share: a colour for each tissue, by what it is to ultrasound, and the probe as meshes."""

from collections.abc import Sequence
from importlib.resources import files
from itertools import pairwise
from zlib import crc32

import numpy as np
import trimesh
from matplotlib.colors import hsv_to_rgb, to_rgb

from ablate.anatomy import Tissue, TissueKind
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import face_arc, to_world

Colour = tuple[float, float, float]

BACKGROUND: Colour = (0.88, 0.90, 0.92)
BONE: Colour = (0.95, 0.90, 0.76)
GAS: Colour = (0.50, 0.55, 0.62)
_SATURATIONS, _VALUES = (0.35, 0.60, 0.48), (0.93, 0.72)
_HALF_WIDTH_MM, _MARK_MM = 7.0, 4.0  # of the probe; radius of its mark
_BODY_MM = ((1.0, 14.0), (0.5, 36.0), (0.42, 85.0))  # share of the face's width, and how far behind its edges


def tissue_colours(tissues: Sequence[Tissue]) -> list[Colour]:
    """A colour in [0, 1]^3 a tissue, for all of `Scene.tissues`, of which the first is the background.

    The table beside this file has those of the built-in tissues. Of others, the background is pale, bone ivory, gas
    grey, clear fluids blue and the rest warm. All but the background's follow from the tissue alone.
    """
    table = files("ablate.analysis.figures").joinpath("tissue_colours.csv").read_text("utf-8").split()
    colour_of_name = dict(row.split(",") for row in table)
    colours: list[Colour] = []
    colour: str | Colour
    for i, tissue in enumerate(tissues):
        number = crc32(tissue.name.encode())
        if tissue.name in colour_of_name:
            colour = colour_of_name[tissue.name]
        elif tissue.kind is TissueKind.bone:
            colour = BONE
        elif tissue.kind is TissueKind.gas:
            colour = GAS
        elif i == 0:
            colour = BACKGROUND
        elif tissue.scatter_power == 0:
            colour = tuple(hsv_to_rgb((0.52 + 0.045 * (number % 4), 0.5, 0.9)))
        else:  # from pink over red to yellow
            hue = (90 + number % 25) / 100 % 1
            colour = tuple(hsv_to_rgb((hue, _SATURATIONS[number % 3], _VALUES[number % 2])))
        colours.append(to_rgb(colour))
    return colours


def probe_body(probe: Probe, pose: np.ndarray) -> trimesh.Trimesh:
    """The housing: as wide as the face, tapering to a handle; closed parts. `pose` is probe to world, (4, 4), mm."""
    arc = face_arc(probe, 41)
    edge, _, height = arc[-1]
    levels = [arc]
    for share, behind in _BODY_MM:
        half_width = share * edge
        levels.append(np.array([[-half_width, 0, height - behind], [half_width, 0, height - behind]]))
    side = np.array([0.0, _HALF_WIDTH_MM, 0.0])
    parts = []
    for upper, lower in pairwise(levels):
        outline = np.concatenate([upper, lower])
        corners = np.concatenate([outline - side, outline + side])
        parts.append(trimesh.convex.convex_hull(to_world(pose, corners)))
    housing: trimesh.Trimesh = trimesh.util.concatenate(parts)
    return housing


def first_column_mark(probe: Probe, pose: np.ndarray) -> trimesh.Trimesh:
    """A ball on the housing's side that the image's first column shows."""
    edge, _, height = face_arc(probe, 41)[0]
    ball = trimesh.creation.icosphere(2, radius=_MARK_MM)
    ball.apply_translation(to_world(pose, np.array([edge - 0.5 * _MARK_MM, 0.0, height - 9.0])))
    return ball
