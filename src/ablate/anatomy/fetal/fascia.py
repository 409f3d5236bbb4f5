"""Fascia of the mother's abdominal wall in front: thin sheets about her muscles and between them; mm."""

from collections.abc import Callable

import numpy as np
import trimesh

from ablate.anatomy.fetal import shapes as sdf
from ablate.anatomy.fetal.shapes import Part, joined

SEMILUNAR_MM = 66.0  # from the midline to the edge of the rectus, where the aponeuroses of the obliques join
_REACH_MM = (96.0, 120.0)  # of the sheets to the sides, and up and down
_BETWEEN_OBLIQUES = (0.38, 0.7)  # of the wall's thickness: external, internal, transverse
_HALF_MM = 0.35  # of a sheet's thickness


def fascia(scale: float, muscle_outside: sdf.Field, muscle_inside: sdf.Field) -> list[Part]:
    """Both sheaths of the rectus, which meet in the white line, and what parts the obliques.

    `scale` is that of the grids; the fields are the faces of the muscles.
    """

    def white_lines(x: np.ndarray) -> np.ndarray:
        """How much thicker the sheath is: through the wall in the midline and at the edges of the rectus."""
        to_edge = (np.abs(x) - SEMILUNAR_MM) / 2.5
        return 3.2 * np.exp(-((x / 6.0) ** 4)) + 5.0 * np.exp(-(to_edge**2))

    def plain(x: np.ndarray) -> np.ndarray:
        return 0.0 * x

    sides, up = _REACH_MM
    step_mm = 5.0 * scale
    edges = SEMILUNAR_MM + np.array((-4.0, -2.0, 0.0, 2.0, 4.0))
    across = [_even(-sides, sides, step_mm), np.arange(-9.0, 9.1, 3.0), edges, -edges]
    sheath = np.unique(np.concatenate(across).round(1))
    beside = _even(SEMILUNAR_MM + 6.0, sides + 4.0, step_mm)
    z = _even(-up, up, 1.2 * step_mm)
    between = [_between(muscle_outside, muscle_inside, share) for share in _BETWEEN_OBLIQUES]
    sheets = {
        "sheath of the rectus": [_sheet(muscle_outside, (sheath, z), _HALF_MM, white_lines)],
        "sheath behind the rectus": [_sheet(muscle_inside, (sheath, z), _HALF_MM, plain)],
        "fascia between the obliques": [
            _sheet(field, (x, z), 0.7 * _HALF_MM, plain) for field in between for x in (-beside[::-1], beside)
        ],
    }
    return [Part(joined(meshes, name), "fascia") for name, meshes in sheets.items()]


def _even(first: float, last: float, step_mm: float) -> np.ndarray:
    return np.linspace(first, last, max(4, 1 + round((last - first) / step_mm)))


def _between(outer: sdf.Field, inner: sdf.Field, share: float) -> sdf.Field:
    """A surface at a share of the way from one to the other."""
    return lambda x, y, z: (1.0 - share) * outer(x, y, z) + share * inner(x, y, z)


def _sheet(
    field: sdf.Field,
    grid: tuple[np.ndarray, np.ndarray],
    half_mm: float,
    thicker_mm: Callable[[np.ndarray], np.ndarray],
) -> trimesh.Trimesh:
    """A closed sheet about the front of a surface.

    Parameters
    ----------
    field : Field
        The surface.
    grid : tuple of array
        x and z of its corners, each rising.
    half_mm : float
        Half its thickness.
    thicker_mm : function
        Of x: by how much more it reaches inwards.
    """
    x, z = np.meshgrid(*grid, indexing="ij")
    faces_y = [_front(field, x, z, level) for level in (half_mm, -half_mm - thicker_mm(x))]
    corners = np.concatenate([np.stack([x, y, z], axis=-1).reshape(-1, 3) for y in faces_y])
    number = np.arange(x.size).reshape(x.shape)
    rim = np.concatenate([number[:, 0], number[-1, 1:], number[-2::-1, -1], number[0, -2:0:-1]])
    a, b, c, d = (part.ravel() for part in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    outer = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    follow, inner = np.roll(rim, -1), x.size
    wall = np.concatenate([np.stack([rim, rim + inner, follow + inner], 1), np.stack([rim, follow + inner, follow], 1)])
    return trimesh.Trimesh(corners, np.concatenate([outer, outer[:, ::-1] + inner, wall]), process=False)


def _front(field: sdf.Field, x: np.ndarray, z: np.ndarray, level_mm: np.ndarray | float) -> np.ndarray:
    """Where lines along y come upon a level of a field from in front; the shape of x."""
    outside, inside = np.full(x.shape, -150.0), np.zeros(x.shape)
    for _ in range(20):
        middle = (outside + inside) / 2.0
        is_in = field(x, middle, z) < level_mm
        outside, inside = np.where(is_in, outside, middle), np.where(is_in, middle, inside)
    return inside
