"""A body in 3-D axes with the probe on it and the image on its fan, its surfaces seen through one another."""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
import trimesh
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from skimage.transform import resize

from ablate.analysis.figures.scene_parts import Colour, first_column_mark, probe_body, tissue_colours
from ablate.anatomy import Scene, TissueKind, bounds_mm
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of, fan_outline, to_world

Axes3D = Any  # mpl_toolkits carries no types
Opacity = tuple[float, float]  # where a surface faces the camera, and where it is seen edge on

MARK = "#2ca02c"
_HOUSING, _OUTLINE = (0.27, 0.30, 0.36), "#ffb000"
_SOLID: Opacity = (1.0, 1.0)
_OPACITY: dict[TissueKind, Opacity] = {TissueKind.bone: (0.95, 1.0), TissueKind.gas: (0.3, 0.7)}
_ORGAN, _ENVELOPE = (0.2, 0.6), (0.05, 0.5)  # any other tissue, and what surrounds the rest
_LARGE = 0.03  # of the scene's bounds: what fills more of them surrounds the rest
_ZOOM = 1.05  # the labels of the axes need the rest of the panel
_IMAGE_ROWS = 200  # that an image is brought to before it is put on the fan
_OVERLAP = 0.5  # of its size that each of its pixels reaches over the next ones: no seams are seen between them
_MARGIN_MM = 2.0
_AMBIENT = 0.35  # the rest of a colour's brightness follows the angle to the camera
_FITS = 4  # labels keep their size, so each of them comes nearer
_VEILED = 0.3  # of its opacity is left to what lies before the image plane


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
    from behind the probe and a little from above.

    Parameters
    ----------
    space : Axes3D
        Empty.
    scene : Scene
        With one structure or more.
    probe : Probe
        That took the image.
    pose : (4, 4) float, mm
        Probe to world.
    image : (H, W) uint8
        Grey levels, drawn where the image was taken.
    fan : (H, W) bool
        Its pixels that are drawn.
    axis : (3,) float
        The scene's long axis, drawn upright.
    """
    surfaces = [
        *_structures(scene),
        (probe_body(probe, pose), _HOUSING, _SOLID),
        (first_column_mark(probe, pose), to_rgb(MARK), _SOLID),
    ]
    view = _turn_camera(space, pose, np.asarray(axis, float) / np.linalg.norm(axis))
    # One collection, so that the faces of all surfaces and the pixels are drawn from the farthest to the nearest.
    drawn = [image_quads(probe, pose, image, fan), *(_shaded(*surface, view, pose) for surface in surfaces)]
    corners = np.concatenate([quads for quads, _ in drawn])
    colours = np.concatenate([rgba for _, rgba in drawn])
    space.computed_zorder = False  # the outline lies on all faces
    space.add_collection3d(Poly3DCollection(corners, facecolors=colours, linewidths=0))
    space.plot(*to_world(pose, fan_outline(probe)).T, color=_OUTLINE, lw=0.8)
    low = corners.min(axis=(0, 1)) - _MARGIN_MM
    high = corners.max(axis=(0, 1)) + _MARGIN_MM
    for name, *limits in zip("xyz", low, high, strict=True):
        space.set(**{f"{name}lim": limits})
        getattr(space, f"set_{name}label")(f"{name} (mm)", labelpad=0)
    space.set_box_aspect(tuple(high - low), zoom=_ZOOM)  # not an array, which would be changed
    space.locator_params(nbins=4)
    space.tick_params(pad=2)


def fit_body(space: Axes3D, room: Bbox) -> None:
    """Move 3-D axes, and make them as large as fits, so that their box, ticks and labels lie in some room.

    They are as `draw_body` leaves them; the room is in shares of the figure.
    """
    figure = space.figure
    canvas = FigureCanvasAgg(figure)
    for surface in space.collections:
        surface.set_visible(False)  # it lies in the box
    for _ in range(_FITS):
        canvas.draw()  # where labels lie is known then
        taken = _taken(space, canvas.get_renderer()).transformed(figure.transFigure.inverted())
        place = space.get_position()
        larger = min(room.width / taken.width, room.height / taken.height)
        middle, centre, wanted = (np.array(box.p0 + box.p1) / 2 for box in (place, taken, room))
        corner = wanted + larger * (middle - centre - place.size / 2)
        space.set_position((*corner, *(larger * place.size)))
    for surface in space.collections:
        surface.set_visible(True)


def _taken(space: Axes3D, renderer: Any) -> Bbox:
    """What the box of 3-D axes takes of the figure with its ticks and labels, in pixels."""
    corners = np.array(list(product(space.get_xlim(), space.get_ylim(), space.get_zlim(), [1.0])))
    flat = corners @ space.get_proj().T
    seen = space.transData.transform(flat[:, :2] / flat[:, 3:])
    box = Bbox([seen.min(axis=0), seen.max(axis=0)])
    return Bbox.union([box, *(axis.get_tightbbox(renderer) for axis in (space.xaxis, space.yaxis, space.zaxis))])


def image_quads(probe: Probe, pose: np.ndarray, image: np.ndarray, fan: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The pixels inside the fan, as quadrilaterals in space; a high image has fewer than it came with.

    Parameters
    ----------
    probe : Probe
        That took the image.
    pose : (4, 4) float, mm
        Probe to world.
    image : (H, W) uint8
        Grey levels.
    fan : (H, W) bool
        The pixels that are drawn.

    Returns
    -------
    (n, 4, 3) float, mm, and (n, 4) float in [0, 1]
        Corners and RGBA.
    """
    scale = min(1.0, _IMAGE_ROWS / image.shape[0])
    shape = tuple(round(scale * pixels) for pixels in image.shape)
    rows, columns = shape
    grey = resize(image / 255, shape, anti_aliasing=scale < 1)
    inside = resize(fan.astype(float), shape, anti_aliasing=scale < 1)
    height, width = fan_of(probe).size_mm
    x, z = np.meshgrid(np.linspace(-width / 2, width / 2, columns + 1), np.linspace(0, height, rows + 1))
    points = to_world(pose, np.stack([x, 0 * x, z - fan_of(probe).sag_mm], axis=-1))
    quads = np.stack([points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]], axis=2)[inside > 0]
    quads += _OVERLAP * (quads - quads.mean(axis=1, keepdims=True))
    return quads, np.stack([grey, grey, grey, inside], axis=-1)[inside > 0]


