"""From scanlines to the fan."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch.nn import functional as F

from ablate.ultrasound.probe import fan_mask, pixel_polar
from ablate.ultrasound.settings import ConvexProbe, SimulatorSettings


class ScanConverter:
    """Bilinear interpolation from scanlines to pixels; where to read is computed once.

    Parameters
    ----------
    probe : ConvexProbe
    settings : SimulatorSettings
    dtype : torch.dtype

    Attributes
    ----------
    mask : (H, W) bool
        The fan.
    """

    def __init__(self, probe: ConvexProbe, settings: SimulatorSettings, dtype: torch.dtype) -> None:
        self.mask = fan_mask(probe, settings.image_shape)
        depth, angle = (polar[self.mask] for polar in pixel_polar(probe, settings.image_shape))
        lines, samples = settings.scanlines, settings.axial_samples
        sample = depth * (samples / probe.depth_mm) - 0.5
        along = 2 * sample / max(samples - 1, 1) - 1
        across = angle / (math.radians(probe.fov_deg) / 2) if lines > 1 else np.zeros_like(angle)
        grid = torch.from_numpy(np.stack([along, across], axis=-1))
        self._grid = grid.to(settings.device, dtype)[None, None]

    def __call__(self, lines: torch.Tensor) -> np.ndarray:
        """A polar image (scanlines, samples) in the fan; 0 outside, (H, W) float32."""
        pixels = F.grid_sample(
            lines[None, None], self._grid, mode="bilinear", padding_mode="border", align_corners=True
        )
        image = np.zeros(self.mask.shape, np.float32)
        image[self.mask] = pixels.flatten().cpu().numpy()
        return image
