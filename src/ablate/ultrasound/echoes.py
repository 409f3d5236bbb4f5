"""From what the rays brought back to lines of complex signal."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch.nn import functional as F

from ablate.ultrasound.rays import Echoes

#: Echoes of reflected rays are few and out of focus: they are spread over these standard deviations.
_CLUTTER_LINES = 2.5
_CLUTTER_MM = 1.0
_CLUTTER_CELLS_PER_SIGMA = 2.0


def splat(line: np.ndarray, position: np.ndarray, amplitude: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Add amplitudes to the two samples on either side of their positions.

    Parameters
    ----------
    line : (n,) int
    position : (n,) float
        In samples; what lies beyond the outer samples' centres goes to them.
    amplitude : (n,) float
    shape : (scanlines, samples)

    Returns
    -------
    (scanlines, samples) float64
    """
    lines, samples = shape
    position = np.clip(position.astype(np.float64), 0, samples - 1)
    low = np.minimum(position.astype(np.int64), max(samples - 2, 0))
    part = (position - low) * amplitude
    start = line.astype(np.int64) * samples + low
    total = np.bincount(start, amplitude - part, minlength=lines * samples)
    if samples > 1:
        total += np.bincount(start + 1, part, minlength=lines * samples)
    return total.reshape(shape)


def surface_lines(
    echoes: Echoes, weights: np.ndarray, rays: int, depth_mm: float, shape: tuple[int, int]
) -> np.ndarray:
    """Amplitude that surfaces send back, mean over rays, sum over layers; real, so that its estimate converges.

    Parameters
    ----------
    echoes : Echoes
    weights : (layers, samples) float
        Elevational weights, summing to 1 over layers.
    rays : int
        Of each scanline and layer.
    depth_mm : float
    shape : (scanlines, samples)

    Returns
    -------
    (scanlines, samples) float64
    """
    lines, samples = shape
    layer, line = np.divmod(echoes.group, lines)
    spacing = depth_mm / samples
    position = echoes.depth_mm / spacing - 0.5
    nearest = np.clip(position, 0, samples - 1).astype(np.int64)
    amplitude = echoes.amplitude * weights[layer, nearest] / rays
    direct = ~echoes.reflected
    total = splat(line[direct], position[direct], amplitude[direct], shape)
    if direct.all():
        return total
    far = echoes.reflected
    return total + _clutter(line[far], echoes.depth_mm[far], amplitude[far], depth_mm, shape)


def _clutter(
    line: np.ndarray, depth: np.ndarray, amplitude: np.ndarray, depth_mm: float, shape: tuple[int, int]
) -> np.ndarray:
    """Echoes of reflected rays, spread along and across the lines; their sum is kept."""
    lines, samples = shape
    cells = max(1, min(samples, math.ceil(depth_mm / _CLUTTER_MM * _CLUTTER_CELLS_PER_SIGMA)))
    coarse = splat(line, depth / depth_mm * cells - 0.5, amplitude, (lines, cells))
    spread = torch.from_numpy(
        _spreading(lines, _CLUTTER_LINES) @ coarse @ _spreading(cells, _CLUTTER_CELLS_PER_SIGMA).T
    )
    fine = F.interpolate(spread[None], size=samples, mode="linear", align_corners=False)[0]
    return fine.numpy() * (cells / samples)


def _spreading(n: int, sigma: float) -> np.ndarray:
    """A Gaussian smoothing matrix whose columns sum to 1, so that nothing is lost at the ends, (n, n)."""
    apart = np.arange(n)[:, None] - np.arange(n)
    matrix = np.exp(-0.5 * (apart / sigma) ** 2)
    matrix[np.abs(apart) > 4 * sigma] = 0
    return matrix / matrix.sum(axis=0)
