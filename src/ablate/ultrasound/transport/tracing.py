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
from typing import Any

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays, Vector, compiled, step
from ablate.ultrasound.media import Medium, RenderPlan
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import Asked, Geometry, asked_ray, at
from ablate.ultrasound.surfaces.line_walk import owner, toggle
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport import bounce
from ablate.ultrasound.transport.lines import ECHO, Nodes, passed
from ablate.ultrasound.transport.rays import (
    MAX_ROWS,
    Bundle,
    Drawn,
    Draws,
    Ray,
    View,
    at_pose,
    probe_rays,
    start_rays,
    tabulated,
    unstratified,
)
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

Echo = Any  # a row of an array of ECHO, as compiled code takes it

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
            origins=bundle.origins,
            ways=bundle.ray_directions,
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
    """Trace the rays of a frame until they are deeper than the image.

    Parameters
    ----------
    geometry : Geometry
        The triangles.
    view : View
        What the rays travel through, and what receives their echoes.
    draws : Draws
        Random numbers of all rays.
    bundle : Bundle
        The rays at a pose.
    nodes : Nodes
        What insonifies the scanlines; the rays' amplitudes are added to it.

    Returns
    -------
    (n,) ECHO
        The echoes, part by part.
    """

    def part(begin: int, end: int) -> np.ndarray:
        chosen = slice(begin * view.rays, end * view.rays)
        rays = start_rays(bundle, chosen, view)
        arrays: Arrays = (rays, bundle.inside[chosen].copy(), np.empty(4 * len(rays), ECHO))
        n, rows, count = len(rays), 0, 0
        while n:  # comes back for more of the table of draws
            table, rows = draws.table(rows + 1)
            arrays, n, count = _bounces(geometry.address, arrays, n, count, view, table, rows, nodes)
        return arrays[2][:count]

    return np.concatenate(in_parts(part, len(bundle.starts), _GROUPS_OF_A_PART))


@compiled
def _bounces(
    address: int, arrays: Arrays, n: int, received: int, view: View, table: np.ndarray, rows: int, nodes: Nodes
) -> tuple[Arrays, int, int]:
    """Advance rays until none is left, or until one has met as many interfaces as the table has `rows`.

    The arrays are rays, the sets that they are inside of, and echoes. Returns them, which grow where they are too
    small, with the numbers of rays and of echoes.
    """
    rays, inside, echoes = arrays
    embree = address, asked_ray()
    while n > 0:
        if rows < MAX_ROWS:
            for i in range(n):
                if rays[i].interfaces >= rows:
                    return (rays, inside, echoes), n, received
        rays, inside, echoes = _grown(rays, 2 * n), _grown(inside, 2 * n), _grown(echoes, received + n)
        n, count = _advance(embree, rays, inside, echoes[received:], n, view, table, nodes)
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
    embree: tuple[int, Asked],
    rays: np.ndarray,
    inside: np.ndarray,
    echoes: np.ndarray,
    n: int,
    view: View,
    table: np.ndarray,
    nodes: Nodes,
) -> tuple[int, int]:
    """Advance n rays to the surfaces that they hit: one bounce of the path tracer.

    Reflected rays are written behind all rays at first, because transmitted rays take the rows from 0. Returns how many
    rays there are then, and how many echoes were written.
    """
    transmitted, reflected, received = 0, n, 0
    for i in range(n):
        ray = rays[i]
        hit = look_ahead(embree, ray)
        medium = medium_of(view.media, ray.medium)
        astray = False
        if ray.reflections == 0:
            astray = medium.anechoic and goes_astray(ray, hit, at(view.origins, ray.number), at(view.ways, ray.number))
            _insonify(nodes, view, ray, medium, length_ahead(ray, hit) * medium.stretch, ray.weight, astray)
        if hit.structure < 0:
            continue
        point = bounce.along(origin_of(ray), direction_of(ray), hit.distance_mm)
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
            scattering = bounce.sample_scattering(
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
    scattering: bounce.Scattering,
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
def _share(
    ray: Ray, scattering: bounce.Scattering, link: bounce.Connection, view: View, drawn: Drawn
) -> tuple[float, float]:
    """Weights of what a surface sends back and of what it lets through, after Russian roulette."""
    faint_db = 0.0  # not read where a direct ray is transmitted alone
    if ray.reflections > 0 or bounce.reflects(scattering.pressure):
        # How much fainter than its weight: loss, direction, half the gain ahead. What the time gain adds up to the end
        # of the image makes up for loss in tissue, not in fluid.
        ahead_db = view.gain_db_mm * max(view.depth_mm - link.depth_mm, 0.0)
        faint_db = link.two_way_db + ahead_db / 2 + min(link.aside_db, bounce.MOST_ASIDE_DB)
    return bounce.go_on(ray, scattering.pressure, drawn.choice, drawn.survival, faint_db, view.roulette_db)


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
    """Let a ray leave a surface; one that was reflected ends where it leaves the cylinder about its scanline."""
    leaves_mm = math.inf
    if ray.reflections > 0:
        group = ray.number // view.rays
        leaves_mm = bounce.leaves(point, direction, at(view.elements, group), at(view.axes, group))
    start = bounce.along(point, direction, step_mm)
    bounce.spawn(ray, start, direction, weight, view.depth_mm, stretch, leaves_mm)
