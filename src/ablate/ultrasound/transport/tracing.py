"""Monte-Carlo path tracing of rays: they meet surfaces, echo there, and are transmitted, reflected, or both.

All rays of a part advance by one surface at a time: intersect, interact, sample the scattering, connect to the element
(an echo), Russian roulette, spawn.

The weight of a ray, its throughput, is a two-way amplitude. Through an interface its expectation is
1 - R = t12 t21 with R = R_p^2, exactly what a pulse keeps on its way there and link. The echo of a ray that was
reflected before returns straight to its element, where the surface that reflected it does not reflect it again: the
expectation off that interface is |R_p|, once.

How a ray goes on is sampled so that errors are small, with these expectations. A direct ray, never reflected, carries
the image: a surface splits it into a transmitted one, with 1 - R of its weight, and a reflected one, with |R_p|. A ray
that was reflected once is split, too. So that rays do not multiply, one that was reflected more often is either
reflected, with the probability |R_p|, or transmitted. Were it reflected with the probability R, the few that are would
have the weight 1 / |R_p|, and would appear as isolated dots in dark fluid. Russian roulette ends faint reflected rays.
"""

import math
from typing import NamedTuple

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.media import Medium
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import Geometry, asked_ray, closest_of
from ablate.ultrasound.surfaces.line_walk import next_step, owner, toggle
from ablate.ultrasound.transport import bounce
from ablate.ultrasound.transport.lines import ECHO, Nodes, accumulate
from ablate.ultrasound.transport.rays import (
    CHOICE,
    COLUMNS,
    MAX_ROWS,
    SURVIVAL,
    THICKNESS,
    Bundle,
    Draws,
    View,
    start_rays,
    unstratified,
)

_GROUPS_OF_A_PART = 96


class Paths(NamedTuple):
    """The rays of a frame, what they travel through, and what they add to."""

    geometry: Geometry
    view: View
    draws: Draws
    bundle: Bundle
    nodes: Nodes


@stage(Stage.tracing)
def trace(paths: Paths) -> np.ndarray:
    """The echoes, (n,) ECHO, of the rays of a frame until they are deeper than the image; `nodes` are accumulated."""
    geometry, view, draws, bundle, nodes = paths

    def part(begin: int, end: int) -> np.ndarray:
        chosen = slice(begin * view.rays, end * view.rays)
        rays, sets = start_rays(bundle, chosen, view), bundle.inside[chosen].copy()
        n, rows, count, echoes = len(rays), 0, 0, np.empty(4 * len(rays), ECHO)
        while n:  # comes back for more of the table of draws
            rows += 1
            given = view, draws.table(rows), rows, nodes, echoes, count
            rays, sets, n, echoes, count = _bounces(geometry.address, rays, sets, n, *given)
        return echoes[:count]

    return np.concatenate(in_parts(part, len(bundle.starts), _GROUPS_OF_A_PART))


@compiled
def _bounces(
    address: int,
    rays: np.ndarray,
    inside: np.ndarray,
    n: int,
    view: View,
    table: np.ndarray,
    rows: int,
    nodes: Nodes,
    echoes: np.ndarray,
    received: int,
) -> tuple[np.ndarray, np.ndarray, int, np.ndarray, int]:
    """Advance rays until none is left, or until one has met as many interfaces as the table has `rows`.

    Returns the arrays, which grow where they are too small, with the numbers of rays and of echoes.
    """
    asked = asked_ray()
    while n > 0:
        if rows < MAX_ROWS:
            for i in range(n):
                if rays[i].interfaces >= rows:
                    return rays, inside, n, echoes, received
        rays, inside, echoes = _grown(rays, 2 * n), _grown(inside, 2 * n), _grown(echoes, received + n)
        n, count = _advance(address, asked, rays, inside, n, view, table, nodes, echoes[received:])
        received += count
    return rays, inside, n, echoes, received


@compiled
def _grown(rows: np.ndarray, count: int) -> np.ndarray:
    """The same rows, with at least `count` of them and then twice as many; those added are not initialised."""
    if len(rows) >= count:
        return rows
    more = np.empty((2 * count, *rows.shape[1:]), rows.dtype)
    more[: len(rows)] = rows
    return more


