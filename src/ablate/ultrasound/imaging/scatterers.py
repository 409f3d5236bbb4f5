"""Scatterers fixed to the world: a counter-based hash of the lattice cell that a point lies in, and a slow texture.

There is no volume to store and no period to see; another seed is another hash. Every sample stands for
`DRAWS_PER_SAMPLE` scatterers, because a sample's share of the slice (about 0.05 x 0.7 x 1.5 mm) holds many lattice
cells: with one each, three layers of some ten cells would not be fully developed speckle.
"""

import math
import zlib
from collections.abc import Iterable, Sequence
from functools import cache

import numpy as np
import torch
from scipy.ndimage import fourier_gaussian
from torch.nn import functional as F

from ablate.anatomy import Tissue
from ablate.ultrasound.compiled import compiled

DRAWS_PER_SAMPLE = 16
TABLE_SIZE = 8192
AXIS_FACTORS = (0x1B873593, 0x2545F491, 0x27D4EB2F)
MIXING = ((15, 0x2C1B3C6D), (12, 0x297A2D39))  # the finaliser of a 32-bit integer hash
_TABLE_SEED = 20201
_MASK = 0xFFFFFFFF
_TEXTURE_SIDE = 64  # voxels of the periodic volume of smooth noise that is stretched for each tissue
_TEXTURE_SMOOTHING = 1.2  # voxels; the correlation then falls to 1/e over twice that
_VOXELS_PER_LENGTH = 2 * _TEXTURE_SMOOTHING
_TEXTURE_SEED = 7
ANCHOR_CELLS = 1 << 20  # float32 tells a sixteenth of a cell apart up to there
_FACTORS = np.array(AXIS_FACTORS, np.uint32)
_MIXING = np.array(MIXING, np.uint32)  # (rounds, 2): shift and factor
_LAST_SHIFT = np.uint32(15)
_LAST_BITS = np.uint32(TABLE_SIZE - 1)


def scatterer_tables(tissues: Sequence[Tissue]) -> np.ndarray:
    """Complex scatterer strengths that the hash chooses from, one row a tissue, (tissues, TABLE_SIZE) complex64.

    s = [u <= density] (mean + sd n), Burger et al. 2013, eq. 15, less its expectation (a band-pass pulse does not
    see it), with a random phase; summed over `DRAWS_PER_SAMPLE` and scaled so that the mean square is
    `Tissue.scatter_power`. Seeded by the tissue's name, so that a tissue more in a scene changes no other's speckle.
    """
    tables = np.zeros((len(tissues), TABLE_SIZE), np.complex64)
    for tissue, table in zip(tissues, tables, strict=True):
        if tissue.scatter_power <= 0:
            continue
        generator = np.random.Generator(np.random.Philox(key=[_TABLE_SEED, zlib.crc32(tissue.name.encode())]))
        shape = (DRAWS_PER_SAMPLE, TABLE_SIZE)
        here = generator.random(shape, np.float32) <= tissue.scatterer_density
        n = generator.standard_normal(shape, np.float32)
        strength = here * (tissue.scatterer_sd * n)
        strength += (here - tissue.scatterer_density) * tissue.scatterer_mean  # a large mean cancels before it is added
        phase = generator.random(shape, np.float32) * np.float32(2 * math.pi)
        total = (strength * np.exp(1j * phase)).sum(axis=0)
        power = np.mean(np.abs(total) ** 2)
        if power > 0:  # the table of a very sparse tissue may hold no scatterer
            table[:] = total * math.sqrt(tissue.scatter_power / power)
    return tables


