"""Closed forms of the geometry of each kind of probe."""

import numpy as np
import pytest

from ablate.ultrasound import ConvexProbe, LinearProbe, PhasedProbe, Probe

CONVEX = ConvexProbe(radius_mm=30.0, fov_deg=60.0, depth_mm=100.0, frequency_mhz=3.0)
LINEAR = LinearProbe(width_mm=60.0, depth_mm=100.0, frequency_mhz=3.0)
PHASED = PhasedProbe(aperture_mm=20.0, fov_deg=80.0, depth_mm=100.0, frequency_mhz=3.0)
KINDS = pytest.mark.parametrize("probe", [CONVEX, LINEAR, PHASED], ids=["convex", "linear", "phased"])


def place(probe: Probe, across: np.ndarray, depth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and z, mm, of points of the fan; `across` is -1 on the first scanline and 1 on the last."""
    if isinstance(probe, LinearProbe):
        return probe.width_mm / 2 * across, depth + 0 * across
    radius = probe.radius_mm if isinstance(probe, ConvexProbe) else 0.0
    angle = np.radians(probe.fov_deg / 2) * across
    return (radius + depth) * np.sin(angle), (radius + depth) * np.cos(angle) - radius


def across_and_depth(probe: Probe, x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The inverse of `place`."""
    if isinstance(probe, LinearProbe):
        return x / (probe.width_mm / 2) + 0 * z, z + 0 * x
    radius = probe.radius_mm if isinstance(probe, ConvexProbe) else 0.0
    return np.degrees(np.arctan2(x, z + radius)) / (probe.fov_deg / 2), np.hypot(x, z + radius) - radius


def pixels(probe: Probe, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """x, (W,), and z, (H, 1), of the pixels' centres: the bounding box of the fan's border in equal parts."""
    sides = np.linspace(-1, 1, 2001)
    border = [np.concatenate(part) for part in zip(
        place(probe, sides, np.zeros(2001)), place(probe, sides, np.full(2001, probe.depth_mm)), strict=True
    )]  # fmt: skip
    (left, right), (top, bottom) = ((part.min(), part.max()) for part in border)
    rows, columns = (np.arange(n) + 0.5 for n in shape)
    return left + (right - left) * columns / shape[1], top + (bottom - top) * rows[:, None] / shape[0]
