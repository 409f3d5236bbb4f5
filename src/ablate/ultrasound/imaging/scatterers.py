"""Scatterers fixed to the body: a counter-based hash of the lattice cell that a point lies in.

There is no volume to store and no period to see; another seed is another hash. Every sample stands for
`DRAWS_PER_SAMPLE` scatterers, because a sample's share of the slice (about 0.05 x 0.7 x 1.5 mm) holds many lattice
cells: with one each, three layers of some ten cells would not be fully developed speckle.

All tissues shape one table of variates, so the lattice without its tissues, `lattice.grain`, has the phases of every
tissue's scatterers, and their strengths up to a factor that grows with the strength.
"""

import math
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np

from ablate.anatomy import Tissue
from ablate.ultrasound.compiled import Arrays, compiled, step

DRAWS_PER_SAMPLE = 16
TABLE_SIZE = 8192
_TABLE_SEED = 20201
_MASK = 0xFFFFFFFF
ANCHOR_CELLS = 1 << 20  # float32 tells a sixteenth of a cell apart up to there
_FACTORS = np.array([0x1B873593, 0x2545F491, 0x27D4EB2F], np.uint32)
_MIXING = np.array([(15, 0x2C1B3C6D), (12, 0x297A2D39)], np.uint32)  # shift and factor: a 32-bit finaliser
_LAST_SHIFT = np.uint32(15)
_LAST_BITS = np.uint32(TABLE_SIZE - 1)


@cache
def _variates() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of `DRAWS_PER_SAMPLE` scatterers an entry: uniform, normal, and a random phasor, (draws, TABLE_SIZE) each."""
    generator = np.random.Generator(np.random.Philox(key=[_TABLE_SEED, 0]))
    shape = (DRAWS_PER_SAMPLE, TABLE_SIZE)
    uniform = generator.random(shape, np.float32)
    normal = generator.standard_normal(shape, np.float32)
    phase = generator.random(shape, np.float32) * np.float32(2 * math.pi)
    return uniform, normal, np.exp(1j * phase)


@cache
def _beside() -> np.ndarray:
    """How far beside the beam's axis each scatterer of an entry lies, normal of variance 1, (draws, TABLE_SIZE)."""
    generator = np.random.Generator(np.random.Philox(key=[_TABLE_SEED, 1]))
    return generator.standard_normal((DRAWS_PER_SAMPLE, TABLE_SIZE), np.float32)


def _phasors(turn_rad: float) -> np.ndarray:
    """Phasors of the scatterers of each entry, (draws, TABLE_SIZE), as a steered wave meets them."""
    phasor = _variates()[2]
    return phasor * np.exp(1j * np.float32(turn_rad) * _beside()) if turn_rad else phasor


@lru_cache(maxsize=16)
def white_table(turn_rad: float = 0.0) -> np.ndarray:
    """Complex variates of the lattice, before any tissue, (TABLE_SIZE,) complex64 of mean square 1.

    A wave that is steered aside meets the scatterers of an entry in another order: the phase of each turns by a normal
    angle of the standard deviation `turn_rad`. Entries of two such waves correlate by exp(-d^2 / 2), d the difference
    of their `turn_rad`.
    """
    normal, phasor = _variates()[1], _phasors(turn_rad)
    total = (normal * phasor).sum(axis=0)
    white: np.ndarray = (total / np.sqrt(np.mean(np.abs(total) ** 2))).astype(np.complex64)
    return white


@lru_cache(maxsize=512)
def scatterer_table(tissue: Tissue, turn_rad: float = 0.0) -> np.ndarray:
    """Complex scatterer strengths of a tissue, which the hash chooses from, (TABLE_SIZE,) complex64.

    s = [u <= density] (mean + sd n), Burger et al. 2013, eq. 15, less its expectation (a band-pass pulse does not
    see it), with a random phase; summed over `DRAWS_PER_SAMPLE` and scaled so that the mean square is
    `Tissue.scatter_power`. The amplitudes are put in the order of those of `white_table`, and have its phases: their
    distribution is that of the sums, and the lattice tells, in each cell, how bright a tissue's scatterer is among all
    of the tissue's. A tissue more in a scene changes no other's speckle. `turn_rad` is that of `white_table`.
    """
    if tissue.scatter_power <= 0:
        return np.zeros(TABLE_SIZE, np.complex64)
    uniform, normal, _ = _variates()
    phasor = _phasors(turn_rad)
    here = uniform <= tissue.scatterer_density
    strength = here * (tissue.scatterer_sd * normal)
    strength += (here - tissue.scatterer_density) * tissue.scatterer_mean  # a large mean cancels before it is added
    amplitudes = np.sort(np.abs((strength * phasor).sum(axis=0)))
    power = np.mean(amplitudes**2)  # 0 where the table of a very sparse tissue holds no scatterer
    if power > 0:
        amplitudes *= math.sqrt(tissue.scatter_power / power)
    white = white_table(turn_rad)
    in_order = np.argsort(np.abs(white), kind="stable")
    table = np.empty(TABLE_SIZE, np.complex64)
    table[in_order] = amplitudes * (white / np.abs(white))[in_order]
    return table