def cell_hash(
    points_mm: Sequence[torch.Tensor], pitch_mm: float, seed: int, anchor: Iterable[float] = (0, 0, 0)
) -> torch.Tensor:
    """A number in [0, TABLE_SIZE) for the lattice cell that each point lies in.

    `points_mm` holds three tensors of one shape, the coordinates from the anchor; they are overwritten.
    """
    mixed = None
    for axis, factor, first in zip(points_mm, AXIS_FACTORS, anchor, strict=True):
        cell = axis.mul_(1 / pitch_mm).floor_().to(torch.int32)
        if first:
            cell.add_(wrapped(int(first)))
        cell.mul_(factor)
        mixed = cell if mixed is None else mixed.bitwise_xor_(cell)
    assert mixed is not None
    mixed.bitwise_xor_(torch.tensor(mix_seed(seed), dtype=torch.int32, device=mixed.device))
    for shift, factor in MIXING:
        mixed.bitwise_xor_((mixed >> shift).bitwise_and_((1 << (32 - shift)) - 1))
        mixed.mul_(factor)
    mixed.bitwise_xor_((mixed >> 15).bitwise_and_((1 << 17) - 1))
    return mixed.bitwise_and_(TABLE_SIZE - 1)


def mix_seed(seed: int) -> int:
    """A seed of any size as 32 well mixed bits, in the range of int32."""
    value = 0x9E3779B9
    while True:
        value = ((value ^ (seed & _MASK)) * 0x85EBCA6B) & _MASK
        value ^= value >> 13
        value = (value * 0xC2B2AE35) & _MASK
        value ^= value >> 16
        seed >>= 32
        if seed <= 0:
            return wrapped(value)


def wrapped(value: int) -> int:
    """A whole number modulo 2^32, in the range of int32."""
    return (value + (1 << 31)) % (1 << 32) - (1 << 31)


def shared_cell_gain(
    directions: np.ndarray, spacing_mm: float, pitch_mm: float, kernel_correlation: np.ndarray
) -> np.ndarray:
    """Power gained because neighbouring samples of a scanline can lie in one lattice cell, (n,) float, at least 1.

    Two points a vector v apart share a cell with probability prod_a max(0, 1 - |v_a| / pitch); the power of their
    weighted sum is the sum of the kernel's autocorrelation, (lags,) and 1 at lag 0, times that. `directions`, (n, 3),
    are unit vectors of the scanlines in world coordinates; `spacing_mm` lies between samples.
    """
    lags = np.arange(len(kernel_correlation)) * spacing_mm
    shared = np.maximum(0, 1 - np.abs(directions)[:, None, :] * lags[:, None] / pitch_mm).prod(axis=-1)
    twice = np.where(np.arange(len(lags)) == 0, 1, 2)
    return (shared * kernel_correlation * twice).sum(axis=-1)


def shared_cell_gain_across(steps_mm: np.ndarray, sigma: np.ndarray, pitch_mm: float) -> np.ndarray:
    """The same for neighbouring scanlines, which meet at the face of a phased probe, (scanlines, depths), at least 1.

    `steps_mm`, (scanlines, depths, 3), lead from a sample to that of the next scanline in world coordinates; `sigma`,
    (scanlines or 1, depths), is the standard deviation of the beam in scanlines. The autocorrelation of a Gaussian of
    sigma is one of sqrt(2) sigma.
    """
    gain = np.ones(steps_mm.shape[:2])
    near = (np.abs(steps_mm) < pitch_mm).all(axis=-1)
    apart, width = np.abs(steps_mm[near]) / pitch_mm, np.broadcast_to(sigma, gain.shape)[near]
    for lag in range(1, len(steps_mm)):
        shared = np.maximum(0, 1 - lag * apart).prod(axis=-1)
        if not shared.any():
            break
        gain[near] += 2 * shared * np.exp(-((lag / (2 * width)) ** 2))
    return gain


def shared_cell_gain_of_layers(starts_mm: np.ndarray, weights: np.ndarray, pitch_mm: float) -> np.ndarray:
    """The same for the layers of a scanline, which are parallel, (depths,), at least 1.

    `starts_mm`, (layers, 3), are their starts in world coordinates; `weights`, (layers, depths), their amplitudes with
    a sum of squares of 1 at each depth.
    """
    apart = np.abs(starts_mm[:, None] - starts_mm) / pitch_mm
    shared = np.maximum(0, 1 - apart).prod(axis=-1)
    np.fill_diagonal(shared, 0)
    return 1 + np.einsum("ld,lm,md->d", weights, shared, weights)


