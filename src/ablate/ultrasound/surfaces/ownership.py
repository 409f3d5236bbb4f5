"""Who owns a point: structures are toggled at each crossing, and the last of those one is inside owns it.

Winding and normals play no part, so meshes may be inside out. The set that a ray is inside of is a row of 32-bit
words, bit i % 32 of word i // 32 for structure i; an owner is i + 1, and 0 is the background.
"""

import math

import numpy as np

from ablate.ultrasound.compiled import compiled


@compiled
def toggle(inside: np.ndarray, structure: int) -> None:
    """Cross a surface: changes one set, (words,) uint32."""
    inside[structure >> 5] ^= np.uint32(1) << np.uint32(structure & 31)


@compiled
def owner(inside: np.ndarray) -> int:
    """1 + the last structure of a set, (words,) uint32; 0 where it is empty."""
    for word in range(len(inside) - 1, -1, -1):
        bits = inside[word]
        if bits:
            return 32 * word + math.frexp(float(bits))[1]  # exact: 32 bits fit a double's fraction
    return 0


@compiled
def owners(inside: np.ndarray) -> np.ndarray:
    """`owner` of each set of (n, words) uint32, (n,) int32."""
    found = np.empty(len(inside), np.int32)
    for i in range(len(inside)):
        found[i] = owner(inside[i])
    return found


@compiled
def next_step(step_mm: float, away: bool, least_mm: float) -> float:
    """How far to go beyond a surface just met, mm.

    Twice as far each time that the ray has not got away, from the same triangle or from one as near: a ray that runs
    along a surface would take it in steps of a tenth of a micrometre.
    """
    return least_mm if away else max(2 * step_mm, least_mm)
