"""The steps of one bounce, for one ray: interact with a surface, connect to the element, roulette, spawn.

Compiled functions that branch take numbers, and those that take many arrays do not branch: Numba counts references to
every array that a function with branches gets, which takes longer than tracing the ray.
"""

import math
from typing import NamedTuple

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.media import Media
from ablate.ultrasound.surfaces.embree import Hits
from ablate.ultrasound.transport.interfaces import Scattering, Vector, along, dot, vector
from ablate.ultrasound.transport.lines import Segment
from ablate.ultrasound.transport.rays import Ray

#: From this many reflections on, Russian roulette ends half of the rays at each further one and doubles the weight of
#: the others, so that a thin gap does not reflect rays to and fro until they are as deep as the image.
ROULETTE_REFLECTIONS = 8

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

#: Russian roulette takes a ray off its axis to be received by at least this, because it may come back to the axis.
_LEAST_RECEIVED = 0.1

_NEPER_PER_DB = math.log(10) / 20


class Hit(NamedTuple):
    """A row of `Hits`, in numbers."""

    distance_mm: float
    structure: int
    triangle: int
    normal: Vector


class Medium(NamedTuple):
    """A row of `Media`, in numbers: what a ray that travels in it needs."""

    loss_db_mm: float
    stretch: float
    anechoic: bool


class Connection(NamedTuple):
    """The straight way back from a surface to the ray's element: displayed depth, and loss there and back.

    `received` is what the element's direction leaves of it, 1 for a direct ray.
    """

    to_element: Vector
    distance_mm: float
    depth_mm: float
    two_way_db: float
    received: float


@compiled
def hit_at(hits: Hits, i: int) -> Hit:
    """A row of the hits."""
    return Hit(float(hits.distance_mm[i]), hits.structure[i], hits.triangle[i], vector(hits.normal[i]))


@compiled
def medium_at(media: Media, i: int) -> Medium:
    """A row of the media."""
    return Medium(float(media.loss_db_mm[i]), float(media.stretch[i]), media.anechoic[i])


@compiled
def segment_ahead(ray: Ray, medium: Medium, length_mm: float) -> Segment:
    """From the last surface that a ray met on, over a displayed length."""
    to_mm = ray.displayed_mm + length_mm
    return Segment(ray.displayed_mm, to_mm, ray.loss_db, medium.loss_db_mm / medium.stretch, medium.anechoic)


@compiled
def move_to_surface(ray: Ray, hit: Hit, medium: Medium) -> Vector:
    """Move a ray to the surface that it hit, and return the point in double precision."""
    length = hit.distance_mm + ray.step_mm
    ray.path_mm += length
    ray.displayed_mm += length * medium.stretch
    ray.loss_db += length * medium.loss_db_mm
    ray.structure, ray.triangle = hit.structure, hit.triangle
    return along(vector(ray.origin), vector(ray.direction), hit.distance_mm)


@compiled
def connect(ray: Ray, point: Vector, medium: Medium, thickness_mm: float, element: Vector, axis: Vector) -> Connection:
    """Connect a surface to the ray's element.

    A reflected ray's way back to its element is not its way there; its loss is taken in proportion.
    """
    to_element = element[0] - point[0], element[1] - point[1], element[2] - point[2]
    distance_mm = max(math.sqrt(dot(to_element, to_element)), 1e-6)
    ways = 2.0 if ray.reflections == 0 else 1 + distance_mm / max(ray.path_mm, 1e-6)
    two_way_db = ray.loss_db * ways + 2 * thickness_mm * medium.loss_db_mm
    received = 1.0
    if ray.reflections > 0:
        on_axis = dot(to_element, axis)
        received = math.exp(-0.5 * max(distance_mm**2 - on_axis**2, 0.0) / RECEIVE_SIGMA_MM**2)
    return Connection(to_element, distance_mm, ray.displayed_mm * ways / 2, two_way_db, received)


@compiled
def echo(ray: Ray, scattering: Scattering, link: Connection, specularity: float) -> float:
    """Amplitude that the element receives: weight |R_p| cos^n, less the loss of both ways."""
    towards = dot(scattering.reflected, link.to_element) / link.distance_mm
    if towards <= 0 and specularity > 0:  # 0 below, too, which takes a power and an exponential
        return 0.0
    lobe = max(towards, 0.0) ** specularity
    amplitude = ray.weight * abs(scattering.pressure) * lobe
    return amplitude * link.received * math.exp(-link.two_way_db * _NEPER_PER_DB)


@compiled
def faintness_db(link: Connection, gain_db_mm: float, depth_mm: float) -> float:
    """How much fainter than its weight a ray is here, for Russian roulette: loss, direction, and half the gain ahead.

    What the time gain adds up to the end of the image makes up for loss in tissue, and in fluid it does not.
    """
    ahead_db = gain_db_mm * max(depth_mm - link.depth_mm, 0.0)
    return link.two_way_db + ahead_db / 2 - 20 * math.log10(max(link.received, _LEAST_RECEIVED))


@compiled
def go_on(
    ray: Ray, pressure: float, probability: float, choice: float, luck: float, faint_db: float, roulette_db: float
) -> tuple[float, float]:
    """Weights of the reflected and of the transmitted ray, 0 where there is none; choice and luck are random."""
    reflection, through = abs(pressure), 1 - pressure * pressure
    if ray.reflections > 0 and probability > 0:
        if ray.growth >= SHARED_FROM_GROWTH:
            through = 1 - reflection
        ray.growth *= reflection + through
    back, onward = ray.weight * reflection, ray.weight * through
    if ray.reflections <= SPLIT_REFLECTIONS:
        back = _surviving(back, choice, faint_db, roulette_db, False) if probability > 0 else 0.0
        if ray.reflections > 0:
            onward = _surviving(onward, luck, faint_db, roulette_db, False)
        return back, onward
    if choice < probability:
        return _surviving(back / probability, luck, faint_db, roulette_db, ray.reflections >= ROULETTE_REFLECTIONS), 0.0
    return 0.0, _surviving(onward / (1 - probability), luck, faint_db, roulette_db, False)


@compiled
def _surviving(weight: float, luck: float, faint_db: float, roulette_db: float, often_reflected: bool) -> float:
    """Weight after Russian roulette: it grows by the inverse of the probability to survive, without bias, or is 0."""
    level_db = 20 * math.log10(max(weight, 1e-30)) - faint_db
    if level_db >= roulette_db and not often_reflected:  # survives for certain: spares the power below
        return weight
    survival = min(0.5 if often_reflected else 1.0, 10 ** ((level_db - roulette_db) / 20))
    return weight / survival if luck < survival else 0.0


@compiled
def cross_thickness(ray: Ray, medium: Medium, thickness_mm: float) -> None:
    """Let a reflected ray cross the thickness of its surface, there and back."""
    ray.path_mm += 2 * thickness_mm
    ray.displayed_mm += 2 * thickness_mm * medium.stretch
    ray.loss_db += 2 * thickness_mm * medium.loss_db_mm


@compiled
def spawn(ray: Ray, origin: Vector, direction: Vector, weight: float, depth_mm: float, stretch: float) -> None:
    """Send a ray off from its surface, until it is deeper than the image; a reflected ray goes down and up again."""
    for axis in range(3):
        ray.origin[axis], ray.direction[axis] = origin[axis], direction[axis]
    ways = 1.0 if ray.reflections == 0 else 2.0
    ray.weight, ray.reach_mm = weight, (ways * depth_mm - ray.displayed_mm) / stretch
