"""The rays of a frame: their random numbers, how they leave the probe, their state under way.

The random numbers are a counter-based table, stratified over the rays of each scanline and layer. A draw depends on
(path seed, how many interfaces the ray has met, ray) and on nothing else, so that what is left out of a scene does not
shift the rest. A ray and the one that it sent back share theirs, on different ways. Each number is stratified (Latin
hypercube): of the n rays of one scanline and layer exactly one falls into each n-th of [0, 1), in an order that is
permuted anew at each interface. Of the few rays that meet more interfaces than the table has rows, each number is a
hash of the same three; strata are of no use where no two rays of a group meet the same surface.
"""

import math
from dataclasses import dataclass
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.media import Media
from ablate.ultrasound.probe import layer_offsets_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.surfaces.line_walk import inside_at, owners

#: Interfaces that the table serves.
MAX_ROWS = 64
#: Columns of a row of draws.
CHOICE, THICKNESS, LOG_U, COS_AZIMUTH, SIN_AZIMUTH, SURVIVAL = range(6)
COLUMNS = 6

_GAMMA, _MIX_1, _MIX_2 = (np.uint64(x) for x in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
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


def stratified(generator: np.random.Generator, groups: int, rays: int, dimensions: int) -> np.ndarray:
    """Uniform numbers, each stratified over the rays of a group.

    Parameters
    ----------
    generator : numpy.random.Generator
        Is advanced.
    groups, rays, dimensions : int
        How many groups there are, rays of each, and numbers of each ray.

    Returns
    -------
    (dimensions, groups, rays) float32
        In [0, 1).
    """
    shape = (dimensions, groups, rays)
    order = np.argsort(generator.random(shape, np.float32), axis=-1).astype(np.float32)
    within = generator.random(shape, np.float32)
    return np.minimum((order + within) / np.float32(rays), np.float32(1 - 2**-24))


@compiled
def _mixed(key: np.uint64) -> np.uint64:
    """One step of SplitMix64 (Steele, Lea and Flood 2014): neighbouring keys give unrelated numbers."""
    key += _GAMMA
    key = (key ^ (key >> np.uint64(30))) * _MIX_1
    key = (key ^ (key >> np.uint64(27))) * _MIX_2
    return key ^ (key >> np.uint64(31))


class Drawn(NamedTuple):
    """Random numbers of a ray at an interface, float32 each."""

    choice: float  # uniform
    thickness: float  # size of a normal one
    log_u: float  # logarithm of a uniform one
    cos_azimuth: float  # of a uniform angle
    sin_azimuth: float
    survival: float  # uniform


@compiled
def tabulated(table: np.ndarray, row: int, number: int) -> Drawn:
    """Draws of a ray, by its number, from a row of the table."""
    return Drawn(
        table[row, number, CHOICE],
        table[row, number, THICKNESS],
        table[row, number, LOG_U],
        table[row, number, COS_AZIMUTH],
        table[row, number, SIN_AZIMUTH],
        table[row, number, SURVIVAL],
    )


@compiled
def unstratified(path_seed: np.uint64, interfaces: int, number: int) -> Drawn:
    """Draws of a ray, by its number, that has met more interfaces than the table serves."""
    key = _mixed(_mixed(path_seed) ^ (np.uint64(number) << np.uint64(32) | np.uint64(interfaces)))
    u = np.empty(COLUMNS, np.float32)
    for column in range(COLUMNS):
        key = _mixed(key)
        u[column] = np.float32(key >> np.uint64(40)) * np.float32(2.0**-24)
    radius = math.sqrt(-2 * math.log(1 - u[THICKNESS]))
    azimuth = 2 * math.pi * u[COS_AZIMUTH]
    return Drawn(
        u[CHOICE],
        float(np.float32(radius * abs(math.cos(2 * math.pi * u[SIN_AZIMUTH])))),
        float(np.float32(math.log(max(u[LOG_U], 1e-30)))),
        float(np.float32(math.cos(azimuth))),
        float(np.float32(math.sin(azimuth))),
        u[SURVIVAL],
    )


class Draws:
    """Draws for all rays of a simulator, made as they are needed and kept; a group is one scanline of one layer."""

    def __init__(self, path_seed: int, groups: int, rays: int) -> None:
        self.seed, self._groups, self._rays = np.uint64(path_seed % 2**64), groups, rays
        self._table = np.empty((MAX_ROWS, groups * rays, COLUMNS), np.float32)
        self._made = 0
        self._making = Lock()

    def aperture(self) -> np.ndarray:
        """Where in the aperture each ray starts, (2, groups, rays) float32 in [0, 1)."""
        return stratified(self._generator(0), self._groups, self._rays, 2)

    def table(self, interfaces: int) -> tuple[np.ndarray, int]:
        """Draws of all rays, (MAX_ROWS, groups * rays, COLUMNS) float32, and how many of its rows are filled.

        Columns: uniform choice, |normal|, log of a uniform, cosine and sine of a uniform angle, uniform.
        """
        with self._making:
            while self._made < min(interfaces, MAX_ROWS):
                generator, row = self._generator(self._made + 1), self._table[self._made]
                u = stratified(generator, self._groups, self._rays, 3).reshape(3, -1)
                angle = np.float32(2 * np.pi) * u[2]
                row[:, CHOICE] = u[0]
                row[:, THICKNESS] = np.abs(generator.standard_normal(u.shape[1], np.float32))
                row[:, LOG_U] = np.log(np.maximum(u[1], 1e-30))
                row[:, COS_AZIMUTH], row[:, SIN_AZIMUTH] = np.cos(angle), np.sin(angle)
                row[:, SURVIVAL] = generator.random(u.shape[1], np.float32)
                self._made += 1
            return self._table, self._made

    def _generator(self, counter: int) -> np.random.Generator:
        return np.random.Generator(np.random.Philox(key=np.array([self.seed, counter], np.uint64)))


class View(NamedTuple):
    """What rays travel through, and the elements that receive; a tuple, so that compiled code can take it."""

    media: Media
    tissue_of_owner: np.ndarray  # (structures + 1,) uint8
    elements: np.ndarray  # (groups, 3) float64, mm: where a scanline starts; a group is one scanline of one layer
    axes: np.ndarray  # (groups, 3) float64, unit vectors along the scanlines
    origins: np.ndarray  # (groups * rays, 3) float32, mm: where the rays leave the probe
    ways: np.ndarray  # (groups * rays, 3) float32, unit vectors: their straight ways from there
    rays: int  # of each group
    together: bool  # whether direct rays are asked for in packets
    path_seed: np.uint64
    depth_mm: float  # of the image; echoes displayed deeper are not followed
    roulette_db: float  # two-way amplitude at the image's depth under which Russian roulette may end a reflected ray
    followed: float  # part of the rays reflected for the first time that goes on
    gain_db_mm: float  # of the display with depth
    step_mm: float  # from a surface to the origin of the rays that leave it


@dataclass(frozen=True)
class Bundle:
    """Scanlines and rays, in probe coordinates or at a pose; a group is one scanline of one layer, layer by layer."""

    starts: np.ndarray  # (groups, 3) float64, mm: the elements on the face
    directions: np.ndarray  # (groups, 3) float64, of the scanlines
    origins: np.ndarray  # (groups * rays, 3), mm; float32 at a pose, as Embree takes them
    ray_directions: np.ndarray  # (groups * rays, 3), float32 at a pose
    inside: np.ndarray  # (groups * rays, words) uint32, the sets that rays start inside of; none but at a pose


def probe_rays(probe: Probe, settings: SimulatorSettings, draws: Draws, steered_rad: float = 0.0) -> Bundle:
    """Rays spread over the aperture, all at `focus_mm` from the focal point of their scanline and layer.

    Because path lengths to the focus agree, a point at the focus stays a point.

    Parameters
    ----------
    probe : Probe
        Its face.
    settings : SimulatorSettings
        How many scanlines, layers and rays there are, and where they meet.
    draws : Draws
        Of where in the aperture each ray starts.
    steered_rad : float
        Angle that the scanlines are steered by.
    """
    starts, directions = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings), steered_rad)
    starts, directions = starts.reshape(-1, 3), directions.reshape(-1, 3)
    lateral = np.stack([directions[:, 2], np.zeros(len(directions)), -directions[:, 0]], axis=-1)
    jitter = (2 * draws.aperture() - 1).astype(np.float64)
    half_angles = np.array([settings.aperture_mm, settings.elevational_aperture_mm]) / settings.focus_mm
    tilt_x, tilt_y = np.minimum(half_angles, _STEEPEST_RAD)[:, None, None] * jitter
    rays = directions[:, None] + np.tan(tilt_x)[..., None] * lateral[:, None] + np.tan(tilt_y)[..., None] * (0, 1, 0)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    origins = (starts + settings.focus_mm * directions)[:, None] - settings.focus_mm * rays
    sets = np.empty((0, 0), np.uint32)
    return Bundle(starts, directions, origins.reshape(-1, 3), rays.reshape(-1, 3), sets)


