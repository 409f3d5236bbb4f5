"""How strongly each scanline of each layer is insonified at each depth, by the rays that were never reflected."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.settings import ConvexProbe, SimulatorSettings

#: Depths at which the rays' mean is taken; between them it is interpolated in dB.
NODES = 256
#: Levels below this are silence, dB: far under any display, far above the smallest double.
SILENCE_DB = -600.0
#: How fast a ray that was refracted away from its scanline ceases to light it (assumed): much less than the way to
#: places of another loss, more than layers of soft tissue shift a beam.
STRAY_MM = 3.0
_NEPER_PER_TWO_WAY_DB = math.log(10) / 10


class Nodes(NamedTuple):
    """Depths at which the illumination is kept, and what has been collected there.

    Attributes
    ----------
    first_mm, spacing_mm : float
    beam_mm : float
        How far from its scanline a ray may be that was not refracted.
    amplitude : (groups, nodes) float64
        Sum over the rays of weight x 10^(-2 loss / 20).
    """

    first_mm: float
    spacing_mm: float
    beam_mm: float
    amplitude: np.ndarray


class Piece(NamedTuple):
    """How a ray goes on from some place, in a straight line through one tissue.

    Attributes
    ----------
    from_mm, loss_db : float
        Displayed depth and one-way loss where it begins.
    slope_db_mm : float
        Loss per displayed mm.
    stretch : float
        Displayed length over geometric length.
    aside_2, closing, opening : float
        Squared distance from the scanline's axis after a length t: aside_2 + 2 t closing + t^2 opening, mm^2.
    """

    from_mm: float
    loss_db: float
    slope_db_mm: float
    stretch: float
    aside_2: float
    closing: float
    opening: float


def dark(groups: int, probe: ConvexProbe, settings: SimulatorSettings) -> Nodes:
    """Nodes from the first sample to the last, before any ray has come."""
    count = min(settings.axial_samples, NODES)
    first = probe.depth_mm / settings.axial_samples / 2
    spacing = (probe.depth_mm - 2 * first) / max(count - 1, 1) or 1.0
    widest = max(1.0, probe.depth_mm / settings.focus_mm - 1)
    beam = 1.001 * widest * math.hypot(settings.aperture_mm, settings.elevational_aperture_mm) + 1e-3
    return Nodes(first, spacing, beam, np.zeros((groups, count)))


@compiled
def shine(nodes: Nodes, group: int, piece: Piece, to_mm: float) -> None:
    """Add one ray of weight 1 at the nodes from the beginning of a piece to `to_mm`, exclusively.

    Between nodes the amplitude falls by one factor, so a piece costs two powers, however long it is. Where refraction
    has led the ray away from its scanline it does not light that scanline's scatterers: beyond `beam_mm` its weight
    falls as a Gaussian of `STRAY_MM`.
    """
    amplitude = nodes.amplitude[group]
    count = len(amplitude)
    first = min(max(math.ceil((piece.from_mm - nodes.first_mm) / nodes.spacing_mm), 0), count)
    last = count
    if to_mm < nodes.first_mm + count * nodes.spacing_mm:
        last = max(math.ceil((to_mm - nodes.first_mm) / nodes.spacing_mm), 0)
    if first >= last:
        return
    begin = nodes.first_mm + first * nodes.spacing_mm - piece.from_mm
    level = math.exp(-(piece.loss_db + piece.slope_db_mm * begin) * _NEPER_PER_TWO_WAY_DB)
    factor = math.exp(-piece.slope_db_mm * nodes.spacing_mm * _NEPER_PER_TWO_WAY_DB)
    farthest = max(_aside_mm(piece, begin), _aside_mm(piece, begin + (last - 1 - first) * nodes.spacing_mm))
    if farthest <= nodes.beam_mm:
        for k in range(first, last):
            amplitude[k] += level
            level *= factor
        return
    for k in range(first, last):
        stray = max(_aside_mm(piece, begin + (k - first) * nodes.spacing_mm) - nodes.beam_mm, 0.0) / STRAY_MM
        amplitude[k] += level * math.exp(-0.5 * stray * stray)
        level *= factor


@compiled
def _aside_mm(piece: Piece, shown_mm: float) -> float:
    """Distance from the scanline's axis, so far from the beginning of a piece."""
    along = shown_mm / piece.stretch
    return math.sqrt(max(piece.aside_2 + along * (2 * piece.closing + along * piece.opening), 0.0))


def mean_level_db(nodes: Nodes, rays: int) -> np.ndarray:
    """Level of the mean over the rays of each group, (groups, nodes) float32, dB, at least `SILENCE_DB`."""
    mean = nodes.amplitude / rays
    return (20 * np.log10(np.maximum(mean, 10 ** (SILENCE_DB / 20)))).astype(np.float32)
