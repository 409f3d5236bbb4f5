"""A body in 3-D axes with the probe on it and the image on its fan, its surfaces seen through one another."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from matplotlib.colors import to_rgb
from matplotlib.image import AxesImage
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d.proj3d import inv_transform, proj_transform
from skimage.transform import resize

from ablate.analysis.figures.scene_parts import first_column_mark, probe_body, probe_face, tissue_colours
from ablate.anatomy import Scene, Structure, Tissue, TissueKind, bounds_mm
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of, fan_outline, to_world
from ablate.ultrasound.surfaces.embree import Geometry

Axes3D = Any  # mpl_toolkits carries no types

MARK = "#2ca02c"
_HOUSING, _FACE, _OUTLINE = (0.27, 0.30, 0.36), (0.80, 0.83, 0.87), "#ffb000"
# Opacity facing the camera, and seen edge on.
_OPACITY = {TissueKind.bone: (0.95, 1.0), TissueKind.gas: (0.3, 0.7)}
_ORGAN, _ENVELOPE = (0.2, 0.6), (0.05, 0.5)  # any other tissue, and what surrounds the rest
_LARGE = 0.03  # of the scene's bounds: what fills more of them surrounds the rest
_FAN_OPACITY = 0.9
_FILLED = 0.84  # of the panel by the box of its axes; the labels need the rest
_COLUMNS_PX = 1000
_TEXTURE_PX = 500  # height that an image is brought to before it is put on the fan: no more of it can be seen
_MARGIN_MM = 2.0
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


def draw_body(
    space: Axes3D,
    scene: Scene,
    probe: Probe,
    pose: np.ndarray,
    image: np.ndarray,
    fan: np.ndarray,
    axis: Sequence[float],
) -> None:
    """Draw a scene into empty 3-D axes with `proj_type="ortho"`, in mm and of equal aspect.

    The body is translucent, more so before the image plane; bone is opaque. The camera looks across the image plane,
    from behind the probe and a little from above. `pose` is probe to world, (4, 4), mm; `image` is (H, W) uint8 and
    `fan` (H, W) bool; `axis` is the scene's long axis, drawn upright.
    """
    surfaces = [
        *_structures(scene),
        _image_on_fan(probe, pose, image, fan),
        Surface(probe_body(probe, pose), _HOUSING),
        Surface(probe_face(probe, pose), _FACE),
        Surface(first_column_mark(probe, pose), to_rgb(MARK)),
    ]
    box = bounds_mm(s.mesh for s in surfaces) + np.array([[-_MARGIN_MM], [_MARGIN_MM]])
    size = tuple(box[1] - box[0])  # not an array, which `set_box_aspect` would change
    space.set(**dict(zip(("xlim", "ylim", "zlim"), box.T, strict=True)))
    space.set_box_aspect(size)
    view = _turn_camera(space, pose, np.asarray(axis, float) / np.linalg.norm(axis))
    half_panel = np.array([space.viewLim.width, space.viewLim.height]) / 2
    space.set_box_aspect(size, zoom=float((_FILLED * half_panel / np.abs(_corners_seen(space, box)).max(axis=0)).min()))
    space.tick_params(pad=2)
    upright = np.argmax(np.abs(axis))
    for number, (name, each) in enumerate({"x": space.xaxis, "y": space.yaxis, "z": space.zaxis}.items()):
        each.set_label_text(f"{name} (mm)")
        each.labelpad = -4 if number == upright else 1  # the upright one stands next to the image
        each.set_pane_color((0.97, 0.97, 0.98))
        each.set_major_locator(MultipleLocator(tick_mm(max(size))))
    space.add_artist(_picture(space, surfaces, box, view, (pose[:3, 3], pose[:3, 1])))
    space.plot(*to_world(pose, fan_outline(probe)).T, color=_OUTLINE, lw=0.8)


def seen_direction(space: Axes3D, vector: Sequence[float]) -> np.ndarray:
    """A world direction as it lies in the picture, (2,) float, of length 1 where it does not point to the camera."""
    turn = space.get_proj()[:2, :3]
    seen: np.ndarray = turn @ np.asarray(vector, float) / np.linalg.norm(vector) / np.linalg.norm(turn[0])
    return seen


def tick_mm(extent: float) -> float:
    """A round distance of which two to five lie in an extent."""
    decade = 10.0 ** math.floor(math.log10(extent / 2))
    return max(step * decade for step in (1, 2, 5) if 2 * step * decade <= extent)


def _turn_camera(space: Axes3D, pose: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """Point the axes' camera at the probe, the body upright; its direction from the body, a unit vector."""
    across = pose[:3, 1] if pose[:3, 1] @ axis >= 0 else -pose[:3, 1]
    view: np.ndarray = 0.75 * across - 0.7 * pose[:3, 2] + 0.2 * axis
    view /= np.linalg.norm(view)
    upright = int(np.argmax(np.abs(axis)))
    forward, side, up = np.roll(view, 2 - upright)
    elevation, azimuth = math.degrees(math.asin(up)), math.degrees(math.atan2(side, forward))
    space.view_init(elevation, azimuth, roll=0 if axis[upright] > 0 else 180, vertical_axis="xyz"[upright])
    return view


def _corners_seen(space: Axes3D, box: np.ndarray) -> np.ndarray:
    """The corners of a box, (2, 3) in mm, in the plane of the picture, (8, 2)."""
    return np.column_stack(proj_transform(*trimesh.bounds.corners(box).T, space.get_proj())[:2])