@stage(Stage.probe_rays)
def at_pose(geometry: Geometry, rays: Bundle, pose: np.ndarray) -> Bundle:
    """Scanlines and rays at a pose, from probe to the geometry's coordinates.

    The set of a ray is that of its element, unless some surface lies between them or in the element itself. Then each
    ray of that group is followed from outside in its own direction. Along the face, which nearly lies in the skin, a
    crossing can be missed, and a ray without the loss of its tissue would outweigh all others.
    """
    starts, lines = to_world(pose, rays.starts), rays.directions @ pose[:3, :3].T
    groups = len(starts)
    group = np.repeat(np.arange(groups), len(rays.origins) // groups)
    origins, directions = to_world(pose, rays.origins), rays.ray_directions @ pose[:3, :3].T
    element = starts[group]
    aside = origins - element
    length = np.sqrt(np.einsum("ij,ij->i", aside, aside))
    towards = (aside / np.maximum(length, 1e-12)[:, None]).astype(np.float32)
    between = geometry.closest(element.astype(np.float32), towards, length.astype(np.float32)).structure >= 0
    near_mm = _FACE_STEPS * geometry.step_mm
    before = (starts - near_mm * lines).astype(np.float32)
    through = geometry.closest(before, lines.astype(np.float32), np.full(groups, 2 * near_mm, np.float32))
    crossed = (np.bincount(group, between, minlength=groups) > 0) | (through.structure >= 0)
    unsure = np.flatnonzero(crossed[group])
    inside = inside_at(geometry, starts, lines)[group]
    inside[unsure] = inside_at(geometry, origins[unsure], directions[unsure])
    return Bundle(starts, lines, origins.astype(np.float32), directions.astype(np.float32), inside)


def start_rays(bundle: Bundle, chosen: slice, view: View) -> np.ndarray:
    """Some rays of a frame, by their numbers, at the probe, (n,) RAY."""
    medium = view.tissue_of_owner[owners(bundle.inside[chosen])]
    rays = np.zeros(len(medium), RAY)
    rays["number"] = np.arange(chosen.start, chosen.stop)
    rays["origin"], rays["direction"] = bundle.origins[chosen], bundle.ray_directions[chosen]
    rays["medium"], rays["weight"], rays["growth"] = medium, 1.0, 1.0
    rays["structure"] = rays["triangle"] = -1
    rays["reach_mm"] = np.float32(view.depth_mm) / view.media.stretch[medium]
    return rays