def _structures(scene: Scene) -> list[tuple[trimesh.Trimesh, Colour, Opacity]]:
    """The structures of a scene, each the more translucent the more it surrounds."""
    colours = tissue_colours(scene.tissues)
    whole = np.ptp(bounds_mm(s.mesh for s in scene.structures), axis=0).prod()
    other = [_ENVELOPE if s.mesh.extents.prod() > _LARGE * whole else _ORGAN for s in scene.structures]
    return [
        (structure.mesh, colours[tissue], _OPACITY.get(structure.tissue.kind, usual))
        for structure, tissue, usual in zip(scene.structures, scene.structure_tissues, other, strict=True)
    ]


def _shaded(
    mesh: trimesh.Trimesh, colour: Colour, opacity: Opacity, view: np.ndarray, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The faces of a mesh: corners (n, 4, 3), the last one twice, and RGBA (n, 4). Its winding means nothing."""
    facing = np.abs(mesh.face_normals @ view)
    alpha = opacity[0] + (opacity[1] - opacity[0]) * (1 - facing) ** 3
    if opacity is not _SOLID:
        normal = pose[:3, 1] * np.sign(pose[:3, 1] @ view)
        alpha *= np.where((mesh.triangles_center - pose[:3, 3]) @ normal > 0, _VEILED, 1.0)
    bright = _AMBIENT + (1 - _AMBIENT) * facing
    return mesh.triangles[:, [0, 1, 2, 2]], np.column_stack([np.outer(bright, colour), alpha])


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
