"""Monte-Carlo transport: rays that meet surfaces, echo there, and go on, turn back, or both.

The weight of a ray is a two-way amplitude. Through an interface its expectation is 1 - R = t12 t21 with R = R_p^2,
exactly what a pulse keeps on its way there and back. A ray that was reflected is heard along the straight way back,
where that surface does not turn it again: off the interface the expectation is |R_p|, once.

Where a ray goes is drawn so that errors are small, with these expectations. One on its way there carries the image:
it always goes on, with 1 - R of its weight, and by chance sends another one back. One that was turned before does one
or the other. The chance q of a turn is at least its physical share R, and more where R_p is small (importance
sampling): the weight of the turned ray is multiplied by |R_p| / q, and with q = R that would be 1 / |R_p|. Such rays,
rare and heavy, would be seen as isolated dots in dark fluid.
"""

from __future__ import annotations

import math

import numpy as np

from ablate.ultrasound.bundle import Bundle
from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.draws import (
    CHOICE,
    COLUMNS,
    COS_AZIMUTH,
    LOG_U,
    MAX_ROWS,
    SIN_AZIMUTH,
    SURVIVAL,
    THICKNESS,
    Draws,
    unstratified,
)
from ablate.ultrasound.embree import Geometry, Hits
from ablate.ultrasound.illumination import Nodes, shine
from ablate.ultrasound.interfaces import (
    Vector,
    along,
    dot,
    facing,
    mirrored,
    pressure_reflection,
    refracted,
    rough_normal,
    transmission_cosine,
)
from ablate.ultrasound.media import Media
from ablate.ultrasound.ownership import next_step, owner, toggle
from ablate.ultrasound.rays import Echoes, Rays, View, start_rays, with_room
from ablate.ultrasound.threads import in_parts

#: From this many reflections on, half of the rays end at each further one and the others count twice, so that a thin
#: gap does not keep them to and fro until they are as deep as the image.
PATIENT_REFLECTIONS = 8

#: Chance of a turn over |R_p|, never under R: of a ray on its way there, and of one turned before. More of the former
#: costs more time than it takes off the error. At 1 a turn leaves the weight, and a passage multiplies it by 1 + |R_p|.
TURNED_FIRST, TURNED_AGAIN = 0.5, 1.0

#: Surfaces of a smaller R_p turn no ray back, they only take 1 - R of its weight. Left out, for speed: reverberation
#: that is 26 dB down before its second surface.
FAINT_REFLECTION = 0.05

#: From this weight on a surface shares a turned ray, |R_p| back and 1 - |R_p| on. Below, |R_p| + 1 - R is more than
#: came: amplitudes of paths are summed whose phases nobody knows, and in a stack of strong surfaces that sum would grow
#: by up to a quarter at each of them, without end.
LOUDEST = 16.0

#: A scanline listens along its axis: echoes of reflected rays fall off with the distance from it as a Gaussian of
#: this standard deviation (assumed); reverberation between layers that face the probe is hardly touched.
LISTENING_MM = 6.0

_GROUPS_OF_A_PART = 96
_NEPER_PER_DB = math.log(10) / 20


def trace(geometry: Geometry, view: View, draws: Draws, bundle: Bundle, nodes: Nodes) -> Echoes:
    """Follow all rays of a frame until they are deeper than the image.

    Parameters
    ----------
    geometry : Geometry
    view : View
    draws : Draws
    bundle : Bundle
    nodes : Nodes
        Collects the illumination.

    Returns
    -------
    Echoes
    """

    def part(begin: int, end: int) -> list[np.ndarray]:
        rays = start_rays(bundle, slice(begin, end), view)
        n = end - begin
        kept = []
        while n:
            rays = with_room(rays, 2 * n)
            hits = geometry.closest(rays.origin[:n], rays.direction[:n], rays.reach_mm[:n])
            room = np.empty(n, np.int32), np.empty(n, np.float32), np.empty(n, np.float32), np.empty(n, bool)
            table = draws.table(int(rays.interfaces[:n].max()) + 1)
            left, spare, heard = _bounce(rays, hits, view, table, nodes, room)
            for column in rays:
                column[left : left + spare - n] = column[n:spare]
            n = left + spare - n
            kept.append([column[:heard].copy() for column in room])
        return [np.concatenate(column) for column in zip(*kept, strict=True)]

    parts = in_parts(part, len(bundle.origins), _GROUPS_OF_A_PART * view.rays)
    return Echoes(*(np.concatenate(column) for column in zip(*parts, strict=True)))


