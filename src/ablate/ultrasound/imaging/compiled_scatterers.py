"""The sum of scatterers over layers, compiled for a CPU: what `Speckle` computes with torch elsewhere.

Samples of tissues without scatterers, and those that no sound reaches, are left out one by one.
"""

import numpy as np

from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.imaging.scatterers import AXIS_FACTORS, MIXING, TABLE_SIZE

_FACTORS = np.array(AXIS_FACTORS, np.uint32)
_MIXING = np.array(MIXING, np.uint32)  # (rounds, 2): shift and factor
_LAST_SHIFT = np.uint32(15)
_MASK = np.uint32(TABLE_SIZE - 1)


@compiled
def _cell(coordinate_mm: np.float32, cells_per_mm: np.float32, anchor: np.uint32) -> np.uint32:
    """Number of the lattice cell along an axis, modulo 2^32."""
    return np.uint32(np.int64(np.floor(coordinate_mm * cells_per_mm))) + anchor


@compiled
def _entry(x: np.uint32, y: np.uint32, z: np.uint32, seed: np.uint32) -> np.uint32:
    """`scatterers.cell_hash` of one cell."""
    mixed = np.uint32(x * _FACTORS[0]) ^ np.uint32(y * _FACTORS[1]) ^ np.uint32(z * _FACTORS[2]) ^ seed
    for shift, factor in _MIXING:
        mixed = np.uint32((mixed ^ (mixed >> shift)) * factor)
    return (mixed ^ (mixed >> _LAST_SHIFT)) & _MASK


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

    `starts` and `directions` are (layers, lines, 3) float32 in mm from the anchor, `ranges_mm` (1 or layers, 1 or
    lines, samples), `anchor` (3,) uint32, `tissues` and `amplitude` (layers, lines, samples), `silent` (tissues,) bool
    and `tables` (tissues * TABLE_SIZE, 2).
    """
    layers, lines, samples = amplitude.shape
    for line in range(lines):
        for layer in range(layers):
            start, along = starts[layer, line], directions[layer, line]
            ranges = ranges_mm[min(layer, len(ranges_mm) - 1), min(line, ranges_mm.shape[1] - 1)]
            for sample in range(samples):
                tissue, level = tissues[layer, line, sample], amplitude[layer, line, sample]
                if silent[tissue] or level == 0:
                    continue
                r = ranges[sample]
                x = _cell(start[0] + along[0] * r, cells_per_mm, anchor[0])
                y = _cell(start[1] + along[1] * r, cells_per_mm, anchor[1])
                z = _cell(start[2] + along[2] * r, cells_per_mm, anchor[2])
                row = np.int64(tissue) * TABLE_SIZE + np.int64(_entry(x, y, z, seed))
                total[0, line, sample] += tables[row, 0] * level
                total[1, line, sample] += tables[row, 1] * level
