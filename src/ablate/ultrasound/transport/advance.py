"""One bounce of all rays of a part: each advances to the next surface that it meets, and is done, split or sent on.

A function is a step of one ray, as its name says; `tracing` says why rays are split and ended as they are.
"""

import math
from typing import Any

import numpy as np

from ablate.ultrasound.compiled import Arrays, Vector, compiled, step
from ablate.ultrasound.media import Medium
from ablate.ultrasound.surfaces.embree import (
    Asked,
    Packet,
    asked_packet,
    asked_ray,
    at,
)
from ablate.ultrasound.surfaces.line_walk import owner, toggle
from ablate.ultrasound.transport import bounce
from ablate.ultrasound.transport.lines import Nodes, passed
from ablate.ultrasound.transport.rays import MAX_ROWS, Drawn, Ray, View, tabulated, unstratified
from ablate.ultrasound.transport.scattering import Scattering, along, sample_scattering
from ablate.ultrasound.transport.steps import (
    direct_rays,
    direction_of,
    goes_astray,
    interface_of,
    is_fresh,
    length_ahead,
    medium_of,
    move_up,
    next_hit,
    origin_of,
    surface_of,
)

Echo = Any  # a row of an array of ECHO, as compiled code takes it


@compiled
def bounces(
    address: int, arrays: Arrays, n: int, received: int, view: View, table: np.ndarray, rows: int, nodes: Nodes
) -> tuple[Arrays, int, int]:
    """Advance rays until none is left, or until one has met as many interfaces as the table of draws has rows.

    Parameters
    ----------
    address : int
        That of the geometry.
    arrays : tuple of array
        The rays, (any,) RAY, of which the first n count; the sets that they are inside of, (any, words) uint32; echoes,
        (any,) ECHO. They grow where they are too small.
    n, received : int
        How many rays there are, and how many echoes.
    view : View
        What the rays travel through, and what receives their echoes.
    table : (MAX_ROWS, rays of the frame, COLUMNS) float32
        Draws.
    rows : int
        How many of its rows are filled.
    nodes : Nodes
        What insonifies the scanlines; is added to.

    Returns
    -------
    arrays, n, received
        The same, afterwards.
    """
    rays, inside, echoes = arrays
    embree = address, asked_ray(), asked_packet()
    while n > 0:
        if rows < MAX_ROWS:
            for i in range(n):
                if rays[i].interfaces >= rows:
                    return (rays, inside, echoes), n, received
        rays, inside, echoes = grown(rays, 2 * n), grown(inside, 2 * n), grown(echoes, received + n)
        n, count = advance(embree, rays, inside, echoes[received:], n, view, table, nodes)
        received += count
    return (rays, inside, echoes), n, received


@compiled
def grown(rows: np.ndarray, count: int) -> np.ndarray:
    """The same rows, with at least `count` of them and then twice as many; those added are not initialised."""
    if len(rows) >= count:
        return rows
    return np.concatenate((rows, np.empty((2 * count - len(rows), *rows.shape[1:]), rows.dtype)))


@step
def advance(
    embree: tuple[int, Asked, Packet],
    rays: np.ndarray,
    inside: np.ndarray,
    echoes: np.ndarray,
    n: int,
    view: View,
    table: np.ndarray,
    nodes: Nodes,
) -> tuple[int, int]:
    """Advance n rays to the surfaces that they hit: one bounce of the path tracer.

    Reflected rays are written behind all rays at first, because transmitted rays take the rows from 0.

    Parameters
    ----------
    embree : tuple of int, Asked and Packet
        Address of the geometry, and room to ask for a hit and for several: direct rays come first, scanline by
        scanline, and go nearly the same way.
    rays : (2 n or more,) RAY
        The first n are advanced; what comes of them takes their place.
    inside : (2 n or more, words) uint32
        The sets that the rays are inside of.
    echoes : (n or more,) ECHO
        Is filled from the beginning.
    n : int
        How many rays there are.
    view, table, nodes : View, array, Nodes
        As in `bounces`.

    Returns
    -------
    int
        How many rays there are then.
    int
        How many echoes were written.
    """
    transmitted, reflected, received = 0, n, 0
    direct = direct_rays(rays, n) if view.together else 0
    for i in range(n):
        ray = rays[i]
        hit = next_hit(embree, rays, i, direct)
        medium = medium_of(view.media, ray.medium)
        astray = False
        if ray.reflections == 0:
            astray = medium.anechoic and goes_astray(ray, hit, at(view.origins, ray.number), at(view.ways, ray.number))
            _insonify(nodes, view, ray, medium, length_ahead(ray, hit) * medium.stretch, ray.weight, astray)
        if hit.structure < 0:
            continue
        point = along(origin_of(ray), direction_of(ray), hit.distance_mm)
        onward = direction_of(ray)
        if is_fresh(ray, hit):
            toggle(inside, i, hit.structure)
        step_mm = move_up(ray, hit, medium, view.step_mm)
        beyond = view.tissue_of_owner[owner(inside, i)]
        if view.media.differs[ray.medium, beyond]:
            drawn = tabulated(table, min(ray.interfaces, MAX_ROWS - 1), ray.number)
            if ray.interfaces >= MAX_ROWS:
                drawn = unstratified(view.path_seed, ray.interfaces, ray.number)
            surface = surface_of(view.media, view.tissue_of_owner[hit.structure + 1])
            scattering = sample_scattering(
                onward,
                hit.normal,
                interface_of(view.media, ray.medium, beyond),
                surface.lobe_exponent,
                (drawn.log_u, drawn.cos_azimuth, drawn.sin_azimuth),
                view.media.rough,
            )
            thickness_mm = np.float64(drawn.thickness * surface.thickness_mm)  # both float32
            link = _connect(ray, point, medium, thickness_mm, view)
            received += _receive(
                echoes[received], ray, scattering, link, thickness_mm * medium.stretch, surface.specularity, view
            )
            if link.depth_mm >= view.depth_mm:
                continue
            ray.interfaces += 1
            if ray.reflections == 0 and bounce.reflects(scattering.pressure):
                # the level is interpolated between nodes: keep it up to the surface
                weight = ray.weight * (scattering.pressure * scattering.pressure)
                _insonify(nodes, view, ray, medium, nodes.spacing_mm, weight, astray)
            back_weight, ray.weight = _share(ray, scattering, link, view, drawn)
            if back_weight > 0:
                _copy(rays, inside, i, reflected)
                toggle(inside, reflected, hit.structure)
                _turn_back(rays[reflected], medium, thickness_mm)
                _send_off(rays[reflected], point, scattering.reflected, back_weight, step_mm, medium.stretch, view)
                reflected += 1
            onward = scattering.transmitted
        if ray.weight > 0:
            _copy(rays, inside, i, transmitted)
            rays[transmitted].medium = beyond
            stretch = view.media.stretch[beyond]
            _send_off(rays[transmitted], point, onward, ray.weight, step_mm, float(stretch), view)
            transmitted += 1
    for i in range(n, reflected):
        _copy(rays, inside, i, transmitted)
        transmitted += 1
    return transmitted, received


