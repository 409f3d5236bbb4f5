"""The steps of one bounce, for one ray: scatter at a surface (rough normal, Snell, Fresnel), echo, roulette, spawn.

Vectors are tuples of three; directions and normals are of unit length, and normals point against the ray. Compiled
functions that branch take numbers, not arrays: Numba counts references to every array that a function with branches
gets, and to every part of an array, which takes longer than tracing the ray.
"""

import math
from typing import NamedTuple

from ablate.ultrasound.compiled import Vector, compiled
from ablate.ultrasound.media import Medium
from ablate.ultrasound.transport.rays import Ray

#: From this many reflections on, Russian roulette ends half of the rays at each further one and doubles the weight of
#: the others, so that a thin gap does not reflect rays to and fro until they are as deep as the image.
ROULETTE_REFLECTIONS = 8

#: Of the rays that surfaces reflect for the first time, this part is followed, with a larger weight: reverberation is
#: spread over many scanlines, each of which has its own rays.
REVERBERATION_SHARE = 0.5

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


class Scattering(NamedTuple):
    """Directions of the reflected and of the transmitted ray, and the pressure reflection coefficient R_p."""

    reflected: Vector
    transmitted: Vector
    pressure: float


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def along(point: Vector, direction: Vector, length: float) -> Vector:
    """point + length direction."""
    return point[0] + length * direction[0], point[1] + length * direction[1], point[2] + length * direction[2]


@compiled
def facing(normal: Vector, direction: Vector) -> Vector:
    """The unit normal that points against a ray, from a normal of any length and sign."""
    scale = -math.copysign(1 / max(math.sqrt(dot(normal, normal)), 1e-30), dot(normal, direction))
    return scale * normal[0], scale * normal[1], scale * normal[2]


@compiled
def rough_normal(normal: Vector, log_u: float, cos_azimuth: float, sin_azimuth: float, exponent: float) -> Vector:
    """A normal drawn from a power-cosine lobe about the surface's own (Mattausch and Goksel 2016).

    cos(phi) = u^(1 / (s + 1)), s the lobe's exponent, 1 / roughness. `log_u` is the logarithm of a uniform number;
    `exponent` is 1 / (s + 1), and 0 leaves the normal as it is.
    """
    squared = math.exp(2 * exponent * log_u)
    cos_tilt = math.sqrt(squared)
    sin_tilt = math.sqrt(max(1 - squared, 0.0))
    x, y, z = normal
    sign = math.copysign(1.0, z)  # orthonormal frame without branches (Duff et al. 2017)
    a = -1 / (sign + z)
    b = x * y * a
    u, v = sin_tilt * cos_azimuth, sin_tilt * sin_azimuth
    return (
        x * cos_tilt + u * (1 + sign * x * x * a) + v * b,
        y * cos_tilt + u * (sign * b) + v * (sign + y * y * a),
        z * cos_tilt - u * (sign * x) - v * y,
    )


@compiled
def transmission_cosine(cos_i: float, speed_1: float, speed_2: float) -> float:
    """Cosine of the refracted angle by Snell's law, sin t / sin i = c2 / c1; 0 at total reflection."""
    if speed_1 == speed_2:
        return cos_i
    ratio = speed_2 / speed_1
    return math.sqrt(max(1 - ratio * ratio * (1 - cos_i * cos_i), 0.0))


@compiled
def pressure_reflection(impedance_1: float, impedance_2: float, cos_i: float, cos_t: float) -> float:
    """R_p = (Z2 cos i - Z1 cos t) / (Z2 cos i + Z1 cos t); the energy reflected is R_p^2."""
    a, b = impedance_2 * cos_i, impedance_1 * cos_t
    return (a - b) / max(a + b, 1e-30)


@compiled
def refracted(direction: Vector, normal: Vector, cos_i: float, cos_t: float, speed_ratio: float) -> Vector:
    """Direction of transmission, eta d + (eta cos i - cos t) n with eta = c2 / c1.

    The tangential part, of length sin i, is stretched by eta to sin t: Snell's law for speeds.
    """
    stretched = speed_ratio * direction[0], speed_ratio * direction[1], speed_ratio * direction[2]
    return along(stretched, normal, speed_ratio * cos_i - cos_t)


class Interface(NamedTuple):
    """The tissues on both sides of a surface, and whether the scene needs refraction."""

    speed_1: float
    speed_2: float
    impedance_1: float
    impedance_2: float
    refracts: bool


