"""Slow variation of the scatterers within a tissue: one periodic volume of smooth noise, stretched per tissue."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import numpy as np
import torch
from torch.nn import functional as F

from ablate.anatomy import Tissue

_SIDE = 64
_SMOOTHING = 1.2  # voxels; the correlation then falls to 1/e over twice that
_VOXELS_PER_LENGTH = 2 * _SMOOTHING
_SEED = 7


@cache
def _volume() -> torch.Tensor:
    """Periodic Gaussian noise, of unit variance when interpolated, (1, 1, side + 1, ...).

    The first planes are repeated at the end, so that interpolation needs no wrapping.
    """
    generator = np.random.Generator(np.random.Philox(key=[_SEED, 0]))
    noise = generator.standard_normal((_SIDE,) * 3)
    frequency = np.fft.fftfreq(_SIDE)
    response = np.exp(-2 * (np.pi * _SMOOTHING * frequency) ** 2)
    spectrum = np.fft.fftn(noise) * response[:, None, None] * response[:, None] * response
    smooth = np.fft.ifftn(spectrum).real
    neighbours = math.exp(-1 / (2 * _SMOOTHING) ** 2)  # correlation of adjacent voxels
    interpolated = (2 / 3 + neighbours / 3) ** 1.5  # standard deviation left, on average, between voxels
    smooth = (smooth - smooth.mean()) / (smooth.std() * interpolated)
    wrapped = np.pad(smooth, (0, 1), mode="wrap").astype(np.float32)
    return torch.from_numpy(wrapped)[None, None]


def texture_tables(tissues: Sequence[Tissue]) -> np.ndarray:
    """Per tissue: three inverse lengths, 1/mm, and the contrast, dB; (tissues, 4) float32."""
    return np.array([[*(1 / length for length in t.texture_mm), t.texture_contrast_db] for t in tissues], np.float32)


def texture_gain_db(points_mm: torch.Tensor, labels: torch.Tensor, tables: torch.Tensor) -> torch.Tensor:
    """Gain of the scatterers' amplitude, of unit mean power over a tissue.

    g is normal with unit variance; the gain contrast * g has mean power exp(2 a^2), a = contrast ln(10) / 20,
    which is taken off again.

    Parameters
    ----------
    points_mm : (..., 3) float32 tensor
        World coordinates.
    labels : (...) integer tensor
        Index of the tissue.
    tables : (tissues, 4) float32 tensor
        From `texture_tables`.

    Returns
    -------
    (...) float32 tensor, dB
    """
    own = tables[labels]
    contrast = own[..., 3]
    turns = points_mm * own[..., :3] * (_VOXELS_PER_LENGTH / _SIDE)
    turns = turns - turns.floor()
    grid = (2 * turns - 1).flip(-1).reshape(1, 1, 1, -1, 3)
    volume = _volume().to(points_mm)
    g = F.grid_sample(volume, grid, mode="bilinear", padding_mode="border", align_corners=True)
    return contrast * g.reshape(labels.shape) - contrast**2 * (math.log(10) / 20)
