"""How strongly each scanline of each layer is insonified at each depth, by the rays that were never reflected."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ablate.ultrasound.compiled import compiled

#: Depths at which the rays' mean is taken; between them it is interpolated in dB.
NODES = 256
#: Levels below this are silence, dB: far under any display, far above the smallest double.
SILENCE_DB = -600.0
_NEPER_PER_TWO_WAY_DB = math.log(10) / 10


class Nodes(NamedTuple):
    """Depths at which the illumination is kept, and what has been collected there.

    Attributes
    ----------
    first_mm, spacing_mm : float
    amplitude : (groups, nodes) float64
        Sum over the rays of weight x 10^(-2 loss / 20).
    """

    first_mm: float
    spacing_mm: float
    amplitude: np.ndarray


def dark(groups: int, depth_mm: float, samples: int) -> Nodes:
    """Nodes from the first sample to the last, before any ray has come."""
    count = min(samples, NODES)
    first = depth_mm / samples / 2
    return Nodes(first, (depth_mm - 2 * first) / max(count - 1, 1) or 1.0, np.zeros((groups, count)))


@compiled
def shine(nodes: Nodes, group: int, from_mm: float, to_mm: float, loss_db: float, slope_db_mm: float) -> None:
    """Add one ray of weight 1 at the nodes in [from_mm, to_mm): its one-way loss is loss_db at first, then rises.

    Between nodes the amplitude falls by one factor, so a piece costs two powers, however long it is.
    """
    amplitude = nodes.amplitude[group]
    count = len(amplitude)
    first = min(max(math.ceil((from_mm - nodes.first_mm) / nodes.spacing_mm), 0), count)
    last = count
    if to_mm < nodes.first_mm + count * nodes.spacing_mm:
        last = max(math.ceil((to_mm - nodes.first_mm) / nodes.spacing_mm), 0)
    if first >= last:
        return
    at_first = loss_db + slope_db_mm * (nodes.first_mm + first * nodes.spacing_mm - from_mm)
    level = math.exp(-at_first * _NEPER_PER_TWO_WAY_DB)
    factor = math.exp(-slope_db_mm * nodes.spacing_mm * _NEPER_PER_TWO_WAY_DB)
    for k in range(first, last):
        amplitude[k] += level
        level *= factor


def mean_level_db(nodes: Nodes, rays: int) -> np.ndarray:
    """Level of the mean over the rays of each group, (groups, nodes) float32, dB, at least `SILENCE_DB`."""
    mean = nodes.amplitude / rays
    return (20 * np.log10(np.maximum(mean, 10 ** (SILENCE_DB / 20)))).astype(np.float32)
