"""From the echoes of rays to lines of amplitude."""

import math
from functools import cache

import numpy as np
import torch
from torch.nn import functional as F

from ablate.ultrasound.stages import Stage, stage

#: Echoes of reflected rays are few and out of focus: they are spread over these standard deviations.
_CLUTTER_LINES = 12.0
_CLUTTER_MM = 2.0
_CLUTTER_CELLS_PER_SIGMA = 2.0
#: Lines are dealt to so many sets, and the power of these echoes is estimated from products of different sets.
_CLUTTER_SETS = 4


#: An echo received from a surface.
ECHO = np.dtype(
    [
        ("group", np.int32),  # scanline and layer
        ("depth_mm", np.float32),  # as displayed
        ("amplitude", np.float32),  # of one ray: to be divided by the rays of a group
        ("reflected", np.bool_),  # whether the ray had been reflected before
    ]
)


def splat(line: np.ndarray, position: np.ndarray, amplitude: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Add amplitudes, (n,), of some lines, (n,), to the two samples on either side of their positions, (n,).

    Positions are in samples; what lies beyond the outer samples' centres goes to them. The sum is `shape`, (scanlines,
    samples) float64.
    """
    lines, samples = shape
    position = np.clip(position.astype(np.float64), 0, samples - 1)
    below = np.minimum(position.astype(np.int64), max(samples - 2, 0))
    part = (position - below) * amplitude
    start = line.astype(np.int64) * samples + below
    total = np.bincount(start, amplitude - part, minlength=lines * samples)
    if samples > 1:
        total += np.bincount(start + 1, part, minlength=lines * samples)
    return total.reshape(shape)


@stage(Stage.surface_echoes)
def surface_lines(
    echoes: np.ndarray, weights: np.ndarray, rays: np.ndarray, depth_mm: float, shape: tuple[int, int]
) -> np.ndarray:
    """Amplitude that surfaces send back to rays never reflected before, (scanlines, samples) float64.

    It is the mean over the `rays` of each group, (groups,), and the sum over layers of the echoes, (n,) ECHO, with
    elevational weights, (layers, samples), that sum to 1 over layers. It is real and positive, so its estimate
    converges with the number of rays.
    """
    return splat(*_placed(echoes, ~echoes["reflected"], weights, rays, depth_mm, shape), shape)


@stage(Stage.clutter)
def clutter_lines(
    echoes: np.ndarray, weights: np.ndarray, rays: np.ndarray, depth_mm: float, shape: tuple[int, int]
) -> np.ndarray | None:
    """The same for reflected rays: few and out of focus, they are spread along and across the lines.

    The sum is kept; None where there are no such echoes. The power of the sum is estimated without bias, from products
    x_i x_j of different lines' shares i != j in it (a U-statistic; Hoeffding 1948). The square of the sum would hold
    x_i^2 as well, whose mean is too large by the variance: bright bands of one heavy path in dark fluid.
    """
    if not echoes["reflected"].any():
        return None
    lines, samples = shape
    line, position, amplitude = _placed(echoes, echoes["reflected"], weights, rays, depth_mm, shape)
    cells = max(1, min(samples, math.ceil(depth_mm / _CLUTTER_MM * _CLUTTER_CELLS_PER_SIGMA)))
    coarse = torch.from_numpy(splat(line, (position + 0.5) * (cells / samples) - 0.5, amplitude, (lines, cells)))
    across, along = _spreading(lines, _CLUTTER_LINES), _spreading(cells, _CLUTTER_CELLS_PER_SIGMA)
    dealt = torch.arange(lines) % _CLUTTER_SETS == torch.arange(min(_CLUTTER_SETS, lines))[:, None]
    by_set = across * dealt[:, None, :]
    spread = by_set @ (coarse @ along.T)
    share = by_set.sum(dim=-1) / across.sum(dim=-1)
    if len(spread) == 1:
        total = spread[0]
    else:
        of_pairs = spread.sum(dim=0).square() - spread.square().sum(dim=0)
        total = (of_pairs.clamp(min=0) / (1 - share.square().sum(dim=0))[:, None]).sqrt()
    fine = F.interpolate(total[None], size=samples, mode="linear", align_corners=False)
    return fine[0].numpy() * (cells / samples)


def _placed(
    echoes: np.ndarray,
    chosen: np.ndarray,
    weights: np.ndarray,
    rays: np.ndarray,
    depth_mm: float,
    shape: tuple[int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Line, position in samples, and amplitude with its elevational weight, of some echoes."""
    lines, samples = shape
    layer, line = np.divmod(echoes["group"][chosen], lines)
    position = echoes["depth_mm"][chosen] * (samples / depth_mm) - 0.5
    nearest = np.clip(position, 0, samples - 1).astype(np.int64)
    return line, position, echoes["amplitude"][chosen] * weights[layer, nearest] / rays[echoes["group"][chosen]]


@cache
def _spreading(n: int, sigma: float) -> torch.Tensor:
    """A Gaussian smoothing matrix whose columns sum to 1, so that nothing is lost at the ends, (n, n)."""
    apart = np.minimum(np.abs(np.arange(n)[:, None] - np.arange(n)) / sigma, 5.0)
    matrix = np.where(apart < 4, np.exp(-0.5 * apart**2), 0.0)
    return torch.from_numpy(matrix / matrix.sum(axis=0))