@step
def _insonify(
    nodes: Nodes, view: View, ray: Ray, medium: Medium, length_mm: float, weight: float, astray: bool
) -> None:
    """Add a ray's amplitude to the nodes on a displayed length of its way; astray, only to those without tissue."""
    group, count = ray.number // view.rays, nodes.amplitude.shape[1]
    first, last, level, factor = passed(nodes.first_mm, nodes.spacing_mm, count, ray, medium, length_mm, weight)
    for k in range(first, last):
        if not astray or nodes.anechoic[group, k]:
            nodes.amplitude[group, k] += level
        level *= factor


@step
def _connect(ray: Ray, point: Vector, medium: Medium, thickness_mm: float, view: View) -> bounce.Connection:
    """The way from a surface back to the ray's element."""
    group = ray.number // view.rays
    if ray.reflections == 0:  # off its own straight way
        aside_mm2 = bounce.aside(point, at(view.origins, ray.number), at(view.ways, ray.number))
    else:  # off its scanline
        aside_mm2 = bounce.aside(point, at(view.elements, group), at(view.axes, group))
    return bounce.connect(ray, point, medium, thickness_mm, at(view.elements, group), aside_mm2)


@step
def _receive(
    echo: Echo,
    ray: Ray,
    scattering: Scattering,
    link: bounce.Connection,
    deeper_mm: float,
    specularity: float,
    view: View,
) -> int:
    """How many echoes of a surface the element receives, `deeper_mm` behind it as displayed: fills `echo`, or not."""
    depth_mm = link.depth_mm + deeper_mm
    if depth_mm >= view.depth_mm:
        return 0
    amplitude = bounce.echo(ray, scattering, link, specularity)
    if amplitude <= 0:
        return 0
    echo.group = ray.number // view.rays
    echo.depth_mm = depth_mm
    echo.amplitude = amplitude
    echo.clutter = not link.sharp
    return 1


@step
def _share(ray: Ray, scattering: Scattering, link: bounce.Connection, view: View, drawn: Drawn) -> tuple[float, float]:
    """Weights of what a surface sends back and of what it lets through, after Russian roulette."""
    faint_db = 0.0  # not read where a direct ray is transmitted alone
    if ray.reflections > 0 or bounce.reflects(scattering.pressure):
        # How much fainter than its weight: loss, direction, half the gain ahead. What the time gain adds up to the end
        # of the image makes up for loss in tissue, not in fluid.
        ahead_db = view.gain_db_mm * max(view.depth_mm - link.depth_mm, 0.0)
        faint_db = link.two_way_db + ahead_db / 2 + min(link.aside_db, bounce.MOST_ASIDE_DB)
    return bounce.go_on(ray, scattering.pressure, drawn, faint_db, view.roulette_db, view.followed)


@step
def _copy(rays: np.ndarray, inside: np.ndarray, row: int, to: int) -> None:
    """Write a ray and its set to another row, too."""
    rays[to] = rays[row]
    for word in range(inside.shape[1]):
        inside[to, word] = inside[row, word]


@step
def _turn_back(ray: Ray, medium: Medium, thickness_mm: float) -> None:
    """Reflect a ray from behind its surface: there and back."""
    ray.reflections += 1
    ray.path_mm += 2 * thickness_mm
    ray.displayed_mm += 2 * thickness_mm * medium.stretch
    ray.loss_db += 2 * thickness_mm * medium.loss_db_mm


@step
def _send_off(
    ray: Ray, point: Vector, direction: Vector, weight: float, step_mm: float, stretch: float, view: View
) -> None:
    """Let a ray leave a surface until it is deeper than the image; one that was reflected goes down and up again.

    That one ends where it leaves the cylinder about its scanline, too.
    """
    ways, leaves_mm = 1.0, math.inf
    if ray.reflections > 0:
        group = ray.number // view.rays
        ways, leaves_mm = 2.0, bounce.leaves(point, direction, at(view.elements, group), at(view.axes, group))
    ray.origin[0], ray.origin[1], ray.origin[2] = along(point, direction, step_mm)
    ray.direction[0], ray.direction[1], ray.direction[2] = direction
    ray.weight = weight
    ray.reach_mm = min((ways * view.depth_mm - ray.displayed_mm) / stretch, leaves_mm)
