"""One line for each scanline and layer, which surfaces refract about their own normals: their echoes, and what is left.

Lines are neither reflected nor split. A surface of rough normals has its mean effect, so nothing is random.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.special import xlogy

from ablate.ultrasound.compiled import Vector, compiled, step
from ablate.ultrasound.media import Media, Medium, Surface
from ablate.ultrasound.surfaces.embree import Hit, asked_ray, at
from ablate.ultrasound.surfaces.line_walk import owner, toggle
from ablate.ultrasound.transport import bounce
from ablate.ultrasound.transport.rays import Ray
from ablate.ultrasound.transport.scattering import Interface, along, dot, sample_scattering
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

_NORMALS = 8  # of a rough surface, over which its echo and what it lets through are averaged
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


def lattice() -> np.ndarray:
    """What `sample_scattering` takes as drawn, (_NORMALS, 3): tilts of equal weight, each in four directions.

    The logarithm of a tilt is its mean over one of equal parts of (0, 1), so the mean squared tilt is that of all.
    """
    tilts = _NORMALS // 4
    ends, turn = np.linspace(0, 1, tilts + 1), np.arange(tilts)[:, None] / tilts
    azimuth = (math.pi / 2 * (np.arange(4) + turn)).ravel()
    log_u = np.repeat(tilts * np.diff(xlogy(ends, ends) - ends), 4)
    return np.stack([log_u, np.cos(azimuth), np.sin(azimuth)], axis=-1)


def start_lines(starts: np.ndarray, directions: np.ndarray, tissue: np.ndarray) -> np.ndarray:
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
    normals: np.ndarray  # see `lattice`
    depth_mm: float  # of the image
    starts: np.ndarray  # (lines, 3) float64, mm: the elements
    straight: np.ndarray  # (lines, 3) float64, unit vectors along the scanlines
    inside: np.ndarray  # (lines, words) uint32: the sets that lines are inside of, as they go
    amplitude: np.ndarray  # (lines, rows) float32: of the echoes of surfaces
    sound: np.ndarray  # (lines, nodes) float64: the power that is left


@compiled
def follow(lines: np.ndarray, through: Following, begin: int, end: int) -> None:
    """Follow some lines until they are deeper than the image.

    Parameters
    ----------
    lines : (n,) LINE
        All of them, at the probe; those that are followed are changed.
    through : Following
        What they travel through, and what is filled on the way.
    begin, end : int
        Which of them are followed.
    """
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
            point = along(origin_of(line), direction_of(line), hit.distance_mm)
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
            line.origin[0], line.origin[1], line.origin[2] = along(point, onward, step_mm)
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
    interface: Interface,
    surface: Surface,
    to_element: Vector,
    normals: np.ndarray,
    rough: bool,
) -> Scattered:
    """Scatter at a surface about each of its normals."""
    exponent, specularity = float(surface.lobe_exponent), float(surface.specularity)
    distance_mm = max(math.sqrt(dot(to_element, to_element)), 1e-6)
    returned, passed, onward = 0.0, 0.0, (0.0, 0.0, 0.0)
    count = len(normals) if exponent > 0 else 1
    for k in range(count):
        tilt = normals[k, 0], normals[k, 1], normals[k, 2]
        scattering = sample_scattering(direction, hit.normal, interface, exponent, tilt, rough)
        towards = dot(scattering.reflected, to_element) / distance_mm
        if specularity == 0:
            returned += abs(scattering.pressure)
        elif towards > 0:
            returned += abs(scattering.pressure) * math.exp(specularity * math.log(towards))
        through = 1 - scattering.pressure * scattering.pressure
        passed += through
        onward = along(onward, scattering.transmitted, through)
    length = math.sqrt(dot(onward, onward))
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