@cache
def _texture_volume() -> torch.Tensor:
    """Periodic Gaussian noise, of unit variance when interpolated, (1, 1, side + 1, ...).

    The first planes are repeated at the end, so that interpolation needs no wrapping.
    """
    generator = np.random.Generator(np.random.Philox(key=[_TEXTURE_SEED, 0]))
    noise = generator.standard_normal((_TEXTURE_SIDE,) * 3)
    smooth = np.fft.ifftn(fourier_gaussian(np.fft.fftn(noise), _TEXTURE_SMOOTHING)).real
    neighbours = math.exp(-1 / (2 * _TEXTURE_SMOOTHING) ** 2)  # correlation of adjacent voxels
    interpolated = (2 / 3 + neighbours / 3) ** 1.5  # standard deviation left, on average, between voxels
    smooth = (smooth - smooth.mean()) / (smooth.std() * interpolated)
    wrapped = np.pad(smooth, (0, 1), mode="wrap").astype(np.float32)
    return torch.from_numpy(wrapped)[None, None]


def texture_gain_db(points_mm: torch.Tensor, labels: torch.Tensor, tables: torch.Tensor) -> torch.Tensor:
    """Gain in dB of the scatterers' amplitude, (...) float32, of unit mean power over a tissue.

    g is normal with unit variance; the gain contrast * g has mean power exp(2 a^2), a = contrast ln(10) / 20,
    which is taken off again. Points are (..., 3) float32 in world coordinates, labels (...) indices of their tissues;
    `tables`, (tissues, 4), hold three inverse lengths of the texture, 1/mm, and its contrast, dB.
    """
    own = tables[labels]
    contrast = own[..., 3]
    turns = points_mm * own[..., :3] * (_VOXELS_PER_LENGTH / _TEXTURE_SIDE)
    turns = turns - turns.floor()
    grid = (2 * turns - 1).flip(-1).reshape(1, 1, 1, -1, 3)
    volume = _texture_volume().to(points_mm)
    g = F.grid_sample(volume, grid, mode="bilinear", padding_mode="border", align_corners=True)
    return contrast * g.reshape(labels.shape) - contrast**2 * (math.log(10) / 20)


@compiled
def add_scatterers(
    total: np.ndarray,
    starts: np.ndarray,
    directions: np.ndarray,
    ranges_mm: np.ndarray,
    anchor: np.ndarray,
    cells_per_mm: np.float32,
    seed: np.uint32,
    tissues: np.ndarray,
    silent: np.ndarray,
    tables: np.ndarray,
    amplitude: np.ndarray,
) -> None:
    """Add amplitude x scatterer of every layer to `total`, (2, lines, samples).

    `starts` and `directions` are (layers, lines, 3) float32 in mm from the anchor, `anchor` (3,) uint32, `ranges_mm`,
    `tissues` and `amplitude` (layers, lines, samples), `silent` (tissues,) bool and `tables` (tissues * TABLE_SIZE, 2).
    """
    layers, lines, samples = amplitude.shape
    for line in range(lines):
        for layer in range(layers):
            start, along = starts[layer, line], directions[layer, line]
            for sample in range(samples):
                tissue, level = tissues[layer, line, sample], amplitude[layer, line, sample]
                if silent[tissue] or level == 0:
                    continue
                r, mixed = ranges_mm[layer, line, sample], seed  # as `cell_hash` does
                for axis in range(3):
                    cell = np.int64(np.floor((start[axis] + along[axis] * r) * cells_per_mm))
                    mixed ^= np.uint32((np.uint32(cell) + anchor[axis]) * _FACTORS[axis])
                for shift, factor in _MIXING:
                    mixed = np.uint32((mixed ^ (mixed >> shift)) * factor)
                row = np.int64(tissue) * TABLE_SIZE + np.int64((mixed ^ (mixed >> _LAST_SHIFT)) & _LAST_BITS)
                total[0, line, sample] += tables[row, 0] * level
                total[1, line, sample] += tables[row, 1] * level