def mix_seed(seed: int) -> np.uint32:
    """A seed of any size as 32 well mixed bits."""
    value = 0x9E3779B9
    while True:
        value = ((value ^ (seed & _MASK)) * 0x85EBCA6B) & _MASK
        value ^= value >> 13
        value = (value * 0xC2B2AE35) & _MASK
        value ^= value >> 16
        seed >>= 32
        if seed <= 0:
            return np.uint32(value)


def shared_cell_gain(
    directions: np.ndarray, spacing_mm: float, pitch_mm: float, kernel_correlation: np.ndarray
) -> np.ndarray:
    """Power gained because neighbouring samples of a scanline can lie in one lattice cell.

    Two points a vector v apart share a cell with probability prod_a max(0, 1 - |v_a| / pitch); the power of their
    weighted sum is the sum of the kernel's autocorrelation times that.

    Parameters
    ----------
    directions : (n, 3) float
        Unit vectors of the scanlines in world coordinates.
    spacing_mm : float
        From sample to sample.
    pitch_mm : float
        Side of a cell.
    kernel_correlation : (lags,) float
        Autocorrelation of the axial kernel, 1 at lag 0.

    Returns
    -------
    (n,) float
        At least 1.
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
    apart, width = np.abs(steps_mm[near]).T.copy() / pitch_mm, np.broadcast_to(sigma, gain.shape)[near]
    for lag in range(1, len(steps_mm)):
        shared = np.maximum(0, 1 - lag * apart).prod(axis=0)
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


class Samples(NamedTuple):
    """What a sample of a pose needs to know of its scatterer."""

    starts: np.ndarray  # (layers, scanlines, 3) float32, mm from the anchor along the body's axes
    directions: np.ndarray  # (layers, scanlines, 3) float32
    anchor: np.ndarray  # (3,) uint32, cells from the body's origin to where the lattice is counted from, modulo 2^32
    ranges_mm: np.ndarray  # (layers, scanlines, samples) float32, along its line to what a sample displays
    tissue: np.ndarray  # (layers, scanlines, samples) uint8
    amplitude: np.ndarray  # (layers, scanlines, samples), of unit strength: illumination, texture, level and weight


@step
def entry_of_cell(
    start: np.ndarray, along: np.ndarray, r: np.float32, anchor: np.ndarray, lattice: tuple[np.float32, np.uint32]
) -> np.int64:
    """The entry of a table that the lattice cell of a point chooses.

    Parameters
    ----------
    start, along : (3,) float32
        Of the point's line: mm from the anchor, and its direction.
    r : float32
        From there to the point, mm.
    anchor : (3,) uint32
        Cells to where the lattice is counted from, modulo 2^32.
    lattice : tuple of float32 and uint32
        Cells a millimetre, and the seed.
    """
    cells_per_mm, mixed = lattice
    for axis in range(3):
        cell = np.int64(np.floor((start[axis] + along[axis] * r) * cells_per_mm))
        mixed ^= np.uint32((np.uint32(cell) + anchor[axis]) * _FACTORS[axis])
    for shift, factor in _MIXING:
        mixed = np.uint32((mixed ^ (mixed >> shift)) * factor)
    return np.int64((mixed ^ (mixed >> _LAST_SHIFT)) & _LAST_BITS)


@compiled
def sum_scatterers(
    total: np.ndarray, samples: Samples, lattice: tuple[np.float32, np.uint32], tissues: Arrays, begin: int, end: int
) -> None:
    """Sum amplitude x scatterer over layers for some scanlines.

    A hash of the lattice cell that a sample lies in chooses its scatterer.

    Parameters
    ----------
    total : (2, scanlines, samples) float
        Real and imaginary part; is filled.
    samples : Samples
        Where they lie, and their amplitudes.
    lattice : tuple of float32 and uint32
        Cells a millimetre, and the seed.
    tissues : tuple of array
        Which are silent, (tissues,) bool, and the tables, (tissues * TABLE_SIZE, 2).
    begin, end : int
        The scanlines.
    """
    starts, directions, anchor, ranges_mm, held, amplitude = samples
    silent, tables = tissues
    for line in range(begin, end):
        total[:, line] = 0
        for layer in range(len(amplitude)):
            start, along = starts[layer, line], directions[layer, line]
            for sample in range(amplitude.shape[2]):
                tissue, level = held[layer, line, sample], amplitude[layer, line, sample]
                if silent[tissue] or level == 0:
                    continue
                entry = entry_of_cell(start, along, ranges_mm[layer, line, sample], anchor, lattice)
                row = np.int64(tissue) * TABLE_SIZE + entry
                total[0, line, sample] += tables[row, 0] * level
                total[1, line, sample] += tables[row, 1] * level
