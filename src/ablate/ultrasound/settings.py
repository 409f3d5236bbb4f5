"""What a frame is made with besides the probe: the simulator's settings; and the frame itself."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from ablate.setting import check_settings, setting

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


# The largest counts are far beyond any use: what exceeds them is a slip, and would end for want of memory after the
# anatomy is built.
@dataclass(frozen=True)
class SimulatorSettings:
    """How a frame is computed; the defaults are the paper's where it says, else assumed.

    The lateral and the elevational width of the pulse grow with sqrt(1 + ((z - focus_mm) / focal_range_mm)^2). A value
    that is not allowed is a ValueError that names it and what is allowed.
    """

    scanlines: int = setting(192, "Scanlines of a frame.", least=1, most=2**14)
    axial_samples: int = setting(3072, "Samples of a scanline.", least=1, most=2**18)
    rays: int = setting(32, "Rays of a scanline and layer; with `tolerance` the most.", least=1, most=2**20)
    layers: int = setting(3, "Elevational layers, within `layer_extent_mm`.", least=1, most=2**10)
    image_shape: tuple[int, int] = setting(
        (1000, 1386), "Rows and columns of the image.", least=1, most=2**14, unit="px"
    )
    tgc_db_cm_mhz: float = setting(
        0.4, "Time gain, one way; twice this is applied.", least=0, most=1e3, unit="dB/cm/MHz"
    )
    noise_floor_db: float = setting(-55.0, "Level of the amplifier's noise below white.", least=-1e3, most=0, unit="dB")
    dynamic_range_db: float = setting(60.0, "Between black and white.", least=1, most=1e3, unit="dB")
    reference_level: float = setting(0.1, "Amplitude that is shown as white.", least=1e-12, most=1e12)
    axial_fwhm_mm: float = setting(
        0.30, "Length of the pulse, full width at half maximum.", least=1e-6, most=1e3, unit="mm"
    )
    lateral_fwhm_mm: float = setting(
        0.8, "Width of the pulse in the image plane at `focus_mm`.", least=1e-6, most=1e3, unit="mm"
    )
    elevational_fwhm_mm: float = setting(
        2.5, "Width of the pulse across the image plane at `focus_mm`.", least=1e-6, most=1e3, unit="mm"
    )
    focus_mm: float = setting(70.0, "Depth at which rays meet.", least=1e-3, most=1e6, unit="mm")
    focal_range_mm: float = setting(
        40.0, "Distance from the focus at which the pulse is sqrt(2) as wide.", least=1e-3, most=1e6, unit="mm"
    )
    aperture_mm: float = setting(
        0.2, "Half width within which the rays of a scanline start.", least=0, most=1e3, unit="mm"
    )
    elevational_aperture_mm: float = setting(
        1.5, "Half width across the plane within which rays start.", least=0, most=1e3, unit="mm"
    )
    layer_extent_mm: float = setting(
        1.5, "The layers' planes lie within this distance of the image plane.", least=0, most=1e3, unit="mm"
    )
    scatterer_pitch_mm: float = setting(
        0.1, "Distance of neighbours in the lattice of scatterers.", least=1e-6, most=1e3, unit="mm"
    )
    scatterer_level_db: float = setting(
        -50.0,
        "Amplitude of a scatterer of unit variance against the echo of a flat perfect reflector seen face on (assumed: "
        "no source).",
        least=-300,
        most=100,
        unit="dB",
    )
    depth_mode: DepthMode = setting(DepthMode.geometric, "Where an echo is drawn.")
    plan: PlanMode = setting(PlanMode.auto, "Whether what a scene does not need is left out.", incidental=True)
    precision: SimulatorPrecision = setting(SimulatorPrecision.float32, "Floating point of the signal chain.")
    device: str = setting(
        "cpu",
        "Device of the signal chain; `auto` is a GPU if there is one.",
        choices=("auto", "cpu", "cuda"),
        incidental=True,
    )
    path_seed: int = setting(0, "Seed of the Monte-Carlo paths.", least=0)
    tolerance: float | None = setting(
        None,
        "Each scanline of each layer gets as many rays as it needs, `rays` at most, for this root mean square error of "
        "the amplitude shown (0.1 is 0.8 dB); null: all get `rays`.",
        least=1e-4,
        most=10,
    )

    def __post_init__(self) -> None:
        check_settings(self)

    @classmethod
    def low_quality(cls, **changes: object) -> SimulatorSettings:
        """Settings of the low-quality image L: one ray, one layer, and `changes`."""
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
