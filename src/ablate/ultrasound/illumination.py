"""How strongly each scanline of each layer is insonified at each depth, by the rays that were never reflected."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional as F

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.point_spread import Across, lateral_kernels
from ablate.ultrasound.settings import ConvexProbe, SimulatorSettings

#: Depths at which the rays' mean is taken; between them it is interpolated in dB.
NODES = 256
#: Level of no sound at all, dB: finite, so that interpolation makes no NaN, and zero as a float32 amplitude.
SILENCE_DB = -4000.0
_INAUDIBLE_DB = -600.0  # and all below is silence: far under any display, and spares the signal chain denormals
_BLOCKS = 64  # of depth, within which the beam's overlap is taken as constant
_NEPER_PER_TWO_WAY_DB = math.log(10) / 10


class Nodes(NamedTuple):
    """Depths at which the illumination is kept, and what has been collected there.

    Attributes
    ----------
    first_mm, spacing_mm : float
    silent : (groups, nodes) bool
        Whether the scanline itself is in a background without scatterers there or half a node beside.
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
    half = samples // (2 * count)
    around = [np.clip(nearest + shift, 0, samples - 1) for shift in (-half, 0, half)]
    return Nodes(first, spacing, np.any([silent[:, place] for place in around], axis=0), np.zeros((groups, count)))


@compiled
def shine(
    nodes: Nodes,
    group: int,
    from_mm: float,
    to_mm: float,
    weight: float,
    loss_db: float,
    slope_db_mm: float,
    silent: bool,
) -> None:
    """Add one ray at the nodes in [from_mm, to_mm): its one-way loss is loss_db at first, then rises.

    Between nodes the amplitude falls by one factor, so a piece costs two powers, however long it is. A ray in the
    silent background does not light a scanline that is in the body: bone bends rays out of it, and one that loses
    nothing there would outshine the shadow.
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
    level = weight * math.exp(-at_first * _NEPER_PER_TWO_WAY_DB)
    factor = math.exp(-slope_db_mm * nodes.spacing_mm * _NEPER_PER_TWO_WAY_DB)
    for k in range(first, last):
        if not silent or nodes.silent[group, k]:
            amplitude[k] += level
        level *= factor


def transmit_beam(probe: ConvexProbe, settings: SimulatorSettings) -> Across:
    """How the sound of neighbouring scanlines overlaps.

    The point spread function is that of both ways; one way of two equal Gaussians is wider by sqrt(2).
    """
    count = min(settings.axial_samples, NODES)
    part = -(-count // _BLOCKS)
    depth = (np.arange(-(-count // part)) + 0.5) * part * (probe.depth_mm / count)
    return Across(lateral_kernels(probe, settings, depth, widen=math.sqrt(2)), "cpu", torch.float64)


def mean_level_db(nodes: Nodes, rays: int, beam: Across) -> torch.Tensor:
    """Level of the mean over rays and, as the beam overlaps, over scanlines.

    Parameters
    ----------
    nodes : Nodes
        Groups layer by layer.
    rays : int
        Of each group.
    beam : Across
        From `transmit_beam`.

    Returns
    -------
    (groups, nodes) float32 tensor, dB
    """
    blocks, lines = beam.blocks, beam.lines
    groups, count = nodes.amplitude.shape
    part = -(-count // blocks)
    mean = F.pad(torch.from_numpy(nodes.amplitude / rays), (0, blocks * part - count))
    by_block = mean.reshape(-1, lines, blocks, part).permute(2, 1, 0, 3).reshape(blocks, lines, -1)
    overlapping = beam(by_block).reshape(blocks, lines, -1, part).permute(2, 1, 0, 3)
    level = 20 * torch.log10(overlapping.reshape(groups, -1)[:, :count])
    return level.where(level > _INAUDIBLE_DB, SILENCE_DB).float()