@compiled
def _advance(
    address: int,
    asked: np.ndarray,
    rays: np.ndarray,
    inside: np.ndarray,
    n: int,
    view: View,
    table: np.ndarray,
    nodes: Nodes,
    echoes: np.ndarray,
) -> tuple[int, int]:
    """Advance n rays to the surfaces that they hit: one bounce of the path tracer.

    Reflected rays are written behind all rays at first, because transmitted rays take the rows from 0. Returns how many
    rays there are then, and how many echoes were written.
    """
    media = view.media
    beyond_table = np.empty(COLUMNS, np.float32)
    transmitted, reflected, received = 0, n, 0
    for i in range(n):
        ray = rays[i]
        hit = closest_of(address, asked, ray.origin, ray.direction, ray.reach_mm)
        group, direct = ray.number // view.rays, ray.reflections == 0
        tissue = ray.medium
        medium = Medium(float(media.loss_db_mm[tissue]), float(media.stretch[tissue]), media.anechoic[tissue])
        if direct:  # up to the surface, or to the end of the image
            ahead_mm = (hit.distance_mm + ray.step_mm) * medium.stretch if hit.structure >= 0 else math.inf
            accumulate(nodes, group, ray, medium, ahead_mm, ray.weight)
        if hit.structure < 0:
            continue
        fresh = hit.structure != ray.structure or hit.triangle != ray.triangle  # a plane is met only once
        beyond = ray.medium
        if fresh:
            toggle(inside[i], hit.structure)
            beyond = view.tissue_of_owner[owner(inside[i])]
        step_mm = next_step(ray.step_mm, fresh and hit.distance_mm > ray.step_mm, view.step_mm)
        point = bounce.along(bounce.vector(ray.origin), bounce.vector(ray.direction), hit.distance_mm)
        length_mm = hit.distance_mm + ray.step_mm
        ray.path_mm += length_mm
        ray.displayed_mm += length_mm * medium.stretch
        ray.loss_db += length_mm * medium.loss_db_mm
        ray.structure, ray.triangle, ray.step_mm = hit.structure, hit.triangle, step_mm
        direction, weight = bounce.vector(ray.direction), ray.weight

        if media.differs[ray.medium, beyond]:
            if ray.interfaces < MAX_ROWS:
                drawn = table[ray.interfaces, ray.number]
            else:
                drawn = unstratified(view.path_seed, ray.interfaces, ray.number, beyond_table)
            surface = view.tissue_of_owner[hit.structure + 1]
            scattering = bounce.sample_scattering(direction, hit.normal, ray.medium, beyond, surface, drawn, media)
            thickness_mm = float(drawn[THICKNESS]) * media.thickness_mm[surface] if media.thick else 0.0

            element, axis = bounce.vector(view.elements[group]), bounce.vector(view.axes[group])
            link = bounce.connect(ray, point, medium, thickness_mm, element, axis)
            depth_mm = link.depth_mm + thickness_mm * medium.stretch
            if depth_mm < view.depth_mm:
                amplitude = bounce.echo(ray, scattering, link, media.specularity[surface])
                if amplitude > 0:
                    received_echo = echoes[received]
                    received_echo.group, received_echo.depth_mm = group, depth_mm
                    received_echo.amplitude, received_echo.reflected = amplitude, not direct
                    received += 1
            if link.depth_mm >= view.depth_mm:
                continue

            ray.interfaces += 1
            # That a ray is reflected which is not split: then it keeps its weight, else 1 + |R_p| times that goes on.
            probability = abs(scattering.pressure) if abs(scattering.pressure) >= bounce.SMALLEST_REFLECTION else 0.0
            if direct and probability > 0:  # the level is interpolated between nodes: keep it up to the surface
                energy = scattering.pressure * scattering.pressure
                accumulate(nodes, group, ray, medium, nodes.spacing_mm, weight * energy)
            pressure, choice, luck = scattering.pressure, drawn[CHOICE], drawn[SURVIVAL]
            faint_db = 0.0  # not read where a direct ray is transmitted alone
            if not direct or probability > 0:  # how much fainter than its weight: loss, direction, half the gain ahead
                # What the time gain adds up to the end of the image makes up for loss in tissue, not in fluid.
                ahead_db = view.gain_db_mm * max(view.depth_mm - link.depth_mm, 0.0)
                faint_db = link.two_way_db + ahead_db / 2 - 20 * math.log10(max(link.received, bounce.LEAST_RECEIVED))
            back_weight, weight = bounce.go_on(ray, pressure, probability, choice, luck, faint_db, view.roulette_db)
            if back_weight > 0:
                rays[reflected], inside[reflected] = ray, inside[i]
                toggle(inside[reflected], hit.structure)
                child, back = rays[reflected], scattering.reflected
                child.reflections += 1
                child.path_mm += 2 * thickness_mm  # there and back
                child.displayed_mm += 2 * thickness_mm * medium.stretch
                child.loss_db += 2 * thickness_mm * medium.loss_db_mm
                bounce.spawn(
                    child, bounce.along(point, back, step_mm), back, back_weight, view.depth_mm, medium.stretch
                )
                reflected += 1
            direction = scattering.transmitted
        if weight > 0:
            rays[transmitted], inside[transmitted] = ray, inside[i]
            child, stretch = rays[transmitted], float(media.stretch[beyond])
            child.medium = beyond
            bounce.spawn(child, bounce.along(point, direction, step_mm), direction, weight, view.depth_mm, stretch)
            transmitted += 1
    for i in range(n, reflected):
        rays[transmitted], inside[transmitted] = rays[i], inside[i]
        transmitted += 1
    return transmitted, received
