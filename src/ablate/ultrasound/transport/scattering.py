"""What a surface does to a ray: its rough normal, Snell's law and Fresnel's coefficient.

Vectors are tuples of three; directions and normals are of unit length, and normals point against the ray.
"""

import math
from typing import NamedTuple

from ablate.ultrasound.compiled import Vector, compiled


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

    cos(phi) = u^(1 / (s + 1)), s the lobe's exponent, 1 / roughness.

    Parameters
    ----------
    normal : tuple of three float
        The surface's own, of unit length.
    log_u : float
        Logarithm of a uniform number.
    cos_azimuth, sin_azimuth : float
        Of a uniform angle about the surface's own normal.
    exponent : float
        1 / (s + 1); 0 leaves the normal as it is.
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
    """R_p = (Z2 cos i - Z1 cos t) / (Z2 cos i + Z1 cos t); the energy reflected is R_p^2.

    Parameters
    ----------
    impedance_1, impedance_2 : float
        Before and behind the surface, MRayl.
    cos_i, cos_t : float
        Of the angles to the normal before and behind it.
    """
    a, b = impedance_2 * cos_i, impedance_1 * cos_t
    return (a - b) / max(a + b, 1e-30)


@compiled
def refracted(direction: Vector, normal: Vector, cos_i: float, cos_t: float, speed_ratio: float) -> Vector:
    """Direction of transmission, eta d + (eta cos i - cos t) n with eta = c2 / c1.

    The tangential part, of length sin i, is stretched by eta to sin t: Snell's law for speeds.

    Parameters
    ----------
    direction, normal : tuple of three float
        d and n, unit vectors; n points against the ray.
    cos_i, cos_t : float
        Of the angles to the normal before and behind the surface.
    speed_ratio : float
        eta.
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

    Parameters
    ----------
    direction : tuple of three float
        Of the ray, of unit length.
    normal : tuple of three float
        The surface's own, of any length and sign.
    interface : Interface
        The tissues on both sides.
    exponent : float
        That of the surface's lobe, see `rough_normal`.
    drawn : tuple of three float
        Random numbers of this interface and ray: logarithm of a uniform one, cosine and sine of the azimuth.
    rough : bool
        Whether the scene has rough surfaces at all.
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
