"""What a frame is made with besides the probe: the simulator's settings; and the frame itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ablate.validation import check_count, check_number, coerce_enums

#: Part of every data set's identity: raise it when the same settings give another image.
SIMULATOR_VERSION = 4


class PlanMode(StrEnum):
    """Whether the simulator leaves out what a scene does not need."""

    auto = "auto"
    full = "full"


class DepthMode(StrEnum):
    """Where an echo is drawn: at its path length, or at its travel time shown at 1540 m/s."""

    geometric = "geometric"
    time_of_flight = "time_of_flight"


class SimulatorPrecision(StrEnum):
    """Floating point of the signal chain; rays and their crossings are float32, as Embree is."""

    float32 = "float32"
    float64 = "float64"


@dataclass(frozen=True)
class SimulatorSettings:
    """How a frame is computed; the defaults are the paper's where it says, else assumed.

    `axial_fwhm_mm`, `lateral_fwhm_mm`, `elevational_fwhm_mm` are the pulse's full widths at half maximum at
    `focus_mm`; the last two grow with sqrt(1 + ((z - focus_mm) / focal_range_mm)^2).
    Rays of a scanline start within `aperture_mm` and `elevational_aperture_mm` (half widths) of its element and
    meet at `focus_mm`; the layers' planes lie within `layer_extent_mm` of the image plane.
    `scatterer_level_db` is the amplitude of a scatterer of unit variance against the echo of a flat perfect
    reflector seen face on (assumed: no source), and `reference_level` the amplitude shown as white.
    With `tolerance` each scanline of each layer gets as many rays as it needs, `rays` at most, for a root mean square
    error of the amplitude shown of `tolerance` (0.1 is 0.8 dB). None: all get `rays`.

    Raises
    ------
    ValueError
        When a value is not finite or outside its range; the message names it.
    """

    scanlines: int = 192
    axial_samples: int = 3072
    rays: int = 32
    layers: int = 3
    image_shape: tuple[int, int] = (1000, 1386)
    tgc_db_cm_mhz: float = 0.4
    noise_floor_db: float = -55.0
    dynamic_range_db: float = 60.0
    reference_level: float = 0.1
    axial_fwhm_mm: float = 0.30
    lateral_fwhm_mm: float = 0.8
    elevational_fwhm_mm: float = 2.5
    focus_mm: float = 70.0
    focal_range_mm: float = 40.0
    aperture_mm: float = 0.2
    elevational_aperture_mm: float = 1.5
    layer_extent_mm: float = 1.5
    scatterer_pitch_mm: float = 0.1
    scatterer_level_db: float = -50.0
    depth_mode: DepthMode = DepthMode.geometric
    plan: PlanMode = PlanMode.auto
    precision: SimulatorPrecision = SimulatorPrecision.float32
    device: str = "cpu"
    path_seed: int = 0
    tolerance: float | None = None

    def __post_init__(self) -> None:
        for name, most in _MOST.items():
            check_count(name, getattr(self, name), 1, most)
        check_count("path_seed", self.path_seed, 0)
        if len(tuple(self.image_shape)) != 2:
            raise ValueError(f"image_shape must be two counts (rows, columns), not {self.image_shape!r}")
        for count in self.image_shape:
            check_count("image_shape", count, 1, _MOST_PIXELS)
        object.__setattr__(self, "image_shape", tuple(int(n) for n in self.image_shape))
        if self.tolerance is not None:
            check_number("tolerance", self.tolerance, 1e-4, 10.0)
        for name, (lower, upper) in _RANGES.items():
            check_number(name, getattr(self, name), lower, upper)
        coerce_enums(self)

    @classmethod
    def low_quality(cls, **changes: object) -> SimulatorSettings:
        """Settings of the low-quality image L: one ray, one layer, and `changes`."""
        return replace(cls(**changes), rays=1, layers=1)  # type: ignore[arg-type]


# Far beyond any use: what exceeds them is a slip, and would end for want of memory after the anatomy is built.
_MOST = {"scanlines": 2**14, "axial_samples": 2**18, "rays": 2**20, "layers": 2**10}
_MOST_PIXELS = 2**14
_RANGES = {
    "tgc_db_cm_mhz": (0.0, 1e3),
    "noise_floor_db": (-1e3, 0.0),
    "dynamic_range_db": (1.0, 1e3),
    "reference_level": (1e-12, 1e12),
    "axial_fwhm_mm": (1e-6, 1e3),
    "lateral_fwhm_mm": (1e-6, 1e3),
    "elevational_fwhm_mm": (1e-6, 1e3),
    "focus_mm": (1e-3, 1e6),
    "focal_range_mm": (1e-3, 1e6),
    "aperture_mm": (0.0, 1e3),
    "elevational_aperture_mm": (0.0, 1e3),
    "layer_extent_mm": (0.0, 1e3),
    "scatterer_pitch_mm": (1e-6, 1e3),
    "scatterer_level_db": (-300.0, 100.0),
}


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
