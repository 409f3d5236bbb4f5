"""Two maps of surfaces: what they return, and how much sound reaches each point.

Segmentation and attenuation do not say how a surface is tilted out of the image plane, and that decides whether a rib
is white or black; nor what surfaces keep from the tissue behind them, as gas does, which attenuates little. Both follow
from one ray a scanline and layer, which surfaces refract about their own normals. Bone bends it away or reflects all of
it, so a straight line would put its shadow in the wrong place. What surfaces reflect to one another fills fluid with
haze. It is spread over many scanlines, so one traced ray on each of them is enough.
"""

import math
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from scipy.special import xlogy

from ablate.threads import in_parts, side_by_side
from ablate.ultrasound.compiled import Arrays, Vector, compiled, exponential, step
from ablate.ultrasound.imaging.point_spread import axial_kernel, layer_weights
from ablate.ultrasound.media import Media, Medium, RenderPlan, Surface
from ablate.ultrasound.probe import layer_offsets_mm, sample_depths_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import Geometry, Hit, asked_ray, at
from ablate.ultrasound.surfaces.line_walk import inside_at, owner, owners, toggle
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport import bounce
from ablate.ultrasound.transport.aperture import Aperture
from ablate.ultrasound.transport.lines import NODES, Nodes, clutter_lines, echo_lines, mean_level_db
from ablate.ultrasound.transport.rays import Ray
from ablate.ultrasound.transport.steps import (
    direction_of,
    goes_astray,
    interface_of,
    is_fresh,
    length_ahead,
    look_ahead,
    medium_of,
    move_up,
    origin_of,
    surface_of,
)
from ablate.ultrasound.transport.tracing import Tracer

#: Levels that are 0 and 1 in the maps, dB: of an echo about white; of sound about tissue whose loss the gain makes up.
ECHO_DB, LIGHT_DB = (-60.0, 20.0), (-48.0, 24.0)
_LINES_OF_A_PART = 32
_LINES_BESIDE = 15  # scanlines whose pencils cross those ways to a point that matter most
_MOST_MORE_DB = 40.0  # of an echo whose own pencil hardly reaches it
_NORMALS = 8  # of a rough surface, over which its echo and what it lets through are averaged
_PATH_SEED = 2**63  # of the rays for haze, the same for every frame: other paths than those of an image
_NEPER_PER_POWER_DB = math.log(10) / 10
_MEAN_DEPTH = math.sqrt(2 / math.pi)  # of a surface's echo, in units of its thickness: the mean of a half normal

#: A line under way: those fields of a RAY that `steps` needs, in double precision.
LINE = np.dtype(
    [
        ("origin", np.float64, 3),
        ("direction", np.float64, 3),
        ("medium", np.int32),
        ("path_mm", np.float64),
        ("displayed_mm", np.float64),
        ("loss_db", np.float64),
        ("weight", np.float64),  # share of the power that surfaces have let through
        ("structure", np.int32),
        ("triangle", np.int32),
        ("step_mm", np.float64),
        ("reach_mm", np.float64),
    ],
    align=True,
)