def _picture(
    space: Axes3D, surfaces: Sequence[Surface], box: np.ndarray, view: np.ndarray, plane: tuple[np.ndarray, np.ndarray]
) -> AxesImage:
    """All surfaces in a box as the axes' projection sees them, as an image that lies on it."""
    flat = _corners_seen(space, box)
    (left, bottom), (right, top) = flat.min(axis=0), flat.max(axis=0)
    columns, rows = _COLUMNS_PX, round(_COLUMNS_PX * (top - bottom) / (right - left))
    x = left + (np.arange(columns) + 0.5) * (right - left) / columns
    y = top - (np.arange(rows) + 0.5) * (top - bottom) / rows
    grid = (values.ravel() for values in np.meshgrid(x, y))
    points = np.column_stack(inv_transform(*grid, np.zeros(rows * columns), np.linalg.inv(space.get_proj())))
    points += np.outer(np.linalg.norm(box[1] - box[0]) - (points - box.mean(axis=0)) @ view, view)
    seen = look_through(surfaces, points, -view, plane).reshape(rows, columns, 4)
    picture = AxesImage(space, extent=(left, right, bottom, top), origin="upper", interpolation="antialiased")
    picture.set_data(np.clip(seen, 0, 1))
    return picture


def _structures(scene: Scene) -> list[Surface]:
    """The structures of a scene, each the more translucent the more it surrounds."""
    colours = tissue_colours(scene.tissues)
    whole = np.ptp(bounds_mm(s.mesh for s in scene.structures), axis=0).prod()
    other = [_ENVELOPE if s.mesh.extents.prod() > _LARGE * whole else _ORGAN for s in scene.structures]
    drawn = zip(scene.structures, scene.structure_tissues, other, strict=True)
    return [Surface(s.mesh, colours[tissue], *_OPACITY.get(s.tissue.kind, usual)) for s, tissue, usual in drawn]


def _image_on_fan(probe: Probe, pose: np.ndarray, image: np.ndarray, fan: np.ndarray) -> Surface:
    """The rectangle that an image fills, painted with its grey and transparent outside the fan."""
    fewer = min(1.0, _TEXTURE_PX / image.shape[0])
    shape = round(image.shape[0] * fewer), round(image.shape[1] * fewer)
    grey = resize(image / 255, shape, anti_aliasing=fewer < 1)
    alpha = _FAN_OPACITY * resize(fan.astype(float), shape, anti_aliasing=fewer < 1)
    size = np.array(fan_of(probe).size_mm)
    corner = np.array([-fan_of(probe).sag_mm, -size[1] / 2])

    def paint(points: np.ndarray) -> np.ndarray:
        local = (points - pose[:3, 3]) @ pose[:3, :3]
        pixel = np.floor((local[:, [2, 0]] - corner) / size * shape).astype(int)
        row, column = np.clip(pixel, 0, np.array(shape) - 1).T
        return np.column_stack([*[grey[row, column]] * 3, alpha[row, column]])

    (top, left), (bottom, right) = corner, corner + size
    corners = np.array([(left, 0, top), (right, 0, top), (left, 0, bottom), (right, 0, bottom)])
    rectangle = trimesh.Trimesh(to_world(pose, corners), [[0, 1, 2], [1, 3, 2]], process=False)
    return Surface(rectangle, paint=paint)


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
    looks = np.array([(*s.colour, s.opacity, s.rim) for s in surfaces], np.float32)
    step_mm = np.float32(max(geometry.step_mm, 1e-3))
    normal = plane[1] * np.sign(plane[1] @ direction)
    colour, light = np.zeros((len(origins), 3), np.float32), np.ones(len(origins), np.float32)
    active = np.arange(len(origins))
    start = (origins - centre).astype(np.float32)
    along = direction.astype(np.float32)
    for _ in range(_MOST_SURFACES):
        hits = geometry.closest(start, np.tile(along, (len(start), 1)), np.full(len(start), reach, np.float32))
        struck = np.flatnonzero(hits.structure >= 0)
        if not struck.size:
            break
        active, hit, normals = active[struck], hits.structure[struck], hits.normal[struck]
        place = start[struck] + hits.distance_mm[struck, None] * along
        facing = np.abs(normals @ along) / np.maximum(np.linalg.norm(normals, axis=-1), 1e-12)
        points, (opacity, rim) = place + centre, looks[hit, 3:].T
        veiled = ((points - plane[0]) @ normal < 0) & (opacity < 1)
        shown = looks[hit, :3] * (_AMBIENT + (1 - _AMBIENT) * facing)[:, None]
        alpha = (opacity + (rim - opacity) * (1 - facing) ** 3) * np.where(veiled, _VEILED, 1.0)
        for number, surface in enumerate(surfaces):
            if surface.paint is not None:
                chosen = hit == number
                painted = surface.paint(points[chosen])
                shown[chosen], alpha[chosen] = painted[:, :3], painted[:, 3]
        share = (light[active] * alpha).astype(np.float32)
        colour[active] += share[:, None] * shown
        light[active] -= share
        on = light[active] > _SPENT
        active, start = active[on], place[on] + step_mm * along
    alpha = 1 - light
    return np.column_stack([colour / np.maximum(alpha, 1e-6)[:, None], alpha])
