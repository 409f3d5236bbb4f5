"""The rest of one bounce, for one ray that a surface scatters: echo, roulette, and where it ends.

Vectors are tuples of three; directions and normals are of unit length, and normals point against the ray. Compiled
functions that branch take numbers, not arrays: Numba counts references to every array that a function with branches
gets, and to every part of an array, which takes longer than tracing the ray.
"""

import math
from typing import NamedTuple

from ablate.ultrasound.compiled import Vector, compiled
from ablate.ultrasound.media import Medium
from ablate.ultrasound.transport.rays import Drawn, Ray
from ablate.ultrasound.transport.scattering import Scattering, along, dot

#: From this many reflections on, Russian roulette ends half of the rays at each further one and doubles the weight of
#: the others, so that a thin gap does not reflect rays to and fro until they are as deep as the image.
ROULETTE_REFLECTIONS = 8

#: Of the rays that surfaces reflect for the first time, this part is followed, with a larger weight: reverberation is
#: spread over many scanlines, each of which has its own rays. From 32 rays of a group on it is half of this part, see
#: `reverberation_share`.
REVERBERATION_SHARE = 0.5
_FEW_RAYS = 16

#: Up to this many reflections a surface splits a ray into a reflected and a transmitted one, so that both keep the
#: weights of their paths. From then on it sends one of the two, at random, so that rays do not multiply.
SPLIT_REFLECTIONS = 1

#: Surfaces of a smaller |R_p| reflect no ray, they only take 1 - R of its weight. Left out, for speed: reverberation
#: that is 26 dB down before its second surface.
SMALLEST_REFLECTION = 0.05

#: A surface sends on |R_p| of a reflected ray's weight and 1 - R, up to 5/4 of what came: amplitudes of paths of
#: unknown phase are summed. Once a ray's family has grown so much, surfaces share its weight, |R_p| and 1 - |R_p|, else
#: the sum would grow without end in a stack of strong surfaces. It stays under 5/4 of this.
SHARED_FROM_GROWTH = 6.4

#: An element receives along its scanline: echoes of reflected rays fall off with the distance from that axis as a
#: Gaussian of this standard deviation (assumed); reverberation between layers that face the probe is hardly changed.
RECEIVE_SIGMA_MM = 6.0

#: A reflected ray ends where it leaves the cylinder of this radius about its scanline: echoes from there are received
#: with 70 dB less, and those of what comes back from there after one more reflection are weak and late.
FARTHEST_MM = 4 * RECEIVE_SIGMA_MM

#: Sound that surfaces bend farther than this off its straight way has left its beam. It reached the place through a
#: part of the aperture, at its own time, so its echo adds with a random phase, and falls off as a Gaussian of this
#: standard deviation (assumed).
IN_BEAM_MM = 3.0

#: Russian roulette takes a ray off its axis to be fainter by at most this, because it may come back to the axis.
MOST_ASIDE_DB = 20.0

_NEPER_PER_DB = math.log(10) / 20
_ASIDE_DB = 0.5 / RECEIVE_SIGMA_MM**2 / _NEPER_PER_DB  # a square millimetre
_BENT_DB = 0.5 / IN_BEAM_MM**2 / _NEPER_PER_DB


class Connection(NamedTuple):
    """The straight way back from a surface to the ray's element: displayed depth, and loss there and back.

    `aside_db` is how much less the element receives from its direction, 0 for a direct ray.
    """

    to_element: Vector
    distance_mm: float
    depth_mm: float
    two_way_db: float
    aside_db: float
    sharp: bool


@compiled
def connect(
    ray: Ray, point: Vector, medium: Medium, thickness_mm: float, element: Vector, aside_mm2: float
) -> Connection:
    """Connect a surface to the ray's element.

    A reflected ray's way back to its element is not its way there; its loss is taken in proportion.

    Parameters
    ----------
    ray : Ray
        At the surface.
    point : tuple of three float
        Where it met the surface, mm.
    medium : Medium
        What it came through.
    thickness_mm : float
        How far behind the surface the echo arises.
    element : tuple of three float
        Where it is received, mm.
    aside_mm2 : float
        Squared distance of the point from the beam.
    """
    to_element = element[0] - point[0], element[1] - point[1], element[2] - point[2]
    distance_mm = max(math.sqrt(dot(to_element, to_element)), 1e-6)
    direct = ray.reflections == 0
    ways = 2.0 if direct else 1 + distance_mm / max(ray.path_mm, 1e-6)
    two_way_db = ray.loss_db * ways + 2 * thickness_mm * medium.loss_db_mm
    sharp = direct and aside_mm2 < IN_BEAM_MM**2
    aside_db = 0.0 if sharp else aside_mm2 * (_BENT_DB if direct else _ASIDE_DB)
    return Connection(to_element, distance_mm, ray.displayed_mm * ways / 2, two_way_db, aside_db, sharp)


