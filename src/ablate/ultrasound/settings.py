"""What a frame is made with: the probe, the simulator's settings, and the frame itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np


class Plan(StrEnum):
    """Whether the simulator leaves out what a scene does not need."""

    auto = "auto"
    full = "full"


class DepthMode(StrEnum):
    """Where an echo is drawn: at its path length, or at its travel time shown at 1540 m/s."""

    geometric = "geometric"
    time_of_flight = "time_of_flight"


@dataclass(frozen=True)
class ConvexProbe:
    """A curved array; with these defaults the fan's bounding box is 217.96 x 157.23 mm.

    Attributes
    ----------
    radius_mm : float
        Radius of curvature of the face.
    fov_deg : float
        Opening angle of the fan.
    depth_mm : float
        Imaging depth from the face.
    frequency_mhz : float
        Frequency that attenuation is computed at.
    """

    radius_mm: float = 40.0
    fov_deg: float = 70.0
    depth_mm: float = 150.0
    frequency_mhz: float = 8.0


@dataclass(frozen=True)
class SimulatorSettings:
    """How a frame is computed; the defaults are the paper's.

    `axial_fwhm_mm`, `lateral_fwhm_mm`, `elevational_fwhm_mm` are the pulse's full widths at half maximum at
    `focus_mm`; the last two grow with sqrt(1 + ((z - focus_mm) / focal_range_mm)^2).
    `scatterer_level_db` is the amplitude of a scatterer of unit variance against the echo of a flat perfect
    reflector seen face on (assumed: no source).
    """

    scanlines: int = 192
    axial_samples: int = 3072
    rays: int = 32
    layers: int = 3
    image_shape: tuple[int, int] = (1000, 1386)
    tgc_db_cm_mhz: float = 0.4
    noise_floor_db: float = -55.0
    dynamic_range_db: float = 60.0
    reference_level: float = 1.0
    axial_fwhm_mm: float = 0.30
    lateral_fwhm_mm: float = 0.8
    elevational_fwhm_mm: float = 2.5
    focus_mm: float = 70.0
    focal_range_mm: float = 40.0
    scatterer_pitch_mm: float = 0.1
    scatterer_level_db: float = -30.0
    depth_mode: DepthMode = DepthMode.geometric
    plan: Plan = Plan.auto
    device: str = "cpu"
    path_seed: int = 0

    @classmethod
    def low_quality(cls, **changes: object) -> SimulatorSettings:
        """Settings of the low-quality image L: one ray, one layer; everything else as in `changes`."""
        return replace(cls(**changes), rays=1, layers=1)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Frame:
    """One simulated frame; (H, W) is `SimulatorSettings.image_shape`.

    Attributes
    ----------
    segmentation : (H, W) uint8
        0 outside the fan, i + 1 for `scene.tissues[i]`.
    attenuation : (H, W) float32 in [0, 1]
        The integral attenuation map.
    image : (H, W) uint8
        B-mode grey levels.
    mask : (H, W) bool
        The fan; equal to `segmentation > 0`.
    envelope : (axial samples, scanlines) float32
        Linear envelope before TGC, noise floor and log.
    """

    segmentation: np.ndarray
    attenuation: np.ndarray
    image: np.ndarray
    mask: np.ndarray
    envelope: np.ndarray