@compiled
def _bounce(
    rays: Rays,
    hits: Hits,
    view: View,
    draws: np.ndarray,
    nodes: Nodes,
    echoes: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
) -> tuple[int, int, int]:
    """Take rays to the surfaces that they hit: echo there, go on, turn back, or both.

    Those that go on are moved up, to rows from 0; those turned back are put behind all rays. Returns the row after the
    last of each, and how many echoes were written.
    """
    media = view.media
    late = np.empty(COLUMNS, np.float32)
    left, spare, heard = 0, len(hits.structure), 0
    for i in range(len(hits.structure)):
        number, medium, direct = rays.number[i], rays.medium[i], rays.reflections[i] == 0
        group = number // view.rays
        loss_db_mm, stretch = float(media.loss_db_mm[medium]), float(media.stretch[medium])
        structure, triangle = hits.structure[i], hits.triangle[i]
        length = float(hits.distance_mm[i]) + rays.step_mm[i]
        shown_mm, loss_db = rays.shown_mm[i] + length * stretch, rays.loss_db[i] + length * loss_db_mm
        slope, silent = loss_db_mm / stretch, media.silent[medium]
        if direct:
            until = shown_mm if structure >= 0 else math.inf
            shine(nodes, group, rays.shown_mm[i], until, rays.weight[i], rays.loss_db[i], slope, silent)
        if structure < 0:
            continue
        path_mm, weight = rays.path_mm[i] + length, rays.weight[i]
        interfaces, reflections = rays.interfaces[i], rays.reflections[i]
        direction = _vector(rays.direction, i)
        point = along(_vector(rays.origin, i), direction, float(hits.distance_mm[i]))
        fresh = structure != rays.structure[i] or triangle != rays.triangle[i]  # a plane is met only once
        away = fresh and hits.distance_mm[i] > rays.step_mm[i]
        step_mm = next_step(rays.step_mm[i], away, view.step_mm)
        beyond = medium
        if fresh:
            toggle(rays.inside[i], structure)
            beyond = np.int32(view.tissue_of_owner[owner(rays.inside[i])])
        if media.differs[medium, beyond]:
            if interfaces < MAX_ROWS:
                drawn = draws[interfaces, number]
            else:
                drawn = unstratified(view.path_seed, interfaces, number, late)
            surface = view.tissue_of_owner[structure + 1]
            back, onward, pressure = _scatter(direction, _vector(hits.normal, i), medium, beyond, surface, drawn, media)
            thickness_mm = float(drawn[THICKNESS]) * media.thickness_mm[surface] if media.thick else 0.0

            element = _vector(view.elements, group)
            to_element = element[0] - point[0], element[1] - point[1], element[2] - point[2]
            way_back_mm = max(math.sqrt(dot(to_element, to_element)), 1e-6)
            # A reflected ray's way back to its element is not its way there; its loss is taken in proportion.
            ways = 2.0 if direct else 1 + way_back_mm / max(path_mm, 1e-6)
            middle_mm = shown_mm * ways / 2
            two_way_db = loss_db * ways + 2 * thickness_mm * loss_db_mm
            depth_mm = middle_mm + thickness_mm * stretch
            if depth_mm < view.depth_mm:
                lobe = max(dot(back, to_element) / way_back_mm, 0.0) ** media.specularity[surface]
                amplitude = weight * abs(pressure) * lobe
                amplitude *= math.exp(-two_way_db * _NEPER_PER_DB)
                if not direct:
                    on_axis = dot(to_element, _vector(view.axes, group))
                    amplitude *= math.exp(-0.5 * max(way_back_mm**2 - on_axis**2, 0.0) / LISTENING_MM**2)
                if amplitude > 0:
                    echoes[0][heard], echoes[1][heard], echoes[2][heard] = group, depth_mm, amplitude
                    echoes[3][heard] = not direct
                    heard += 1
            if middle_mm >= view.depth_mm:
                continue

            interfaces += 1
            energy, turn = pressure * pressure, _turn(abs(pressure), direct)
            turned = drawn[CHOICE] < turn
            if direct and turn > 0:  # the level is interpolated between nodes: keep it up to the surface
                shine(nodes, group, shown_mm, shown_mm + nodes.spacing_mm, weight * energy, loss_db, slope, silent)
            if turned:  # back, through the surface's thickness twice
                bright = weight * abs(pressure) / turn
                chance = _chance(bright, two_way_db, view.faintest_db, reflections >= PATIENT_REFLECTIONS)
                if drawn[SURVIVAL] < chance:
                    rays.inside[spare] = rays.inside[i]
                    toggle(rays.inside[spare], structure)
                    rays.weight[spare], rays.reflections[spare] = bright / chance, reflections + 1
                    rays.path_mm[spare] = path_mm + 2 * thickness_mm
                    rays.shown_mm[spare] = shown_mm + 2 * thickness_mm * stretch
                    rays.loss_db[spare] = loss_db + 2 * thickness_mm * loss_db_mm
                    _leave(rays, spare, number, medium, interfaces, structure, triangle, point, back, step_mm, view)
                    spare += 1
            direction = onward
            if direct:
                weight *= 1 - energy
            elif turned:
                weight = 0.0
            else:
                if turn == 0 or weight < LOUDEST:
                    weight *= (1 - energy) / (1 - turn)
                chance = _chance(weight, two_way_db, view.faintest_db, False)
                weight = weight / chance if drawn[SURVIVAL] < chance else 0.0
        if weight > 0:
            rays.inside[left] = rays.inside[i]
            rays.weight[left], rays.reflections[left] = weight, reflections
            rays.path_mm[left], rays.shown_mm[left], rays.loss_db[left] = path_mm, shown_mm, loss_db
            _leave(rays, left, number, beyond, interfaces, structure, triangle, point, direction, step_mm, view)
            left += 1
    return left, spare, heard


