"""How strongly each scanline of each layer is insonified at each depth, by the rays that were never reflected."""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional as F

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.imaging.point_spread import Across, lateral_kernels
from ablate.ultrasound.probe_kinds import Probe
from ablate.ultrasound.settings import SimulatorSettings
from ablate.ultrasound.stages import Stage, stage

#: Depths at which the rays' mean is taken; between them it is interpolated in dB.
NODES = 256
#: Level of no sound at all, dB: finite, so that interpolation makes no NaN, and zero as a float32 amplitude.
NO_SOUND_DB = -4000.0
_LOWEST_DB = -600.0  # all below counts as no sound: far under any display, and it spares the signal chain denormals
_BLOCKS = 64  # of depth, within which the beam's overlap is taken as constant
_NEPER_PER_TWO_WAY_DB = math.log(10) / 10


class Nodes(NamedTuple):
    """Depths at which the illumination is kept, and what has been accumulated there."""

    first_mm: float
    spacing_mm: float
    anechoic: np.ndarray  # (groups, nodes) bool: the background without scatterers, there or half a node beside
    amplitude: np.ndarray  # (groups, nodes) float64, sum over the rays of weight x 10^(-2 loss / 20)


class Segment(NamedTuple):
    """A piece of a ray's path within one medium: displayed depths, one-way loss where it begins, and its slope."""

    from_mm: float
    to_mm: float
    loss_db: float
    slope_db_mm: float
    anechoic: bool


def empty_nodes(anechoic: np.ndarray, depth_mm: float) -> Nodes:
    """Nodes from the first sample to the last, before any ray has come; from (groups, samples) bool."""
    groups, samples = anechoic.shape
    count = min(samples, NODES)
    first = depth_mm / samples / 2
    spacing = (depth_mm - 2 * first) / max(count - 1, 1) or 1.0
    nearest = np.rint(np.linspace(0, samples - 1, count)).astype(int)
    half = samples // (2 * count)
    around = [np.clip(nearest + shift, 0, samples - 1) for shift in (-half, 0, half)]
    return Nodes(first, spacing, np.any([anechoic[:, place] for place in around], axis=0), np.zeros((groups, count)))


@compiled
def accumulate(nodes: Nodes, group: int, segment: Segment, weight: float) -> None:
    """Add a ray of this weight at the nodes in [from_mm, to_mm) of its segment.

    Between nodes the amplitude falls by one factor, so a segment costs two exponentials, however long it is. A ray in
    the anechoic background does not insonify a scanline that is in the body: bone bends rays out of the body, and a
    ray that loses nothing outside would fill the shadow behind the bone.
    """
    amplitude = nodes.amplitude[group]
    count = len(amplitude)
    first = min(max(math.ceil((segment.from_mm - nodes.first_mm) / nodes.spacing_mm), 0), count)
    last = count
    if segment.to_mm < nodes.first_mm + count * nodes.spacing_mm:
        last = max(math.ceil((segment.to_mm - nodes.first_mm) / nodes.spacing_mm), 0)
    if first >= last:
        return
    at_first = segment.loss_db + segment.slope_db_mm * (nodes.first_mm + first * nodes.spacing_mm - segment.from_mm)
    level = weight * math.exp(-at_first * _NEPER_PER_TWO_WAY_DB)
    factor = math.exp(-segment.slope_db_mm * nodes.spacing_mm * _NEPER_PER_TWO_WAY_DB)
    for k in range(first, last):
        if not segment.anechoic or nodes.anechoic[group, k]:
            amplitude[k] += level
        level *= factor


def transmit_beam(probe: Probe, settings: SimulatorSettings) -> Across:
    """How the sound of neighbouring scanlines overlaps.

    The point spread function is that of both ways; one way of two equal Gaussians is wider by sqrt(2).
    """
    count = min(settings.axial_samples, NODES)
    part = -(-count // _BLOCKS)
    depth = (np.arange(-(-count // part)) + 0.5) * part * (probe.depth_mm / count)
    return Across(lateral_kernels(probe, settings, depth, widen=math.sqrt(2)), "cpu", torch.float64)


@stage(Stage.illumination)
def mean_level_db(nodes: Nodes, rays: np.ndarray, beam: Across) -> torch.Tensor:
    """Level in dB of the mean over rays and, as the beam overlaps, over scanlines, (groups, nodes) float32 tensor.

    `rays`, (groups,), is how many rays of each group were accumulated.
    """
    blocks, lines = beam.blocks, beam.lines
    groups, count = nodes.amplitude.shape
    part = -(-count // blocks)
    mean = F.pad(torch.from_numpy(nodes.amplitude / rays[:, None]), (0, blocks * part - count))
    by_block = mean.reshape(-1, lines, blocks, part).permute(2, 1, 0, 3).reshape(blocks, lines, -1)
    overlapping = beam(by_block).reshape(blocks, lines, -1, part).permute(2, 1, 0, 3)
    level = 20 * torch.log10(overlapping.reshape(groups, -1)[:, :count])
    return level.where(level > _LOWEST_DB, NO_SOUND_DB).float()
