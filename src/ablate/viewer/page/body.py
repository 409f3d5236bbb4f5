"""The body in 3-D with the probe on it, its fan, and the ways to take the probe by hand."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from ablate.analysis.figures.scene_parts import Colour, first_column_mark, probe_body
from ablate.anatomy import Scene, bounds_mm
from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_of, fan_outline
from ablate.viewer.pictures import on_fan
from ablate.viewer.session import Quality, ViewerState, Views

_UNIT_MM = 100.0  # of the page's 3-D space, whose near and far planes suit metres
_TRIANGLES = 60_000  # of all structures together: a browser without a graphics card draws them too
_FEWEST = 200  # of one structure
_LARGE = 0.1  # of the box around the scene: what fills more of it surrounds the rest
_THIN, _WIDE = 0.005, 0.1  # of that box's diagonal and largest side: a thinner and wider sheet covers the rest
_ENVELOPE = 0.1  # opacity of what surrounds or covers the rest, at first
_NEAR = 0.01  # viser's own, of its space: what is nearer to the camera is not drawn
_BEFORE_FAN_MM = 1.0  # so that the fan itself is drawn
_FACES = 0.99  # cosine between a camera that faces the plane and the plane's normal
_HOUSING = (69, 77, 92)
_MARK = (44, 160, 44)
_OUTLINE = (255, 176, 0)
#: Turns viser's plane of an image, whose rows run along y, to that of the fan, where they run along z.
_UPRIGHT = Rotation.from_euler("X", 90, degrees=True).as_quat(scalar_first=True)
_NO_SHADOW = {"cast_shadow": False, "receive_shadow": False}
_FAN_ROWS = {Quality.coarse: 64, Quality.full: 256}


class Body:
    """The 3-D part of the page; `tissues` are the meshes of each tissue, by its name.

    Parameters
    ----------
    server : viser.ViserServer
        The server of the page.
    scene : Scene
        The body.
    colours : sequence of Colour
        Of the scene's tissues.
    axis, front : (3,) float
        The long axis of the body, and the side that is seen first.
    """

    grabbed: Callable[[str, np.ndarray], object]  # called with the phase of a drag of the probe, and the point, mm
    clicked: Callable[[np.ndarray, np.ndarray], object]  # with origin, mm, and direction of the click's line of sight
    _probe: Probe | None

    def __init__(
        self, server: Any, scene: Scene, colours: Sequence[Colour], axis: np.ndarray, front: np.ndarray
    ) -> None:
        self._scene = server.scene
        self._probe = None
        self._held = np.eye(4)
        self._facing: dict[int, tuple[Any, np.ndarray]] = {}  # browsers whose camera faces the plane, and its normal
        server.on_client_connect(self._watch)
        server.on_client_disconnect(lambda client: self._facing.pop(client.client_id, None))
        bounds = bounds_mm(s.mesh for s in scene.structures)
        away = front + 0.55 * np.cross(axis, front) + 0.35 * axis
        away *= 1.7 * float(np.linalg.norm(np.ptp(bounds, axis=0))) / np.linalg.norm(away)
        middle = bounds.mean(axis=0)
        self._front_view = (middle + away, middle, axis)
        server.scene.configure_environment_map(None)  # costs seconds without a graphics card
        server.scene.configure_default_lights(cast_shadow=False)
        server.scene.add_light_ambient("/light", intensity=1.5)
        self.tissues = _add_structures(server, scene, colours)
        self._frame = server.scene.add_frame("/probe", show_axes=False)
        server.scene.set_up_direction(tuple(axis))
        camera = server.initial_camera
        camera.position = (middle + away) / _UNIT_MM
        camera.look_at = middle / _UNIT_MM
        camera.up = tuple(axis)
        camera.fov = np.deg2rad(40.0)

    def hold(self, state: ViewerState) -> None:
        """Put the probe where it is held, before there is an image of it."""
        if state.probe != self._probe:
            self._add_probe(state.probe)
        if not np.array_equal(state.pose, self._held):
            self._uncut()
        self._held = state.pose
        self._frame.position = state.pose[:3, 3] / _UNIT_MM
        self._frame.wxyz = Rotation.from_matrix(state.pose[:3, :3]).as_quat(scalar_first=True)

    def show(self, views: Views) -> None:
        """Lay the simulated image, or the generated one, on the fan."""
        if views.image is not None and views.state.probe == self._probe:
            self.fan.image = on_fan(views.image, views.mask, _FAN_ROWS[views.quality])

    async def _grab(self, event: Any) -> None:  # async, as the click, so that phases stay in order
        self.grabbed(event.phase, np.array(event.end_position) * _UNIT_MM)

    async def _click(self, event: Any) -> None:
        self.clicked(np.array(event.ray_origin) * _UNIT_MM, np.array(event.ray_direction))

    def see_through(self, tissue: str, opacity: float) -> None:
        """Set the opacity of a tissue's meshes in 3-D; 0 hides them."""
        for mesh in self.tissues[tissue]:
            mesh.visible = opacity > 0
            mesh.opacity = opacity if opacity < 1 else None

    def opacity_of(self, tissue: str) -> float:
        """The opacity of a tissue's largest mesh in 3-D."""
        opacity = self.tissues[tissue][0].opacity
        return 1.0 if opacity is None else float(opacity)

    def face(self, client: Any, state: ViewerState) -> None:
        """Turn a browser's camera so that the fan is seen as the image is, with nothing before it.

        What lies before the plane is drawn again when the probe or the camera moves.
        """
        pose = state.pose
        height, width = fan_of(state.probe).size_mm
        middle = pose[:3, 3] + 0.45 * height * pose[:3, 2]
        share = 2 * np.tan(client.camera.fov / 2)  # of the distance, that is seen
        away = 1.1 * max(height / share, width / (share * max(client.camera.aspect, 0.1)))
        _look(client, middle + away * pose[:3, 1], middle, -pose[:3, 2], nearest=away - _BEFORE_FAN_MM)
        self._facing[client.client_id] = client, pose[:3, 1]

    def face_body(self, client: Any) -> None:
        """Turn a browser's camera back to the body's front."""
        _look(client, *self._front_view)
        self._facing.pop(client.client_id, None)

    def _watch(self, client: Any) -> None:
        """Draw what lies before the plane again when a browser's camera no longer faces it."""

        def moved(camera: Any) -> None:
            _, normal = self._facing.get(client.client_id, (None, None))
            away = camera.position - camera.look_at
            if normal is not None and away @ normal < _FACES * np.linalg.norm(away):
                self._uncut()

        client.camera.on_update(moved)

    def _uncut(self) -> None:
        for client, _ in self._facing.values():
            client.camera.near = _NEAR
        self._facing.clear()

    def _add_probe(self, probe: Probe) -> None:
        self._probe = probe
        scene = self._scene
        at_origin = np.eye(4)  # of the frame that moves with the probe
        housing = _add(scene, "/probe/housing", probe_body(probe, at_origin), color=_HOUSING)
        _add(scene, "/probe/mark", first_column_mark(probe, at_origin), color=_MARK)
        outline = fan_outline(probe) / _UNIT_MM
        points = np.stack([outline, np.roll(outline, -1, axis=0)], axis=1)
        scene.add_line_segments("/probe/outline", points, _OUTLINE, thickness=2.0, thickness_units="screen")
        height, width = fan_of(probe).size_mm
        self.fan = scene.add_image(
            "/probe/fan",
            np.zeros((2, 2, 4), np.uint8),
            width / _UNIT_MM,
            height / _UNIT_MM,
            format="png",
            wxyz=_UPRIGHT,
            position=(0.0, 0.0, (height / 2 - fan_of(probe).sag_mm) / _UNIT_MM),
            **_NO_SHADOW,
        )
        housing.on_drag(self._grab)
        self.fan.on_click(self._click)


