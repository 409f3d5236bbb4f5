"""How strongly each scanline of each layer is insonified at each depth, by the rays that were never reflected."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ablate.ultrasound.compiled import compiled

#: Depths at which the rays' mean is taken; between them it is interpolated in dB.
NODES = 256
#: Levels below this are silence, dB: far under any display, and no product of it with a kernel's tail is denormal.
SILENCE_DB = -400.0
_NEPER_PER_TWO_WAY_DB = math.log(10) / 10


class Nodes(NamedTuple):
    """Depths at which the illumination is kept, and what has been collected there.

    Attributes
    ----------
    first_mm, spacing_mm : float
    silent : (groups, nodes) bool
        Whether the scanline itself has no scatterers there.
    amplitude : (groups, nodes) float64
        Sum over the rays of weight x 10^(-2 loss / 20).
    """

    first_mm: float
    spacing_mm: float
    silent: np.ndarray
    amplitude: np.ndarray


def dark(silent: np.ndarray, depth_mm: float) -> Nodes:
    """Nodes from the first sample to the last, before any ray has come.

    Parameters
    ----------
    silent : (groups, samples) bool
    depth_mm : float
    """
    groups, samples = silent.shape
    count = min(samples, NODES)
    first = depth_mm / samples / 2
    spacing = (depth_mm - 2 * first) / max(count - 1, 1) or 1.0
    nearest = np.rint(np.linspace(0, samples - 1, count)).astype(int)
    return Nodes(first, spacing, silent[:, nearest], np.zeros((groups, count)))


@compiled
def shine(
    nodes: Nodes, group: int, from_mm: float, to_mm: float, loss_db: float, slope_db_mm: float, silent: bool
) -> None:
    """Add one ray of weight 1 at the nodes in [from_mm, to_mm): its one-way loss is loss_db at first, then rises.

    Between nodes the amplitude falls by one factor, so a piece costs two powers, however long it is. A ray that is
    where no scatterers are lights those of its scanline not: bone bends rays out of the body, and one that came back
    in no time would outshine the shadow.
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
        if not silent or nodes.silent[group, k]:
            amplitude[k] += level
        level *= factor


def mean_level_db(nodes: Nodes, rays: int) -> np.ndarray:
    """Level of the mean over the rays of each group, (groups, nodes) float32, dB, at least `SILENCE_DB`."""
    mean = nodes.amplitude / rays
    return (20 * np.log10(np.maximum(mean, 10 ** (SILENCE_DB / 20)))).astype(np.float32)
