"""Monte-Carlo path tracing of rays: they meet surfaces, echo there, and are transmitted, reflected, or both.

All rays of a part advance by one surface at a time: intersect, interact, sample the scattering, connect to the element
(an echo), Russian roulette, spawn.

The weight of a ray, its throughput, is a two-way amplitude. Through an interface its expectation is
1 - R = t12 t21 with R = R_p^2, exactly what a pulse keeps on its way there and back. The echo of a ray that was
reflected before returns straight to its element, where the surface that reflected it does not reflect it again: the
expectation off that interface is |R_p|, once.

How a ray goes on is sampled so that errors are small, with these expectations. A direct ray, never reflected, carries
the image: a surface splits it into a transmitted one, with 1 - R of its weight, and a reflected one, with |R_p|. A ray
that was reflected once is split, too. So that rays do not multiply, one that was reflected more often is either
reflected, with the probability |R_p|, or transmitted. Were it reflected with the probability R, the few that are would
have the weight 1 / |R_p|, and would appear as isolated dots in dark fluid. Russian roulette ends faint reflected rays.
"""

import math
from typing import cast

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays, compiled
from ablate.ultrasound.media import Medium, RenderPlan
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import Asked, Geometry, asked_ray, at, closest_of
from ablate.ultrasound.surfaces.line_walk import highest, next_step
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport import bounce
from ablate.ultrasound.transport.lines import ECHO, Nodes, passed
from ablate.ultrasound.transport.rays import (
    CHOICE,
    COLUMNS,
    COS_AZIMUTH,
    LOG_U,
    MAX_ROWS,
    SIN_AZIMUTH,
    SURVIVAL,
    THICKNESS,
    Bundle,
    Draws,
    View,
    at_pose,
    probe_rays,
    start_rays,
    unstratified,
)

_GROUPS_OF_A_PART = 48

#: Russian roulette may end reflected rays under this level above white. One path is a small part of its line: of 16
#: rays in 3 layers, spread over its surroundings, an echo of this level is 61 dB under white.
_ROULETTE_DB = 24.0


class Tracer:
    """Traces the rays of frames of a geometry, for one probe and one set of settings."""

    def __init__(self, geometry: Geometry, plan: RenderPlan, probe: Probe, settings: SimulatorSettings) -> None:
        self._geometry, self._plan, self._settings, self._depth_mm = geometry, plan, settings, probe.depth_mm
        self._draws = Draws(settings.path_seed, settings.scanlines * settings.layers, settings.rays)
        self._rays = probe_rays(probe, settings, self._draws)
        depths_mm = sample_depths_mm(probe, settings.axial_samples)
        self._largest_gain_db = float(time_gain_db(depths_mm, probe, settings.time_gain).max())

    def at(self, pose: np.ndarray) -> Bundle:
        """The rays at a pose, which leads to the geometry's world."""
        return at_pose(self._geometry, self._rays, pose)

    def __call__(self, bundle: Bundle, nodes: Nodes) -> np.ndarray:
        """The echoes, (n,) ECHO, of rays at a pose; what insonifies the scanlines is added to `nodes`."""
        view = View(
            media=self._plan.media,
            tissue_of_owner=self._plan.tissue_of_owner,
            elements=bundle.starts,
            axes=bundle.directions,
            rays=self._settings.rays,
            path_seed=self._draws.seed,
            depth_mm=self._depth_mm,
            roulette_db=_ROULETTE_DB + 20 * math.log10(self._settings.reference_level) - self._largest_gain_db,
            gain_db_mm=self._largest_gain_db / self._depth_mm,
            step_mm=self._geometry.step_mm,
        )
        return trace(self._geometry, view, self._draws, bundle, nodes)


@stage(Stage.tracing)
def trace(geometry: Geometry, view: View, draws: Draws, bundle: Bundle, nodes: Nodes) -> np.ndarray:
    """The echoes, (n,) ECHO, of the rays of a frame until they are deeper than the image; `nodes` are accumulated."""
    ways = bundle.origins, bundle.ray_directions

    def part(begin: int, end: int) -> np.ndarray:
        chosen = slice(begin * view.rays, end * view.rays)
        rays, rows, count = start_rays(bundle, chosen, view), 0, 0
        n, arrays = len(rays), cast(Arrays, (rays, bundle.inside[chosen].copy(), np.empty(4 * len(rays), ECHO)))
        while n:  # comes back for more of the table of draws
            table, rows = draws.table(rows + 1)
            arrays, n, count = _bounces(geometry.address, arrays, n, count, view, ways, table, rows, nodes)
        return arrays[2][:count]

    return np.concatenate(in_parts(part, len(bundle.starts), _GROUPS_OF_A_PART))