def _look(client: Any, position: np.ndarray, look_at: np.ndarray, up: np.ndarray, nearest: float = 0.0) -> None:
    """Move a browser's camera; what is nearer to it than `nearest`, mm, is not drawn."""
    with client.atomic():
        client.camera.near = max(_NEAR, nearest / _UNIT_MM)
        client.camera.position = position / _UNIT_MM  # takes look_at with it, which is set after it therefore
        client.camera.look_at = look_at / _UNIT_MM
        client.camera.up_direction = up


def _add_structures(server: Any, scene: Scene, colours: Sequence[Colour]) -> dict[str, list[Any]]:
    """Add all structures as meshes, one for each tissue and opacity, the largest first; returns them by tissue.

    Only their far walls are drawn, as of a body cut open, so that the fan and the organs inside are seen.
    """
    box = np.ptp(bounds_mm(s.mesh for s in scene.structures), axis=0)
    share = min(1.0, _TRIANGLES / max(1, sum(len(s.mesh.faces) for s in scene.structures)))
    parts: dict[tuple[int, float | None], list[trimesh.Trimesh]] = {}
    pairs = zip(scene.structures, scene.structure_tissues, strict=True)
    for structure, tissue in sorted(pairs, key=lambda pair: -pair[0].mesh.extents.prod()):
        opacity = _ENVELOPE if hides_the_rest(structure.mesh, box) else None
        mesh = fewer_triangles(structure.mesh, max(_FEWEST, int(share * len(structure.mesh.faces))))
        parts.setdefault((tissue, opacity), []).append(mesh)
    added: dict[str, list[Any]] = {}
    for number, ((tissue, opacity), meshes) in enumerate(parts.items()):
        colour = tuple(round(255 * channel) for channel in colours[tissue])
        whole_mesh = trimesh.util.concatenate(meshes)
        shown = _add(server.scene, f"/body/{number}", whole_mesh, color=colour, opacity=opacity, side="back")
        added.setdefault(scene.tissues[tissue].name, []).append(shown)
    return added