@compiled
def sample_scattering(
    direction: Vector, normal: Vector, interface: Interface, exponent: float, drawn: Vector, rough: bool
) -> Scattering:
    """Scatter about a rough normal; about the surface's own where a direction would be on the wrong side of it.

    `normal` may have any length and sign. `exponent` is that of the surface's lobe; `drawn` holds the random numbers of
    this interface and ray: log of a uniform, cosine and sine of the azimuth.
    """
    flat = facing(normal, direction)
    if rough:
        tilted = rough_normal(flat, drawn[0], drawn[1], drawn[2], exponent)
        scattering, cos_i, total = scatter_about(direction, tilted, interface)
        if cos_i > 0 and dot(scattering.reflected, flat) > 0 and (total or dot(scattering.transmitted, flat) < 0):
            return scattering
    return scatter_about(direction, flat, interface)[0]


@compiled
def scatter_about(direction: Vector, normal: Vector, interface: Interface) -> tuple[Scattering, float, bool]:
    """Mirror, Snell and Fresnel about a normal; also cos i, and whether the reflection is total."""
    speed_1, speed_2, impedance_1, impedance_2, refracts = interface
    cos_i = -dot(direction, normal)
    cos_t, transmitted, mirrored = cos_i, direction, along(direction, normal, 2 * cos_i)
    if refracts:
        cos_t = transmission_cosine(cos_i, speed_1, speed_2)
        transmitted = refracted(direction, normal, cos_i, cos_t, speed_2 / speed_1)
        if cos_t == 0 and speed_1 != speed_2:  # total, along the surface too, where R_p is 0 / 0
            return Scattering(mirrored, transmitted, 1.0), cos_i, True
    pressure = pressure_reflection(impedance_1, impedance_2, cos_i, cos_t)
    return Scattering(mirrored, transmitted, pressure), cos_i, cos_t == 0


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
    """Connect a surface to the ray's element; the surface is `aside_mm2` off the beam, squared.

    A reflected ray's way back to its element is not its way there; its loss is taken in proportion.
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
def strays(origin: Vector, direction: Vector, length_mm: float, start: Vector, straight: Vector) -> bool:
    """Whether a ray is `IN_BEAM_MM` off its straight way somewhere on this length: it is farthest at an end."""
    off_mm2 = aside(origin, start, straight), aside(along(origin, direction, length_mm), start, straight)
    return max(off_mm2[0], off_mm2[1]) > IN_BEAM_MM**2


@compiled
def echo(ray: Ray, scattering: Scattering, link: Connection, specularity: float) -> float:
    """Amplitude that the element receives: weight |R_p| cos^n, less the loss of both ways."""
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


@compiled
def go_on(
    ray: Ray, pressure: float, choice: float, luck: float, faint_db: float, roulette_db: float
) -> tuple[float, float]:
    """Weights of the reflected and of the transmitted ray, 0 where there is none; choice and luck are random."""
    reflection, through = abs(pressure), 1 - pressure * pressure
    # That a ray is reflected which is not split: then it keeps its weight, else 1 + |R_p| times that goes on.
    probability = reflection if reflects(pressure) else 0.0
    if ray.reflections > 0 and probability > 0:
        if ray.growth >= SHARED_FROM_GROWTH:
            through = 1 - reflection
        ray.growth *= reflection + through
    back, onward = ray.weight * reflection, ray.weight * through
    if ray.reflections <= SPLIT_REFLECTIONS:
        followed = REVERBERATION_SHARE if ray.reflections == 0 else 1.0
        back = _surviving(back, choice, faint_db, roulette_db, followed) if probability > 0 else 0.0
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
    """How far a ray goes until it leaves the cylinder of `FARTHEST_MM` about its scanline, mm."""
    from_element = point[0] - element[0], point[1] - element[1], point[2] - element[2]
    outside, ahead = along(from_element, axis, -dot(from_element, axis)), along(direction, axis, -dot(direction, axis))
    a, b, c = max(dot(ahead, ahead), 1e-12), dot(outside, ahead), dot(outside, outside) - FARTHEST_MM**2
    return (math.sqrt(b * b - a * c) - b) / a if c < 0 else 0.0


@compiled
def spawn(
    ray: Ray, origin: Vector, direction: Vector, weight: float, depth_mm: float, stretch: float, leaves_mm: float
) -> None:
    """Send a ray off from its surface, until it is deeper than the image; a reflected ray goes down and up again."""
    ray.origin[0], ray.origin[1], ray.origin[2] = origin
    ray.direction[0], ray.direction[1], ray.direction[2] = direction
    ways = 1.0 if ray.reflections == 0 else 2.0
    ray.weight, ray.reach_mm = weight, min((ways * depth_mm - ray.displayed_mm) / stretch, leaves_mm)