@compiled
def _bounces(
    address: int,
    arrays: Arrays,
    n: int,
    received: int,
    view: View,
    ways: Arrays,
    table: np.ndarray,
    rows: int,
    nodes: Nodes,
) -> tuple[Arrays, int, int]:
    """Advance rays until none is left, or until one has met as many interfaces as the table has `rows`.

    The arrays are rays, the sets that they are inside of, and echoes. Returns them, which grow where they are too
    small, with the numbers of rays and of echoes. Ways are origins and directions at the probe, (rays, 3).
    """
    asked, (rays, inside, echoes) = asked_ray(), arrays
    while n > 0:
        if rows < MAX_ROWS:
            for i in range(n):
                if rays[i].interfaces >= rows:
                    return (rays, inside, echoes), n, received
        rays, inside, echoes = _grown(rays, 2 * n), _grown(inside, 2 * n), _grown(echoes, received + n)
        n, count = _advance(address, asked, (rays, inside, echoes[received:]), n, view, ways, table, nodes)
        received += count
    return (rays, inside, echoes), n, received


@compiled
def _grown(rows: np.ndarray, count: int) -> np.ndarray:
    """The same rows, with at least `count` of them and then twice as many; those added are not initialised."""
    if len(rows) >= count:
        return rows
    return np.concatenate((rows, np.empty((2 * count - len(rows), *rows.shape[1:]), rows.dtype)))