def hides_the_rest(mesh: trimesh.Trimesh, box: np.ndarray) -> bool:
    """Whether a structure surrounds what lies in a box of these sides, mm, or covers it as a fascia does."""
    volume, one_side = abs(mesh.volume), mesh.area / 2
    is_thin = volume < _THIN * np.linalg.norm(box) * one_side
    is_wide = one_side > _WIDE * box.prod() / box.min()
    return bool(volume > _LARGE * box.prod() or (is_thin and is_wide))


def _add(scene: Any, name: str, mesh: trimesh.Trimesh, side: str = "double", **look: Any) -> Any:
    vertices = np.asarray(mesh.vertices, np.float32) / _UNIT_MM
    return scene.add_mesh_simple(name, vertices, mesh.faces, side=side, **_NO_SHADOW, **look)


def fewer_triangles(mesh: trimesh.Trimesh, most: int) -> trimesh.Trimesh:
    """A mesh with `most` triangles or fewer to look at; the simulator keeps them all.

    Vertices that share a cube become their mean, in larger and larger cubes. A mesh that has few enough is returned as
    it is.
    """
    cube = float(np.sqrt(4 * mesh.area / most)) / 2
    result = mesh
    while len(result.faces) > most:
        cells = np.floor((mesh.vertices - mesh.bounds[0]) / cube).astype(np.int64)
        owner = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
        points = np.stack([np.bincount(owner, x) for x in mesh.vertices.T], axis=-1) / np.bincount(owner)[:, None]
        faces = owner[mesh.faces]
        faces = faces[(np.diff(np.sort(faces, axis=1)) > 0).all(axis=1)]  # the others have shrunk to a line or point
        result = trimesh.Trimesh(points, faces, process=False)
        cube *= 1.2
    return result
