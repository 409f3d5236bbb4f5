"""Surfaces seen through one another: parallel rays, at every hit blended with what lies behind it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from ablate.anatomy import Structure, Tissue, bounds_mm
from ablate.ultrasound.surfaces.embree import Geometry

_MOST_SURFACES = 80  # that one ray is followed through
_SPENT = 0.02  # of the light left: the ray has seen enough
_AMBIENT = 0.35  # the rest of a colour's brightness follows the angle to the camera
_VEILED = 0.3  # of its opacity is left to what lies before the plane that is to be seen
_DRAWN = Tissue("drawn")


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh in mm as it is drawn; its winding means nothing. Colours and opacities are in [0, 1].

    `opacity` is where it faces the camera, `rim` where it is seen edge on: a higher one outlines a translucent body.
    `paint` takes the place of the three, unshaded: from points (n, 3) in mm to RGBA (n, 4) in [0, 1].
    """

    mesh: trimesh.Trimesh
    colour: tuple[float, float, float] = (0.7, 0.7, 0.7)
    opacity: float = 1.0
    rim: float = 1.0
    paint: Callable[[np.ndarray], np.ndarray] | None = None


def look_through(
    surfaces: Sequence[Surface], origins: np.ndarray, direction: np.ndarray, plane: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """What parallel rays see, (n, 4) float32: RGBA in [0, 1], colours not multiplied by alpha.

    Parameters
    ----------
    origins : (n, 3) float, mm
    direction : (3,) float
        Unit vector away from the camera.
    plane : (3,) float, mm, and (3,) float
        A point and the normal of a plane that is to be seen: what lies before it is drawn fainter, unless its opacity
        is 1.
    """
    corners = bounds_mm(s.mesh for s in surfaces)
    centre = corners.mean(axis=0)
    reach = float(np.linalg.norm(origins - centre, axis=-1).max() + np.linalg.norm(corners[1] - corners[0]))
    geometry = Geometry([Structure(s.mesh, _DRAWN) for s in surfaces], corners, centre, reach)
    step_mm = np.float32(max(geometry.step_mm, 1e-3))
    normal = plane[1] * np.sign(plane[1] @ direction)
    colour, light = np.zeros((len(origins), 3), np.float32), np.ones(len(origins), np.float32)
    active = np.arange(len(origins))
    at = (origins - centre).astype(np.float32)
    along = direction.astype(np.float32)
    for _ in range(_MOST_SURFACES):
        hits = geometry.closest(at, np.tile(along, (len(at), 1)), np.full(len(at), reach, np.float32))
        found = np.flatnonzero(hits.structure >= 0)
        if not found.size:
            break
        active, hit, normals = active[found], hits.structure[found], hits.normal[found]
        at = at[found] + hits.distance_mm[found, None] * along
        facing = np.abs(normals @ along) / np.maximum(np.linalg.norm(normals, axis=-1), 1e-12)
        points = at + centre
        before = (points - plane[0]) @ normal < 0
        shown = _shade(surfaces, hit, facing, before, points)
        share = light[active] * shown[:, 3]
        colour[active] += share[:, None] * shown[:, :3]
        light[active] -= share
        on = light[active] > _SPENT
        active, at = active[on], at[on] + step_mm * along
    alpha = 1 - light
    return np.column_stack([colour / np.maximum(alpha, 1e-6)[:, None], alpha])


def _shade(
    surfaces: Sequence[Surface], hit: np.ndarray, facing: np.ndarray, before: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """RGBA of hits on some surfaces, (n, 4) float32; `facing` is the cosine to the camera."""
    colours = np.array([s.colour for s in surfaces], np.float32)[hit]
    opacity = np.array([s.opacity for s in surfaces], np.float32)[hit]
    rim = np.array([s.rim for s in surfaces], np.float32)[hit]
    lit = colours * (_AMBIENT + (1 - _AMBIENT) * facing)[:, None]
    alpha = (opacity + (rim - opacity) * (1 - facing) ** 3) * np.where(before & (opacity < 1), _VEILED, 1.0)
    shown = np.column_stack([lit, alpha]).astype(np.float32)
    for number, surface in enumerate(surfaces):
        if surface.paint is not None:
            chosen = hit == number
            shown[chosen] = surface.paint(points[chosen])
    return shown
