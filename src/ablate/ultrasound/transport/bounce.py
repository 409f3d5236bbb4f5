"""The steps of one bounce, for one ray: interact with a surface, connect to the element, roulette, spawn.

Compiled functions that branch take numbers, and those that take many arrays do not branch: Numba counts references to
every array that a function with branches gets, which takes longer than tracing the ray.
"""

import math
from typing import NamedTuple

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.media import Media
from ablate.ultrasound.surfaces.embree import Hits
from ablate.ultrasound.transport.illumination import Segment
from ablate.ultrasound.transport.interfaces import Scattering, Vector, along, dot, vector
from ablate.ultrasound.transport.rays import Ray

#: From this many reflections on, Russian roulette ends half of the rays at each further one and doubles the weight of
#: the others, so that a thin gap does not reflect rays to and fro until they are as deep as the image.
ROULETTE_REFLECTIONS = 8

#: Probability of a reflection over |R_p|, never under R: of a direct ray, and of one reflected before. More of the
#: former costs more time than it takes off the error. At 1 a reflection keeps the weight, and a transmission
#: multiplies it by 1 + |R_p|.
DIRECT_PROBABILITY, INDIRECT_PROBABILITY = 0.5, 1.0

#: Surfaces of a smaller |R_p| reflect no ray, they only take 1 - R of its weight. Left out, for speed: reverberation
#: that is 26 dB down before its second surface.
SMALLEST_REFLECTION = 0.05

#: From this weight on a surface shares an indirect ray, |R_p| reflected and 1 - |R_p| transmitted. Below, |R_p| + 1 - R
#: is more than came: amplitudes of paths of unknown phase are summed, and in a stack of strong surfaces that sum would
#: grow by up to a quarter at each of them, without end.
SHARED_FROM_WEIGHT = 16.0

#: An element receives along its scanline: echoes of reflected rays fall off with the distance from that axis as a
#: Gaussian of this standard deviation (assumed); reverberation between layers that face the probe is hardly changed.
RECEIVE_SIGMA_MM = 6.0

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
    """The straight way back from a surface to the ray's element: displayed depth, and loss there and back."""

    to_element: Vector
    distance_mm: float
    depth_mm: float
    two_way_db: float


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
def connect(ray: Ray, point: Vector, medium: Medium, thickness_mm: float, element: Vector) -> Connection:
    """Connect a surface to the ray's element.

    A reflected ray's way back to its element is not its way there; its loss is taken in proportion.
    """
    to_element = element[0] - point[0], element[1] - point[1], element[2] - point[2]
    distance_mm = max(math.sqrt(dot(to_element, to_element)), 1e-6)
    ways = 2.0 if ray.reflections == 0 else 1 + distance_mm / max(ray.path_mm, 1e-6)
    two_way_db = ray.loss_db * ways + 2 * thickness_mm * medium.loss_db_mm
    return Connection(to_element, distance_mm, ray.displayed_mm * ways / 2, two_way_db)


@compiled
def echo(ray: Ray, scattering: Scattering, link: Connection, specularity: float, axis: Vector) -> float:
    """Amplitude that the element receives: weight |R_p| cos^n, less the loss of both ways."""
    lobe = max(dot(scattering.reflected, link.to_element) / link.distance_mm, 0.0) ** specularity
    amplitude = ray.weight * abs(scattering.pressure) * lobe
    amplitude *= math.exp(-link.two_way_db * _NEPER_PER_DB)
    if ray.reflections > 0:
        on_axis = dot(link.to_element, axis)
        amplitude *= math.exp(-0.5 * max(link.distance_mm**2 - on_axis**2, 0.0) / RECEIVE_SIGMA_MM**2)
    return amplitude


@compiled
def roulette(
    ray: Ray, pressure: float, probability: float, choice: float, luck: float, two_way_db: float, roulette_db: float
) -> tuple[float, float]:
    """Weights of the reflected and of the transmitted ray, 0 where there is none; choice and luck are random."""
    energy, reflects = pressure * pressure, choice < probability
    back, onward = 0.0, 0.0
    if reflects:
        weight = ray.weight * abs(pressure) / probability
        survival = _survival(weight, two_way_db, roulette_db, ray.reflections >= ROULETTE_REFLECTIONS)
        back = weight / survival if luck < survival else 0.0
    if ray.reflections == 0:
        onward = ray.weight * (1 - energy)
    elif not reflects:
        weight = ray.weight
        if probability == 0 or weight < SHARED_FROM_WEIGHT:
            weight *= (1 - energy) / (1 - probability)
        survival = _survival(weight, two_way_db, roulette_db, False)
        onward = weight / survival if luck < survival else 0.0
    return back, onward


@compiled
def reflection_probability(reflection: float, direct: bool) -> float:
    """Probability that a surface of this |R_p| reflects a ray, or makes a direct one spawn a reflected ray."""
    if reflection < SMALLEST_REFLECTION:
        return 0.0
    return max(reflection * reflection, (DIRECT_PROBABILITY if direct else INDIRECT_PROBABILITY) * reflection)


@compiled
def _survival(weight: float, two_way_db: float, roulette_db: float, often_reflected: bool) -> float:
    """Probability that a ray survives Russian roulette; survivors' weights grow by its inverse, without bias."""
    level_db = 20 * math.log10(max(weight, 1e-30)) - two_way_db
    survival = min(1.0, 10 ** ((level_db - roulette_db) / 20))
    return min(survival, 0.5) if often_reflected else survival


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
