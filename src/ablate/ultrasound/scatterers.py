"""Scatterers fixed to the world: a counter-based hash of the lattice cell that a point lies in.

There is no volume to store and no period to see; another seed is another hash. Every sample stands for
`DRAWS_PER_SAMPLE` scatterers, because a sample's share of the slice (about 0.05 x 0.7 x 1.5 mm) holds many lattice
cells: with one each, three layers of some ten cells would not be fully developed speckle.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
import torch

from ablate.anatomy import Tissue

DRAWS_PER_SAMPLE = 16
TABLE_SIZE = 8192
_AXIS_FACTORS = (0x1B873593, 0x2545F491, 0x27D4EB2F)
_TABLE_SEED = 20201
_MASK = 0xFFFFFFFF
_ANCHOR_CELLS = 1 << 20  # float32 tells a sixteenth of a cell apart up to there


def scatterer_tables(tissues: Sequence[Tissue]) -> np.ndarray:
    """Complex scatterer strengths that the hash chooses from, one row a tissue.

    s = [u <= density] (mean + sd n), Burger et al. 2013, eq. 15, less its expectation (a band-pass pulse does not
    see it), with a random phase; summed over `DRAWS_PER_SAMPLE` and scaled so that the mean square is
    `Tissue.scatter_power`.

    Parameters
    ----------
    tissues : sequence of Tissue

    Returns
    -------
    (tissues, TABLE_SIZE) complex64
    """
    tables = np.zeros((len(tissues), TABLE_SIZE), np.complex64)
    for number, (tissue, table) in enumerate(zip(tissues, tables, strict=True)):
        if tissue.scatter_power <= 0:
            continue
        generator = np.random.Generator(np.random.Philox(key=[_TABLE_SEED, number]))
        shape = (DRAWS_PER_SAMPLE, TABLE_SIZE)
        here = generator.random(shape, np.float32) <= tissue.scatterer_density
        n = generator.standard_normal(shape, np.float32)
        strength = here * (tissue.scatterer_sd * n)
        strength += (here - tissue.scatterer_density) * tissue.scatterer_mean  # a large mean cancels before it is added
        phase = generator.random(shape, np.float32) * np.float32(2 * math.pi)
        total = (strength * np.exp(1j * phase)).sum(axis=0)
        power = np.mean(np.abs(total) ** 2)
        if power > 0:  # a tissue so sparse or faint that the table holds none of it is silent
            table[:] = total * math.sqrt(tissue.scatter_power / power)
    return tables


def lattice_anchor(points_mm: np.ndarray, pitch_mm: float) -> np.ndarray:
    """The corner of the lattice that points are counted from, so that float32 tells their cells apart.

    Parameters
    ----------
    points_mm : (n, 3) float64, mm
        World coordinates.
    pitch_mm : float

    Returns
    -------
    (3,) float64
        Cells from the world's origin: the multiple of `_ANCHOR_CELLS` nearest to the first point, 0 within 50 m of
        the origin at a pitch of 0.1 mm.
    """
    return np.rint(points_mm[0] / (pitch_mm * _ANCHOR_CELLS)) * _ANCHOR_CELLS


def cell_hash(
    points_mm: Sequence[torch.Tensor], pitch_mm: float, seed: int, anchor: Iterable[float] = (0, 0, 0)
) -> torch.Tensor:
    """A number in [0, TABLE_SIZE) for the lattice cell that each point lies in.

    Parameters
    ----------
    points_mm : three tensors of one shape
        Coordinates from the anchor; overwritten.
    pitch_mm : float
    seed : int
    anchor : three numbers
        From `lattice_anchor`.

    Returns
    -------
    int32 tensor of the same shape
    """
    mixed = None
    for axis, factor, first in zip(points_mm, _AXIS_FACTORS, anchor, strict=True):
        cell = axis.mul_(1 / pitch_mm).floor_().to(torch.int32)
        if first:
            cell.add_(_wrapped(int(first)))
        cell.mul_(factor)
        mixed = cell if mixed is None else mixed.bitwise_xor_(cell)
    assert mixed is not None
    mixed.bitwise_xor_(torch.tensor(_mix_seed(seed), dtype=torch.int32, device=mixed.device))
    for shift, factor in ((15, 0x2C1B3C6D), (12, 0x297A2D39)):  # the finaliser of a 32-bit integer hash
        mixed.bitwise_xor_((mixed >> shift).bitwise_and_((1 << (32 - shift)) - 1))
        mixed.mul_(factor)
    mixed.bitwise_xor_((mixed >> 15).bitwise_and_((1 << 17) - 1))
    return mixed.bitwise_and_(TABLE_SIZE - 1)


def _mix_seed(seed: int) -> int:
    """A seed of any size as 32 well mixed bits, in the range of int32."""
    value = 0x9E3779B9
    while True:
        value = ((value ^ (seed & _MASK)) * 0x85EBCA6B) & _MASK
        value ^= value >> 13
        value = (value * 0xC2B2AE35) & _MASK
        value ^= value >> 16
        seed >>= 32
        if seed <= 0:
            return _wrapped(value)


def _wrapped(value: int) -> int:
    """A whole number modulo 2^32, in the range of int32."""
    return (value + (1 << 31)) % (1 << 32) - (1 << 31)


def shared_cell_gain(
    directions: np.ndarray, spacing_mm: float, pitch_mm: float, kernel_correlation: np.ndarray
) -> np.ndarray:
    """Power gained because neighbouring samples of a scanline can lie in one lattice cell.

    Two points a vector v apart share a cell with probability prod_a max(0, 1 - |v_a| / pitch); the power of their
    weighted sum is the sum of the kernel's autocorrelation times that.

    Parameters
    ----------
    directions : (n, 3) float
        Unit vectors of the scanlines, in world coordinates.
    spacing_mm : float
        Between samples.
    pitch_mm : float
    kernel_correlation : (lags,) float
        Autocorrelation of the axial kernel at lags 0, 1, 2, ..., 1 at lag 0.

    Returns
    -------
    (n,) float, at least 1
    """
    lags = np.arange(len(kernel_correlation)) * spacing_mm
    shared = np.maximum(0, 1 - np.abs(directions)[:, None, :] * lags[:, None] / pitch_mm).prod(axis=-1)
    twice = np.where(np.arange(len(lags)) == 0, 1, 2)
    return (shared * kernel_correlation * twice).sum(axis=-1)