@compiled
def _leave(
    rays: Rays,
    row: int,
    number: int,
    medium: int,
    interfaces: int,
    structure: int,
    triangle: int,
    point: Vector,
    direction: Vector,
    step_mm: float,
    view: View,
) -> None:
    """Write a ray that leaves a surface; its set, weight, lengths and reflections must be in the row before."""
    rays.number[row], rays.medium[row], rays.interfaces[row] = number, medium, interfaces
    rays.structure[row], rays.triangle[row], rays.step_mm[row] = structure, triangle, step_mm
    start = along(point, direction, step_mm)
    for axis in range(3):
        rays.origin[row, axis], rays.direction[row, axis] = start[axis], direction[axis]
    ways = 1.0 if rays.reflections[row] == 0 else 2.0  # a turned ray goes down and up again
    rays.reach_mm[row] = (ways * view.depth_mm - rays.shown_mm[row]) / view.media.stretch[medium]


@compiled
def _vector(rows: np.ndarray, i: int) -> Vector:
    """A row as a tuple of doubles."""
    return float(rows[i, 0]), float(rows[i, 1]), float(rows[i, 2])


@compiled
def _scatter(
    direction: Vector, normal: Vector, before: int, after: int, surface: int, drawn: np.ndarray, media: Media
) -> tuple[Vector, Vector, float]:
    """Directions back and onward, and R_p, about a rough normal, or the surface's own where that one cannot be."""
    flat = facing(normal, direction)
    if media.rough:
        tilted = rough_normal(flat, drawn[LOG_U], drawn[COS_AZIMUTH], drawn[SIN_AZIMUTH], media.lobe_exponent[surface])
        back, onward, pressure, cos_i, total = _about(direction, tilted, before, after, media)
        if cos_i > 0 and dot(back, flat) > 0 and (total or dot(onward, flat) < 0):
            return back, onward, pressure
    back, onward, pressure, _, _ = _about(direction, flat, before, after, media)
    return back, onward, pressure


@compiled
def _about(
    direction: Vector, normal: Vector, before: int, after: int, media: Media
) -> tuple[Vector, Vector, float, float, bool]:
    """Mirror, Snell and Fresnel about a normal; also cos i, and whether the reflection is total."""
    cos_i = -dot(direction, normal)
    cos_t, onward = cos_i, direction
    if media.refracts:
        speed_1, speed_2 = float(media.speed_m_s[before]), float(media.speed_m_s[after])
        cos_t = transmission_cosine(cos_i, speed_1, speed_2)
        onward = refracted(direction, normal, cos_i, cos_t, speed_2 / speed_1)
        if cos_t == 0 and speed_1 != speed_2:  # total, along the surface too, where R_p is 0 / 0
            return mirrored(direction, normal, cos_i), onward, 1.0, cos_i, True
    impedance_1, impedance_2 = float(media.impedance_mrayl[before]), float(media.impedance_mrayl[after])
    pressure = pressure_reflection(impedance_1, impedance_2, cos_i, cos_t)
    return mirrored(direction, normal, cos_i), onward, pressure, cos_i, cos_t == 0


@compiled
def _turn(reflection: float, direct: bool) -> float:
    """Chance that a surface of so much |R_p| turns a ray, or makes it send one back where it is direct."""
    if reflection < FAINT_REFLECTION:
        return 0.0
    return max(reflection * reflection, (TURNED_FIRST if direct else TURNED_AGAIN) * reflection)


@compiled
def _chance(weight: float, two_way_db: float, faintest_db: float, often: bool) -> float:
    """Chance of a faint or often turned ray to go on; survivors' weights grow by its inverse, without bias."""
    level_db = 20 * math.log10(max(weight, 1e-30)) - two_way_db
    chance = min(1.0, 10 ** ((level_db - faintest_db) / 20))
    return min(chance, 0.5) if often else chance
