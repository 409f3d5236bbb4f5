"""A ray at a surface between two media: rough normal, Snell, Fresnel. Pure functions of arrays.

Directions and normals are (n, 3) unit vectors, normals point against the ray; the rest is (n,).
"""

from __future__ import annotations

import numpy as np


def dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Row-wise scalar product, (n,)."""
    return np.einsum("ij,ij->i", a, b)


def facing(normal: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Unit normals turned against the rays, (n, 3), from normals of any length and sign."""
    scale = -np.copysign(1 / np.maximum(np.sqrt(dot(normal, normal)), 1e-30), dot(normal, direction))
    return normal * scale[:, None].astype(normal.dtype)


def rough_normal(
    normal: np.ndarray, log_u: np.ndarray, cos_azimuth: np.ndarray, sin_azimuth: np.ndarray, exponent: np.ndarray
) -> np.ndarray:
    """A normal drawn from a power-cosine lobe about the surface's own (Mattausch and Goksel 2016).

    cos(phi) = u^(1 / (s + 1)), s the lobe's exponent, 1 / roughness.

    Parameters
    ----------
    normal : (n, 3) float
    log_u : (n,) float
        Logarithm of a uniform number.
    cos_azimuth, sin_azimuth : (n,) float
    exponent : (n,) float
        1 / (s + 1); 0 leaves the normal as it is.

    Returns
    -------
    (n, 3) float
    """
    squared = np.exp(2 * exponent * log_u)
    cos_tilt = np.sqrt(squared)
    sin_tilt = np.sqrt(np.maximum(1 - squared, 0))
    x, y, z = normal.T
    sign = np.copysign(np.ones_like(z), z)  # orthonormal frame without branches (Duff et al. 2017)
    a = -1 / (sign + z)
    b = x * y * a
    u, v = sin_tilt * cos_azimuth, sin_tilt * sin_azimuth
    return np.stack(
        [
            x * cos_tilt + u * (1 + sign * x * x * a) + v * b,
            y * cos_tilt + u * (sign * b) + v * (sign + y * y * a),
            z * cos_tilt - u * (sign * x) - v * y,
        ],
        axis=-1,
    )


def transmission_cosine(cos_i: np.ndarray, speed_1: np.ndarray, speed_2: np.ndarray) -> np.ndarray:
    """Cosine of the refracted angle by Snell's law, sin t / sin i = c2 / c1; 0 at total reflection, (n,)."""
    ratio = speed_2 / speed_1
    cos_t = np.sqrt(np.maximum(1 - ratio * ratio * (1 - cos_i * cos_i), 0))
    return np.where(speed_1 == speed_2, cos_i, cos_t)


def pressure_reflection(
    impedance_1: np.ndarray, impedance_2: np.ndarray, cos_i: np.ndarray, cos_t: np.ndarray
) -> np.ndarray:
    """R_p = (Z2 cos i - Z1 cos t) / (Z2 cos i + Z1 cos t), (n,); the energy reflected is R_p^2."""
    a, b = impedance_2 * cos_i, impedance_1 * cos_t
    return (a - b) / np.maximum(a + b, 1e-30)


def mirrored(direction: np.ndarray, normal: np.ndarray, cos_i: np.ndarray) -> np.ndarray:
    """Directions of reflection, d + 2 cos i n, (n, 3)."""
    return direction + (2 * cos_i)[:, None] * normal


def refracted(
    direction: np.ndarray, normal: np.ndarray, cos_i: np.ndarray, cos_t: np.ndarray, speed_ratio: np.ndarray
) -> np.ndarray:
    """Directions of transmission, eta d + (eta cos i - cos t) n with eta = c2 / c1, (n, 3).

    The tangential part, of length sin i, is stretched by eta to sin t: Snell's law for speeds.
    """
    return speed_ratio[:, None] * direction + (speed_ratio * cos_i - cos_t)[:, None] * normal
