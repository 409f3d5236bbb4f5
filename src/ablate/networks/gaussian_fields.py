"""Gaussian noise fields from a counter-based hash of seed, level and pixel.

There is no state. A field does not depend on the batch, on earlier draws or on the device, so a resumed training gets
the same noise as an uninterrupted one.
"""

import math

import torch
from torch import Tensor

# splitmix64: Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014;
# the constants are those of its reference implementation, as signed 64-bit integers.
_GOLDEN = 0x9E3779B97F4A7C15 - (1 << 64)
_MIX_1 = 0xBF58476D1CE4E5B9 - (1 << 64)
_MIX_2 = 0x94D049BB133111EB - (1 << 64)
_BITS_24 = (1 << 24) - 1


def gaussian_field(seed: Tensor, level: int, height: int, width: int) -> Tensor:
    """Draw one standard normal field for each sample.

    Parameters
    ----------
    seed : (N,) int64
        One seed for each sample; the field is computed on its device.
    level : int
        Number of the field; fields of different levels are independent.
    height, width : int
        Pixels.

    Returns
    -------
    (N, 1, height, width) float32
        Values within +-5.9, because a draw has 24 bits.

    Notes
    -----
    splitmix64 counts the pixels; the two halves of a word give a pair of normals by the transform of
    Box and Muller, "A note on the generation of random normal deviates", 1958.

    Examples
    --------
    >>> both = gaussian_field(torch.tensor([1, 2]), level=0, height=4, width=6)
    >>> torch.equal(both[1:], gaussian_field(torch.tensor([2]), level=0, height=4, width=6))
    True
    """
    pixels = height * width
    pairs = (pixels + 1) // 2
    key = _mix(_mix(seed) + level * 2 + 1)
    counter = torch.arange(1, pairs + 1, device=seed.device, dtype=torch.int64)
    word = _mix(key[:, None] + counter * _GOLDEN)
    radius = ((word & _BITS_24).float().add_(0.5).mul_(2.0**-24)).log_().mul_(-2.0).sqrt_()
    angle = _shifted(word, 40).float().mul_(2.0 * math.pi * 2.0**-24)
    normals = torch.cat((radius * angle.cos(), radius * angle.sin()), dim=1)
    return normals[:, :pixels].reshape(-1, 1, height, width)


def _shifted(word: Tensor, bits: int) -> Tensor:
    """Shift right by `bits` and fill with zeros; torch's shift of int64 copies the sign."""
    return (word >> bits) & ((1 << (64 - bits)) - 1)


def _mix(word: Tensor) -> Tensor:
    """Apply the final mixing of splitmix64; products wrap modulo 2^64."""
    word = (word ^ _shifted(word, 30)) * _MIX_1
    word = (word ^ _shifted(word, 27)) * _MIX_2
    return word ^ _shifted(word, 31)