class SurfaceMaps:
    """Makes the maps of a geometry, for one probe and one set of settings."""

    def __init__(
        self,
        geometry: Geometry,
        plan: RenderPlan,
        seen: tuple[torch.Tensor, Aperture],
        probe: Probe,
        settings: SimulatorSettings,
    ) -> None:
        self._geometry, self._plan, (self._beam, self._aperture) = geometry, plan, seen
        self._shape = settings.beam_shape
        self._depth_mm = probe.depth_mm
        self._lines = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings))
        gain_db = time_gain_db(sample_depths_mm(probe, self._shape[0]), probe, settings.time_gain)
        self._gains_db = np.stack([gain_db - 20 * math.log10(settings.reference_level), gain_db])
        self._normals = _lattice()
        self._tracer = Tracer(geometry, plan, probe, replace(settings, rays=1, path_seed=_PATH_SEED))
        self._weights = layer_weights(probe, settings)[1]
        # of the amplitude of a row to that of its samples, which the pulse adds up
        self._haze = self._shape[0] / settings.axial_samples * axial_kernel(probe, settings).sum()

    @stage(Stage.surface_maps)
    def __call__(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Interfaces and illumination, (rows, scanlines) float32 in [0, 1] each; `pose` leads to the geometry's world.

        A surface returns the share w E[R_p max(0, cos g)^n] 10^(-2 alpha f d / 20) of the amplitude. The angle g lies
        between the reflected direction and the way back to the element, and w is the product of E[1 - R_p^2] over the
        surfaces before. The mean E is over the normals of a rough surface (docs/simulator.md, sections 5 and 6). The
        illumination is w 10^(-2 alpha f d / 20), without the factors of a surface. The beam and the aperture are those
        of the image. Powers of the layers are averaged, and the time gain is added. Interfaces also have the power of
        reverberation, as one ray of each scanline and layer brings it back.
        """
        (direct, levels), haze = side_by_side(partial(self._direct, pose), partial(self._reverberation, pose))
        made = np.empty(haze.shape, np.float32), np.empty(haze.shape, np.float32)
        show = partial(_show, direct, levels, haze, self._gains_db, made)
        in_parts(show, len(haze), _LINES_OF_A_PART)
        return np.ascontiguousarray(made[0].T), np.ascontiguousarray(made[1].T)

    def _direct(self, pose: np.ndarray) -> tuple[np.ndarray, Arrays]:
        """Echoes, (layers, scanlines, rows); levels of pencils and of all elements, (layers, scanlines, nodes), dB."""
        starts, directions = to_world(pose, self._lines[0]), self._lines[1] @ pose[:3, :3].T
        of_lines = *starts.shape[:2], -1
        starts, directions = starts.reshape(-1, 3), directions.reshape(-1, 3)
        inside = inside_at(self._geometry, starts, directions)
        lines = _start_lines(starts, directions, self._plan.tissue_of_owner[owners(inside)])
        through = Following(
            address=self._geometry.address,
            step_mm=self._geometry.step_mm,
            media=self._plan.media,
            tissue_of_owner=self._plan.tissue_of_owner,
            normals=self._normals,
            depth_mm=self._depth_mm,
            starts=starts,
            straight=directions,
            inside=inside,
            amplitude=np.zeros((len(starts), self._shape[0]), np.float32),
            sound=np.zeros((len(starts), min(self._shape[0], NODES))),
        )
        in_parts(partial(_follow, lines, through), len(starts), _LINES_OF_A_PART)
        mean_db = mean_level_db(through.sound, 1, self._beam)
        _, level_db = self._aperture.gain_and_level_db(mean_db)
        return through.amplitude.reshape(of_lines), (mean_db.reshape(of_lines), level_db.reshape(of_lines))

    def _reverberation(self, pose: np.ndarray) -> np.ndarray:
        """Amplitudes of what surfaces reflect to one another, (scanlines, rows)."""
        bundle = self._tracer.at(pose)
        groups = len(bundle.starts)
        nodes = Nodes(0.0, 1.0, np.empty((groups, 0), bool), np.empty((groups, 0)))  # no light is asked for
        echoes = self._tracer(bundle, nodes)
        late = echoes[echoes["clutter"]]
        _, reverberation = echo_lines(late, np.empty((groups, 0)), nodes, self._weights, 1, self._depth_mm)
        haze = clutter_lines(reverberation, self._shape[0], torch.float64, self._haze, sets=1)
        return haze if len(haze) else np.zeros(self._shape[::-1])


def _lattice() -> np.ndarray:
    """What `bounce.sample_scattering` takes as drawn, (_NORMALS, 3): tilts of equal weight, each in four directions.

    The logarithm of a tilt is its mean over one of equal parts of (0, 1), so the mean squared tilt is that of all.
    """
    tilts = _NORMALS // 4
    ends, turn = np.linspace(0, 1, tilts + 1), np.arange(tilts)[:, None] / tilts
    azimuth = (math.pi / 2 * (np.arange(4) + turn)).ravel()
    log_u = np.repeat(tilts * np.diff(xlogy(ends, ends) - ends), 4)
    return np.stack([log_u, np.cos(azimuth), np.sin(azimuth)], axis=-1)


def _start_lines(starts: np.ndarray, directions: np.ndarray, tissue: np.ndarray) -> np.ndarray:
    """Lines at the probe, (n,) LINE: where they start, their directions, and the tissue that each starts in."""
    lines = np.zeros(len(starts), LINE)
    lines["origin"] = starts
    lines["direction"] = directions
    lines["medium"] = tissue
    lines["weight"] = 1.0
    lines["structure"] = lines["triangle"] = -1
    return lines


class Following(NamedTuple):
    """What lines are followed through, and what is filled on the way; a tuple, so that compiled code can take it."""

    address: int  # of the geometry
    step_mm: float  # as in View
    media: Media
    tissue_of_owner: np.ndarray
    normals: np.ndarray  # see `_lattice`
    depth_mm: float  # of the image
    starts: np.ndarray  # (lines, 3) float64, mm: the elements
    straight: np.ndarray  # (lines, 3) float64, unit vectors along the scanlines
    inside: np.ndarray  # (lines, words) uint32: the sets that lines are inside of, as they go
    amplitude: np.ndarray  # (lines, rows) float32: of the echoes of surfaces
    sound: np.ndarray  # (lines, nodes) float64: the power that is left


@compiled
def _follow(lines: np.ndarray, through: Following, begin: int, end: int) -> None:
    """Follow some lines, (n,) LINE, until they are deeper than the image."""
    embree, depth_mm = (through.address, asked_ray()), through.depth_mm
    for number in range(begin, end):
        line, filled = lines[number], 0
        start, straight = at(through.starts, number), at(through.straight, number)
        while line.displayed_mm < depth_mm and line.weight > 0:
            medium = medium_of(through.media, line.medium)
            line.reach_mm = (depth_mm - line.displayed_mm) / medium.stretch
            hit = look_ahead(embree, line)
            heard = not (medium.anechoic and goes_astray(line, hit, start, straight))
            to_mm = min(line.displayed_mm + length_ahead(line, hit) * medium.stretch, depth_mm)
            filled = _insonify(through.sound, number, filled, line, medium, to_mm, depth_mm, heard)
            if hit.structure < 0:
                break
            point = bounce.along(origin_of(line), direction_of(line), hit.distance_mm)
            onward = direction_of(line)
            if is_fresh(line, hit):
                toggle(through.inside, number, hit.structure)
            step_mm = move_up(line, hit, medium, through.step_mm)
            beyond = through.tissue_of_owner[owner(through.inside, number)]
            if through.media.differs[line.medium, beyond]:
                surface = surface_of(through.media, through.tissue_of_owner[hit.structure + 1])
                interface = interface_of(through.media, line.medium, beyond)
                to_element = start[0] - point[0], start[1] - point[1], start[2] - point[2]
                scattered = _scatter(onward, hit, interface, surface, to_element, through.normals, through.media.rough)
                if bounce.aside(point, start, straight) < bounce.IN_BEAM_MM**2:
                    echo_mm = line.displayed_mm + _MEAN_DEPTH * surface.thickness_mm * medium.stretch
                    echo = line.weight * scattered.returned / scattered.normals * 10 ** (-line.loss_db / 10)
                    _add_echo(through.amplitude, number, echo_mm, depth_mm, echo)
                line.weight *= scattered.passed / scattered.normals
                onward = scattered.onward
            line.origin[0], line.origin[1], line.origin[2] = bounce.along(point, onward, step_mm)
            line.direction[0], line.direction[1], line.direction[2] = onward
            line.medium = beyond


@step
def _insonify(
    sound: np.ndarray,
    number: int,
    filled: int,
    line: Ray,
    medium: Medium,
    to_mm: float,
    depth_mm: float,
    heard: bool,
) -> int:
    """Fill the nodes of a line up to a displayed depth, from the first that is not yet filled; returns the next one."""
    nodes = sound.shape[1]
    node_mm = depth_mm / nodes
    ahead_db = medium.loss_db_mm * ((filled + 0.5) * node_mm - line.displayed_mm) / medium.stretch
    level = line.weight * 10 ** (-(line.loss_db + ahead_db) / 10) if heard else 0.0
    factor = 10 ** (-medium.loss_db_mm * node_mm / medium.stretch / 10)
    while filled < nodes and (filled + 0.5) * node_mm < to_mm:
        sound[number, filled] = level
        level *= factor
        filled += 1
    return filled


class Scattered(NamedTuple):
    """What a surface does, the sum over its normals: what it returns to the element, and what it lets through."""

    returned: float
    passed: float
    normals: int
    onward: Vector  # the mean direction of what it lets through


@step
def _scatter(
    direction: Vector,
    hit: Hit,
    interface: bounce.Interface,
    surface: Surface,
    to_element: Vector,
    normals: np.ndarray,
    rough: bool,
) -> Scattered:
    """Scatter at a surface about each of its normals."""
    exponent, specularity = float(surface.lobe_exponent), float(surface.specularity)
    distance_mm = max(math.sqrt(bounce.dot(to_element, to_element)), 1e-6)
    returned, passed, onward = 0.0, 0.0, (0.0, 0.0, 0.0)
    count = len(normals) if exponent > 0 else 1
    for k in range(count):
        tilt = normals[k, 0], normals[k, 1], normals[k, 2]
        scattering = bounce.sample_scattering(direction, hit.normal, interface, exponent, tilt, rough)
        towards = bounce.dot(scattering.reflected, to_element) / distance_mm
        if specularity == 0:
            returned += abs(scattering.pressure)
        elif towards > 0:
            returned += abs(scattering.pressure) * math.exp(specularity * math.log(towards))
        through = 1 - scattering.pressure * scattering.pressure
        passed += through
        onward = bounce.along(onward, scattering.transmitted, through)
    length = math.sqrt(bounce.dot(onward, onward))
    if length > 0:
        return Scattered(returned, passed, count, (onward[0] / length, onward[1] / length, onward[2] / length))
    return Scattered(returned, passed, count, direction)


@step
def _add_echo(amplitude: np.ndarray, number: int, at_mm: float, depth_mm: float, echo: float) -> None:
    """Share an echo between the two rows of a line on either side of its displayed depth."""
    rows = amplitude.shape[1]
    place = at_mm / (depth_mm / rows) - 0.5
    if place < rows:
        before = min(max(int(place), 0), rows - 1)
        part = min(max(place - before, 0.0), 1.0)
        amplitude[number, before] += (1 - part) * echo
        amplitude[number, min(before + 1, rows - 1)] += part * echo


@compiled
def _show(
    direct: np.ndarray, levels_db: Arrays, haze: np.ndarray, gains_db: np.ndarray, made: Arrays, begin: int, end: int
) -> None:
    """Fill both maps of some scanlines, (scanlines, rows), from what `_direct` and `_reverberation` return.

    Gains, (2, rows), are those of echoes, whose white is 0 dB, and of sound.
    """
    (pencils_db, all_db), (interfaces, illumination) = levels_db, made
    layers, _, rows = direct.shape
    nodes = pencils_db.shape[2]
    place = np.minimum(np.maximum((np.arange(rows) + 0.5) * (nodes / rows) - 0.5, 0), nodes - 1)
    before = np.minimum(place.astype(np.int64), max(nodes - 2, 0))
    part, after = place - before, np.minimum(before + 1, nodes - 1)
    least = 10 ** ((ECHO_DB[0] - gains_db[0]) / 10)
    for line in range(begin, end):
        echo, light, more_db = np.square(haze[line]), np.zeros(nodes), np.empty(nodes)
        for layer in range(layers):
            # The mean over elements is no more than what the best of them brings, which interpolation in depth forgets.
            best = _largest_beside(pencils_db[layer], line)
            for node in range(nodes):
                level_db = min(all_db[layer, line, node], best[node])
                light[node] += exponential(level_db * _NEPER_PER_POWER_DB) / layers
                more_db[node] = min(level_db - pencils_db[layer, line, node], _MOST_MORE_DB)
            for row in range(rows):
                if direct[layer, line, row] > 0:
                    gain_db = _between(more_db, before[row], after[row], part[row])
                    echo[row] += direct[layer, line, row] ** 2 * exponential(gain_db * _NEPER_PER_POWER_DB) / layers
        light_db = 10 * np.log10(np.maximum(light, 1e-30))
        for row in range(rows):
            level_db = _between(light_db, before[row], after[row], part[row]) + gains_db[1, row]
            illumination[line, row] = _scaled(level_db, LIGHT_DB)
            level_db = ECHO_DB[0] if echo[row] <= least[row] else 10 * math.log10(echo[row]) + gains_db[0, row]
            interfaces[line, row] = _scaled(level_db, ECHO_DB)


@step
def _between(values: np.ndarray, before: int, after: int, part: float) -> float:
    """Interpolate between two values, `part` of the way."""
    return values[before] + part * (values[after] - values[before])


@step
def _scaled(level_db: float, zero_and_one_db: tuple[float, float]) -> float:
    """A level on a scale from 0 to 1, and the nearest of both beyond."""
    zero_db, one_db = zero_and_one_db
    return min(max((level_db - zero_db) / (one_db - zero_db), 0.0), 1.0)


@compiled
def _largest_beside(levels_db: np.ndarray, line: int) -> np.ndarray:
    """The largest level of a scanline and of those beside it at each node, of (scanlines, nodes)."""
    lines, nodes = levels_db.shape
    best = levels_db[line].copy()
    for beside in range(max(line - _LINES_BESIDE // 2, 0), min(line + _LINES_BESIDE // 2 + 1, lines)):
        for node in range(nodes):
            one, two = best[node], levels_db[beside, node]
            best[node] = one if one > two else two
    return best