@compiled
def aside(point: Vector, start: Vector, direction: Vector) -> float:
    """Squared distance of a point from a straight line, mm^2."""
    way = point[0] - start[0], point[1] - start[1], point[2] - start[2]
    off = along(way, direction, -dot(way, direction))
    return dot(off, off)


@compiled
def echo(ray: Ray, scattering: Scattering, link: Connection, specularity: float) -> float:
    """Amplitude that the element receives: weight |R_p| cos^n, less the loss of both ways.

    Parameters
    ----------
    ray : Ray
        At the surface.
    scattering : Scattering
        What the surface does.
    link : Connection
        The way back.
    specularity : float
        n; with 0 the direction does not matter.
    """
    towards, nepers = dot(scattering.reflected, link.to_element), (link.two_way_db + link.aside_db) * _NEPER_PER_DB
    if specularity > 0:
        if towards <= 0:
            return 0.0
        nepers -= specularity * math.log(towards / link.distance_mm)
    return ray.weight * abs(scattering.pressure) * math.exp(-nepers)


@compiled
def reflects(pressure: float) -> bool:
    """Whether a surface of this R_p sends a ray back at all."""
    return abs(pressure) >= SMALLEST_REFLECTION


def reverberation_share(rays: int) -> float:
    """The part of the rays reflected for the first time that is followed, of so many `rays` of a group.

    Half of it from 32 rays on: as many paths are then left as of 16 rays, and with H the error of an image, which is
    that of direct rays, stays.
    """
    return REVERBERATION_SHARE / min(max(rays / _FEW_RAYS, 1.0), 2.0)


@compiled
def go_on(
    ray: Ray, pressure: float, drawn: Drawn, faint_db: float, roulette_db: float, followed: float
) -> tuple[float, float]:
    """Weights of the reflected and of the transmitted ray, 0 where there is none; the ray's growth is updated.

    Parameters
    ----------
    ray : Ray
        At the surface.
    pressure : float
        R_p.
    drawn : Drawn
        Its uniform numbers: which of the two a ray becomes that is not split, and whether it survives.
    faint_db : float
        How much fainter than its weight the ray's next echo is expected to be.
    roulette_db : float
        Level under which Russian roulette may end it, dB.
    followed : float
        Part of the rays reflected for the first time that goes on.
    """
    choice, luck = drawn.choice, drawn.survival
    reflection, through = abs(pressure), 1 - pressure * pressure
    # That a ray is reflected which is not split: then it keeps its weight, else 1 + |R_p| times that goes on.
    probability = reflection if reflects(pressure) else 0.0
    if ray.reflections > 0 and probability > 0:
        if ray.growth >= SHARED_FROM_GROWTH:
            through = 1 - reflection
        ray.growth *= reflection + through
    back, onward = ray.weight * reflection, ray.weight * through
    if ray.reflections <= SPLIT_REFLECTIONS:
        at_most = followed if ray.reflections == 0 else 1.0
        back = _surviving(back, choice, faint_db, roulette_db, at_most) if probability > 0 else 0.0
        if ray.reflections > 0:
            onward = _surviving(onward, luck, faint_db, roulette_db, 1.0)
        return back, onward
    if choice < probability:
        share = 0.5 if ray.reflections >= ROULETTE_REFLECTIONS else 1.0
        return _surviving(back / probability, luck, faint_db, roulette_db, share), 0.0
    return 0.0, _surviving(onward / (1 - probability), luck, faint_db, roulette_db, 1.0)


@compiled
def _surviving(weight: float, luck: float, faint_db: float, roulette_db: float, at_most: float) -> float:
    """Weight after Russian roulette: it grows by the inverse of the probability to survive, without bias, or is 0."""
    survival = min(weight * math.exp(-(roulette_db + faint_db) * _NEPER_PER_DB), at_most)
    return weight / survival if luck < survival else 0.0


@compiled
def leaves(point: Vector, direction: Vector, element: Vector, axis: Vector) -> float:
    """How far a ray goes until it leaves the cylinder of `FARTHEST_MM` about its scanline, mm.

    Parameters
    ----------
    point, direction : tuple of three float
        Of the ray: mm, and a unit vector.
    element, axis : tuple of three float
        Of the scanline: mm, and a unit vector.
    """
    from_element = point[0] - element[0], point[1] - element[1], point[2] - element[2]
    outside, ahead = along(from_element, axis, -dot(from_element, axis)), along(direction, axis, -dot(direction, axis))
    a, b, c = max(dot(ahead, ahead), 1e-12), dot(outside, ahead), dot(outside, outside) - FARTHEST_MM**2
    return (math.sqrt(b * b - a * c) - b) / a if c < 0 else 0.0
