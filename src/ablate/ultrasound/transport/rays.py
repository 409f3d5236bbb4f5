"""The rays of a frame: as they leave the probe, their state under way, and what they travel through."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from ablate.ultrasound.media import Media
from ablate.ultrasound.probe import layer_offsets_mm, scanlines_in_plane, to_world
from ablate.ultrasound.probe_kinds import Probe
from ablate.ultrasound.settings import SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import Geometry
from ablate.ultrasound.surfaces.line_walk import inside_at, owners
from ablate.ultrasound.transport.draws import Draws

_STEEPEST_RAD = 0.3
_FACE_STEPS = 16  # so many steps before and behind an element, a surface counts as lying in it

#: A ray under way. Lengths and loss are those up to its last surface; all lengths are mm.
RAY = np.dtype(
    [
        ("number", np.int32),  # of the ray that left the probe, among all of the frame; a reflected ray keeps it
        ("origin", np.float32, 3),  # where the search for the next surface begins: step_mm beyond the last one
        ("direction", np.float32, 3),
        ("medium", np.int32),  # index of the tissue that the ray is in
        ("path_mm", np.float64),
        ("displayed_mm", np.float64),  # the length as it is displayed
        ("loss_db", np.float64),  # one way
        ("weight", np.float64),  # throughput: two-way amplitude without losses
        ("growth", np.float64),  # of the weight of all rays that come of a reflected one, by the sum of their parts
        ("interfaces", np.int32),  # that the ray has met
        ("reflections", np.int32),  # at how many of them it was reflected
        ("structure", np.int32),  # of the last surface
        ("triangle", np.int32),  # of the last surface
        ("step_mm", np.float32),  # from the last surface to the origin
        ("reach_mm", np.float32),  # largest distance from the origin to the next surface
    ],
    align=True,
)
Ray = Any  # a row of an array of RAY, as compiled code takes it


class View(NamedTuple):
    """What rays travel through, and the elements that receive; a tuple, so that compiled code can take it."""

    media: Media
    tissue_of_owner: np.ndarray  # (structures + 1,) uint8
    elements: np.ndarray  # (groups, 3) float64, mm: where a scanline starts; a group is one scanline of one layer
    axes: np.ndarray  # (groups, 3) float64, unit vectors along the scanlines
    rays: int  # of each group
    path_seed: np.uint64
    depth_mm: float  # of the image; echoes displayed deeper are not followed
    roulette_db: float  # two-way amplitude at the image's depth under which Russian roulette may end a reflected ray
    gain_db_mm: float  # of the display with depth
    step_mm: float  # from a surface to the origin of the rays that leave it


@dataclass(frozen=True)
class Bundle:
    """Scanlines and rays, in probe coordinates or at a pose; a group is one scanline of one layer, layer by layer."""

    starts: np.ndarray  # (groups, 3) float64, mm: the elements on the face
    directions: np.ndarray  # (groups, 3) float64, of the scanlines
    origins: np.ndarray  # (groups * rays, 3), mm; float32 at a pose, as Embree takes them
    ray_directions: np.ndarray  # (groups * rays, 3), float32 at a pose


def probe_rays(probe: Probe, settings: SimulatorSettings, draws: Draws) -> Bundle:
    """Rays spread over the aperture, all at `focus_mm` from the focal point of their scanline and layer.

    Because path lengths to the focus agree, a point at the focus stays a point.
    """
    starts, directions = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings))
    starts, directions = starts.reshape(-1, 3), directions.reshape(-1, 3)
    lateral = np.stack([directions[:, 2], np.zeros(len(directions)), -directions[:, 0]], axis=-1)
    jitter = (2 * draws.aperture() - 1).astype(np.float64)
    half_angles = np.array([settings.aperture_mm, settings.elevational_aperture_mm]) / settings.focus_mm
    tilt_x, tilt_y = np.minimum(half_angles, _STEEPEST_RAD)[:, None, None] * jitter
    rays = directions[:, None] + np.tan(tilt_x)[..., None] * lateral[:, None] + np.tan(tilt_y)[..., None] * (0, 1, 0)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    origins = (starts + settings.focus_mm * directions)[:, None] - settings.focus_mm * rays
    return Bundle(starts, directions, origins.reshape(-1, 3), rays.reshape(-1, 3))


@stage(Stage.probe_rays)
def at_pose(geometry: Geometry, rays: Bundle, pose: np.ndarray) -> tuple[Bundle, np.ndarray]:
    """Scanlines at a pose, from probe to the geometry's coordinates, and the sets of their elements, (groups, words).

    No ray has left the probe yet: `leave_probe` fills their origins and directions.
    """
    starts, directions = to_world(pose, rays.starts), rays.directions @ pose[:3, :3].T
    origins, ray_directions = np.empty((2, len(rays.origins), 3), np.float32)
    return Bundle(starts, directions, origins, ray_directions), inside_at(geometry, starts, directions)


@stage(Stage.probe_rays)
def leave_probe(
    geometry: Geometry,
    rays: Bundle,
    pose: np.ndarray,
    bundle: Bundle,
    of_elements: np.ndarray,
    inside: np.ndarray,
    chosen: np.ndarray | slice = slice(None),
) -> None:
    """Send the chosen rays off, by their numbers: fills their rows of `bundle`, and of their sets, (n, words) uint32.

    The set of a ray is that of its element, unless some surface lies between them or in the element itself. Then each
    ray of that group is followed from outside in its own direction. Along the face, which nearly lies in the skin, a
    crossing can be missed, and a ray without the loss of its tissue would outweigh all others.
    """
    groups = len(bundle.starts)
    group = np.repeat(np.arange(groups), len(rays.origins) // groups)[chosen]
    origins, directions = to_world(pose, rays.origins[chosen]), rays.ray_directions[chosen] @ pose[:3, :3].T
    sets, element = of_elements[group], bundle.starts[group]
    aside = origins - element
    length = np.sqrt(np.einsum("ij,ij->i", aside, aside))
    towards = (aside / np.maximum(length, 1e-12)[:, None]).astype(np.float32)
    between = geometry.closest(element.astype(np.float32), towards, length.astype(np.float32)).structure >= 0
    near_mm = _FACE_STEPS * geometry.step_mm
    before = (bundle.starts - near_mm * bundle.directions).astype(np.float32)
    through = geometry.closest(before, bundle.directions.astype(np.float32), np.full(groups, 2 * near_mm, np.float32))
    crossed = (np.bincount(group, between, minlength=groups) > 0) | (through.structure >= 0)
    unsure = np.flatnonzero(crossed[group])
    sets[unsure] = inside_at(geometry, origins[unsure], directions[unsure])
    bundle.origins[chosen], bundle.ray_directions[chosen], inside[chosen] = origins, directions, sets


def start_rays(bundle: Bundle, inside: np.ndarray, chosen: slice | np.ndarray, view: View) -> np.ndarray:
    """Some rays of a frame, by their numbers, at the probe, (n,) RAY."""
    medium = view.tissue_of_owner[owners(inside[chosen])]
    rays = np.zeros(len(medium), RAY)
    rays["number"] = np.arange(chosen.start, chosen.stop) if isinstance(chosen, slice) else chosen
    rays["origin"], rays["direction"] = bundle.origins[chosen], bundle.ray_directions[chosen]
    rays["medium"], rays["weight"], rays["growth"] = medium, 1.0, 1.0
    rays["structure"] = rays["triangle"] = -1
    rays["reach_mm"] = np.float32(view.depth_mm) / view.media.stretch[medium]
    return rays
