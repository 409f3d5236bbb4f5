"""From rays to lines of amplitude: the echoes that they bring back, and how strongly they insonify each scanline."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
import torch
from torch.nn import functional as F

from ablate.ultrasound.compiled import Arrays, Vector, compiled
from ablate.ultrasound.media import Medium
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.transport.rays import Ray

#: Echoes of rays that have left their beam are few and out of focus: they are spread over these standard deviations.
_CLUTTER_LINES = 12.0
_CLUTTER_MM = 2.0
_CLUTTER_CELLS_PER_SIGMA = 2.0
#: Lines are dealt to so many sets, and the power of these echoes is estimated from products of different sets.
_CLUTTER_SETS = 8
#: So many variances of the sum are taken from its power: one heavy path is no haze. It vanishes with many rays.
_CLUTTER_VARIANCES = 2.0


#: An echo received from a surface.
ECHO = np.dtype(
    [
        ("group", np.int32),  # scanline and layer
        ("depth_mm", np.float32),  # as displayed
        ("amplitude", np.float32),  # of one ray: to be divided by the rays of a group
        ("clutter", np.bool_),  # of random phase: of a ray that had been reflected before, or had left its beam
    ]
)

#: Depths at which the rays' mean is taken; between them it is interpolated in dB.
NODES = 256
#: Level of no sound at all, dB: finite, so that interpolation makes no NaN, and zero as a float32 amplitude.
NO_SOUND_DB = -4000.0
_LOWEST_DB = -600.0  # all below counts as no sound: far under any display, and it spares the signal chain denormals
_NEPER_PER_DB = math.log(10) / 20
_NEPER_PER_TWO_WAY_DB = 2 * _NEPER_PER_DB


@stage(Stage.surface_echoes)
def echo_lines(
    echoes: np.ndarray, gain_db: np.ndarray, nodes: Nodes, weights: np.ndarray, rays: int, depth_mm: float
) -> tuple[np.ndarray, np.ndarray]:
    """What rays bring back, the mean over the rays of a group: of those still in their beam, and of the others.

    Parameters
    ----------
    echoes : (n,) ECHO
        Of all rays.
    gain_db : (groups, nodes) float64
        The aperture's, for those in their beam.
    nodes : Nodes
        Where it is given.
    weights : (layers, samples) float
        Elevational; they sum to 1 over layers.
    rays : int
        Of each group.
    depth_mm : float
        Of the image.

    Returns
    -------
    surfaces : (scanlines, samples) float64
        Amplitudes, real and positive, so that they converge with the number of rays.
    reverberation : (scanlines, cells) float64
        The same for the others, in cells of some depth.
    """
    layers, samples = weights.shape
    lines = len(gain_db) // layers
    cells = max(1, min(samples, math.ceil(depth_mm / _CLUTTER_MM * _CLUTTER_CELLS_PER_SIGMA)))
    surfaces, reverberation = np.zeros((lines, samples)), np.zeros((lines, cells))
    places = nodes.first_mm, nodes.spacing_mm, samples / depth_mm
    _add_echoes(echoes, gain_db, places, weights / rays, (surfaces, reverberation))
    return surfaces, reverberation


@compiled
def _add_echoes(echoes: np.ndarray, gain_db: np.ndarray, places: Vector, weights: np.ndarray, sums: Arrays) -> None:
    """Share echoes among the two samples or cells on either side; what lies beyond the outer centres goes to them."""
    first_mm, spacing_mm, per_mm = places
    surfaces, reverberation = sums
    (lines, samples), cells, nodes = surfaces.shape, reverberation.shape[1], gain_db.shape[1]
    for i in range(len(echoes)):
        echo = echoes[i]
        layer, line = echo.group // lines, echo.group % lines
        position = min(max(echo.depth_mm * per_mm - 0.5, 0.0), samples - 1.0)
        amplitude = echo.amplitude * weights[layer, int(position)]
        if echo.clutter:
            position = min(max((position + 0.5) * (cells / samples) - 0.5, 0.0), cells - 1.0)
            below = min(int(position), max(cells - 2, 0))
            part = (position - below) * amplitude
            reverberation[line, below] += amplitude - part
            reverberation[line, min(below + 1, cells - 1)] += part
        else:
            node = min(max(round((echo.depth_mm - first_mm) / spacing_mm), 0), nodes - 1)
            amplitude *= math.exp(gain_db[echo.group, node] * _NEPER_PER_DB)
            below = min(int(position), max(samples - 2, 0))
            part = (position - below) * amplitude
            surfaces[line, below] += amplitude - part
            surfaces[line, min(below + 1, samples - 1)] += part


@stage(Stage.clutter)
def clutter_lines(
    reverberation: np.ndarray, samples: int, dtype: torch.dtype, gain: float = 1.0, sets: int = _CLUTTER_SETS
) -> np.ndarray:
    """Spread echoes of rays that have left their beam, few and out of focus, along and across the scanlines.

    The sum is kept. The power of the sum is estimated without bias, from products x_i x_j of different lines' shares
    i != j in it (a U-statistic; Hoeffding 1948). The square of the sum would hold x_i^2 as well, whose mean is too
    large by the variance: bright bands of one heavy path in dark fluid. A multiple of that variance is subtracted, so
    that such a path is left out.

    Parameters
    ----------
    reverberation : (scanlines, cells) float64
        Their amplitudes.
    samples : int
        Of a scanline.
    dtype : torch.dtype
        Of the result.
    gain : float
        By which the sum is multiplied.
    sets : int
        Lines are dealt to so many; with one of them it is the sum itself, which needs few rays.

    Returns
    -------
    (scanlines, samples) float
        Amplitudes; (0, samples) where there are no such echoes.
    """
    if not reverberation.any():
        return torch.empty((0, samples), dtype=dtype).numpy()
    lines, cells = reverberation.shape
    across, along = _spreading(lines, _CLUTTER_LINES), _spreading(cells, _CLUTTER_CELLS_PER_SIGMA)
    smooth, sets_of_lines = (
        torch.from_numpy(reverberation) @ along.T,
        [slice(k, None, sets) for k in range(min(sets, lines))],
    )
    spread = torch.stack([across[:, some] @ smooth[some] for some in sets_of_lines])
    share = torch.stack([across[:, some].sum(dim=-1) for some in sets_of_lines]) / across.sum(dim=-1)
    if len(spread) == 1:
        total = spread[0]
    else:
        square = spread.sum(dim=0).square()
        power = (square - spread.square().sum(dim=0)) / (1 - share.square().sum(dim=0))[:, None]
        total = (power - _CLUTTER_VARIANCES * (square - power).clamp(min=0)).clamp(min=0).sqrt()
    coarse = (total * (gain * cells / samples)).to(dtype)
    return F.interpolate(coarse[None], size=samples, mode="linear", align_corners=False)[0].numpy()


@cache
def _spreading(n: int, sigma: float) -> torch.Tensor:
    """A Gaussian smoothing matrix whose columns sum to 1, so that nothing is lost at the ends, (n, n)."""
    apart = np.minimum(np.abs(np.arange(n)[:, None] - np.arange(n)) / sigma, 5.0)
    matrix = np.where(apart < 4, np.exp(-0.5 * apart**2), 0.0)
    return torch.from_numpy(matrix / matrix.sum(axis=0))


class Nodes(NamedTuple):
    """Depths at which the illumination is kept, and what has been accumulated there."""

    first_mm: float
    spacing_mm: float
    anechoic: np.ndarray  # (groups, nodes) bool: the background without scatterers, there or half a node beside
    amplitude: np.ndarray  # (groups, nodes) float64, sum over the rays of weight x 10^(-2 loss / 20)


def empty_nodes(labels: np.ndarray, anechoic: np.ndarray, depth_mm: float) -> Nodes:
    """Nodes from the first sample to the last, before any ray has come; of labels (groups, samples) and which are."""
    groups, samples = labels.shape
    count = min(samples, NODES)
    first = depth_mm / samples / 2
    spacing = (depth_mm - 2 * first) / max(count - 1, 1) or 1.0
    nearest = np.rint(np.linspace(0, samples - 1, count)).astype(int)
    half = samples // (2 * count)
    around = [np.clip(nearest + shift, 0, samples - 1) for shift in (-half, 0, half)]
    empty = np.any([anechoic.take(labels.take(place, axis=1)) for place in around], axis=0)
    return Nodes(first, spacing, empty, np.zeros((groups, count)))


@compiled
def passed(
    first_mm: float, spacing_mm: float, count: int, ray: Ray, medium: Medium, length_mm: float, weight: float
) -> tuple[int, int, float, float]:
    """The nodes that a ray passes over a displayed length, from its last surface on.

    A length costs two exponentials, however long it is.

    Parameters
    ----------
    first_mm, spacing_mm : float
        Depth of the first node, and from one to the next.
    count : int
        Of nodes.
    ray : Ray
        At its last surface.
    medium : Medium
        What it goes through.
    length_mm : float
        Displayed.
    weight : float
        Its amplitude without losses.

    Returns
    -------
    first, last : int
        From which node to before which one.
    level : float
        Amplitude at the first of them.
    factor : float
        By which it falls from one to the next.
    """
    to_mm, slope_db_mm = ray.displayed_mm + length_mm, medium.loss_db_mm / medium.stretch
    first = min(max(math.ceil((ray.displayed_mm - first_mm) / spacing_mm), 0), count)
    last = count
    if to_mm < first_mm + count * spacing_mm:
        last = max(math.ceil((to_mm - first_mm) / spacing_mm), 0)
    if first >= last:
        return 0, 0, 0.0, 0.0
    at_first = ray.loss_db + slope_db_mm * (first_mm + first * spacing_mm - ray.displayed_mm)
    factor = math.exp(-slope_db_mm * spacing_mm * _NEPER_PER_TWO_WAY_DB)
    return first, last, weight * math.exp(-at_first * _NEPER_PER_TWO_WAY_DB), factor


@stage(Stage.illumination)
def mean_level_db(amplitude: np.ndarray, rays: int, beam: torch.Tensor) -> np.ndarray:
    """Level in dB of the mean over rays and, as the beam overlaps, over scanlines, (groups, nodes) float64.

    `amplitude`, (groups, nodes), is the sum over the `rays` of each group.
    """
    groups, count = amplitude.shape
    lines = beam.shape[-1]
    mean = torch.from_numpy(amplitude / rays).reshape(-1, lines, count)
    parts = np.array_split(np.arange(count), len(beam))
    overlapping = torch.cat([kernel @ mean[..., part] for kernel, part in zip(beam, parts, strict=True)], dim=-1)
    level = 20 * torch.log10(overlapping.reshape(groups, count)).numpy()
    return np.where(level > _LOWEST_DB, level, NO_SOUND_DB)
