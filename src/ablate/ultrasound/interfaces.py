"""A ray at a surface between two media: rough normal, Snell, Fresnel. Compiled functions of numbers.

Vectors are tuples of three; directions and normals are of unit length, and normals point against the ray.
"""

from __future__ import annotations

import math

from ablate.ultrasound.compiled import compiled

Vector = tuple[float, float, float]


@compiled
def dot(a: Vector, b: Vector) -> float:
    """Scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@compiled
def along(point: Vector, direction: Vector, length: float) -> Vector:
    """point + length direction."""
    return (
        point[0] + length * direction[0],
        point[1] + length * direction[1],
        point[2] + length * direction[2],
    )


@compiled
def facing(normal: Vector, direction: Vector) -> Vector:
    """The unit normal turned against a ray, from a normal of any length and sign."""
    scale = -math.copysign(1 / max(math.sqrt(dot(normal, normal)), 1e-30), dot(normal, direction))
    return scale * normal[0], scale * normal[1], scale * normal[2]


@compiled
def rough_normal(normal: Vector, log_u: float, cos_azimuth: float, sin_azimuth: float, exponent: float) -> Vector:
    """A normal drawn from a power-cosine lobe about the surface's own (Mattausch and Goksel 2016).

    cos(phi) = u^(1 / (s + 1)), s the lobe's exponent, 1 / roughness.

    Parameters
    ----------
    normal : (3,) tuple of float
    log_u : float
        Logarithm of a uniform number.
    cos_azimuth, sin_azimuth : float
    exponent : float
        1 / (s + 1); 0 leaves the normal as it is.

    Returns
    -------
    (3,) tuple of float
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
def mirrored(direction: Vector, normal: Vector, cos_i: float) -> Vector:
    """Direction of reflection, d + 2 cos i n."""
    return along(direction, normal, 2 * cos_i)


@compiled
def refracted(direction: Vector, normal: Vector, cos_i: float, cos_t: float, speed_ratio: float) -> Vector:
    """Direction of transmission, eta d + (eta cos i - cos t) n with eta = c2 / c1.

    The tangential part, of length sin i, is stretched by eta to sin t: Snell's law for speeds.
    """
    stretched = speed_ratio * direction[0], speed_ratio * direction[1], speed_ratio * direction[2]
    return along(stretched, normal, speed_ratio * cos_i - cos_t)