@compiled
def _advance(
    address: int, asked: Asked, arrays: Arrays, n: int, view: View, ways: Arrays, table: np.ndarray, nodes: Nodes
) -> tuple[int, int]:
    """Advance n rays to the surfaces that they hit: one bounce of the path tracer.

    Reflected rays are written behind all rays at first, because transmitted rays take the rows from 0. Returns how many
    rays there are then, and how many echoes were written.
    """
    (rays, inside, echoes), (origins, directions) = arrays, ways
    # arrays by name and element: no part of an array is made for a ray, see `bounce`
    speed, impedance, specular, thickness, loss, lobe, stretches, silent, differs, refracts, rough, thick = view.media
    elements, axes, tissue_of_owner, of_group = view.elements, view.axes, view.tissue_of_owner, view.rays
    at_mm, apart_mm, empty, amplitudes = nodes
    words, count = inside.shape[1], amplitudes.shape[1]
    drawn = np.empty(COLUMNS, np.float32)
    transmitted, reflected, received = 0, n, 0
    for i in range(n):
        ray = rays[i]
        origin = float(ray.origin[0]), float(ray.origin[1]), float(ray.origin[2])
        direction = float(ray.direction[0]), float(ray.direction[1]), float(ray.direction[2])
        hit = closest_of(address, asked, origin, direction, ray.reach_mm)
        group, direct, tissue, weight = ray.number // of_group, ray.reflections == 0, ray.medium, ray.weight
        medium = Medium(float(loss[tissue]), float(stretches[tissue]), silent[tissue])
        # Bone bends rays out of the body. Such a ray loses nothing in the anechoic background and would fill the shadow
        # behind the bone, so it insonifies no scanline there that is in the body.
        astray = direct and medium.anechoic
        if astray:
            to_mm = hit.distance_mm if hit.structure >= 0 else ray.reach_mm
            astray = bounce.strays(origin, direction, to_mm, at(origins, ray.number), at(directions, ray.number))
        if direct:  # up to the surface, or to the end of the image
            ahead_mm = (hit.distance_mm + ray.step_mm) * medium.stretch if hit.structure >= 0 else math.inf
            first, last, level, factor = passed(at_mm, apart_mm, count, ray, medium, ahead_mm, weight)
            for k in range(first, last):
                if not astray or empty[group, k]:
                    amplitudes[group, k] += level
                level *= factor
        if hit.structure < 0:
            continue
        fresh = hit.structure != ray.structure or hit.triangle != ray.triangle  # a plane is met only once
        beyond = tissue
        if fresh:
            inside[i, hit.structure >> 5] ^= np.uint32(1) << np.uint32(hit.structure & 31)
            owned_by = 0
            for word in range(words):
                if inside[i, word]:
                    owned_by = 32 * word + highest(inside[i, word])
            beyond = tissue_of_owner[owned_by]
        step_mm = next_step(ray.step_mm, fresh and hit.distance_mm > ray.step_mm, view.step_mm)
        point = bounce.along(origin, direction, hit.distance_mm)
        length_mm = hit.distance_mm + ray.step_mm
        ray.path_mm += length_mm
        ray.displayed_mm += length_mm * medium.stretch
        ray.loss_db += length_mm * medium.loss_db_mm
        ray.structure, ray.triangle, ray.step_mm = hit.structure, hit.triangle, step_mm

        if differs[tissue, beyond]:
            if ray.interfaces < MAX_ROWS:
                for column in range(COLUMNS):
                    drawn[column] = table[ray.interfaces, ray.number, column]
            else:
                unstratified(view.path_seed, ray.interfaces, ray.number, drawn)
            tilt = drawn[LOG_U], drawn[COS_AZIMUTH], drawn[SIN_AZIMUTH]
            surface = tissue_of_owner[hit.structure + 1]
            sides = float(speed[tissue]), float(speed[beyond]), float(impedance[tissue]), float(impedance[beyond])
            interface = bounce.Interface(sides[0], sides[1], sides[2], sides[3], refracts)
            scattering = bounce.sample_scattering(direction, hit.normal, interface, lobe[surface], tilt, rough)
            thickness_mm = float(drawn[THICKNESS]) * thickness[surface] if thick else 0.0

            if direct:  # off its own straight way
                aside_mm2 = bounce.aside(point, at(origins, ray.number), at(directions, ray.number))
            else:  # off its scanline
                aside_mm2 = bounce.aside(point, at(elements, group), at(axes, group))
            link = bounce.connect(ray, point, medium, thickness_mm, at(elements, group), aside_mm2)
            depth_mm = link.depth_mm + thickness_mm * medium.stretch
            if depth_mm < view.depth_mm:
                amplitude = bounce.echo(ray, scattering, link, specular[surface])
                if amplitude > 0:
                    received_echo = echoes[received]
                    received_echo.group, received_echo.depth_mm = group, depth_mm
                    received_echo.amplitude, received_echo.clutter = amplitude, not link.sharp
                    received += 1
            if link.depth_mm >= view.depth_mm:
                continue

            ray.interfaces += 1
            # That a ray is reflected which is not split: then it keeps its weight, else 1 + |R_p| times that goes on.
            probability = abs(scattering.pressure) if abs(scattering.pressure) >= bounce.SMALLEST_REFLECTION else 0.0
            if direct and probability > 0:  # the level is interpolated between nodes: keep it up to the surface
                energy = scattering.pressure * scattering.pressure
                first, last, level, factor = passed(at_mm, apart_mm, count, ray, medium, apart_mm, weight * energy)
                for k in range(first, last):
                    if not astray or empty[group, k]:
                        amplitudes[group, k] += level
                    level *= factor
            faint_db = 0.0  # not read where a direct ray is transmitted alone
            if not direct or probability > 0:  # how much fainter than its weight: loss, direction, half the gain ahead
                # What the time gain adds up to the end of the image makes up for loss in tissue, not in fluid.
                ahead_db = view.gain_db_mm * max(view.depth_mm - link.depth_mm, 0.0)
                faint_db = link.two_way_db + ahead_db / 2 + min(link.aside_db, bounce.MOST_ASIDE_DB)
            back_weight, weight = bounce.go_on(
                ray, scattering.pressure, probability, drawn[CHOICE], drawn[SURVIVAL], faint_db, view.roulette_db
            )
            if back_weight > 0:
                rays[reflected] = ray
                for word in range(words):
                    inside[reflected, word] = inside[i, word]
                inside[reflected, hit.structure >> 5] ^= np.uint32(1) << np.uint32(hit.structure & 31)
                child, back = rays[reflected], scattering.reflected
                child.reflections += 1
                child.path_mm += 2 * thickness_mm  # there and back
                child.displayed_mm += 2 * thickness_mm * medium.stretch
                child.loss_db += 2 * thickness_mm * medium.loss_db_mm
                leaves_mm = bounce.leaves(point, back, at(elements, group), at(axes, group))
                start = bounce.along(point, back, step_mm)
                bounce.spawn(child, start, back, back_weight, view.depth_mm, medium.stretch, leaves_mm)
                reflected += 1
            direction = scattering.transmitted
        if weight > 0:
            rays[transmitted] = ray
            for word in range(words):
                inside[transmitted, word] = inside[i, word]
            child, stretch = rays[transmitted], float(stretches[beyond])
            child.medium = beyond
            leaves_mm = math.inf if direct else bounce.leaves(point, direction, at(elements, group), at(axes, group))
            start = bounce.along(point, direction, step_mm)
            bounce.spawn(child, start, direction, weight, view.depth_mm, stretch, leaves_mm)
            transmitted += 1
    for i in range(n, reflected):
        rays[transmitted] = rays[i]
        for word in range(words):
            inside[transmitted, word] = inside[i, word]
        transmitted += 1
    return transmitted, received
