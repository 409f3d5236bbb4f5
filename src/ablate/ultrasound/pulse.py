"""The widths of the pulse: as they are set, or as frequency, bandwidth and apertures make them.

They are decided here and nowhere else.
"""

import math
from typing import NamedTuple

from ablate.ultrasound.media import DISPLAY_SPEED_M_S
from ablate.ultrasound.probe import pixel_size_mm
from ablate.ultrasound.settings import PhasedProbe, Probe, SimulatorSettings

_GAUSSIAN = 4 * math.log(2) / math.pi  # duration times bandwidth of a Gaussian pulse, both at half of the amplitude
_BOTH_WAYS = 0.886  # full width of sin(x)^2 / x^2 at half maximum, in wavelengths times f-number
_PIXELS = 2  # nothing finer is seen


class PulseWidths(NamedTuple):
    """Full widths at half maximum, mm, of the amplitude; across the pulse they are those at `focus_mm`."""

    axial_mm: float
    lateral_mm: float
    elevational_mm: float


def pulse_widths(probe: Probe, settings: SimulatorSettings) -> PulseWidths:
    """The widths of a frame's pulse: each as it is set, or else physical, but no finer than two pixels.

    Across the image plane, where there are no pixels, it is always the physical one.
    """
    own = physical_widths(probe, settings)
    height_mm, width_mm = pixel_size_mm(probe, settings.image_shape)
    seen = max(own.axial_mm, _PIXELS * height_mm), max(own.lateral_mm, _PIXELS * width_mm), own.elevational_mm
    pairs = zip(_set_widths(settings), seen, strict=True)
    return PulseWidths(*(seen_mm if set_mm is None else set_mm for set_mm, seen_mm in pairs))


def physical_widths(probe: Probe, settings: SimulatorSettings) -> PulseWidths:
    """What frequency, bandwidth and apertures make of a pulse, whatever is set and however large pixels are.

    A Gaussian of the bandwidth B at half of the amplitude lasts 4 ln 2 / (pi B), and half of it is its length in the
    image, as sound goes there and back. A beam that goes both ways through one aperture is 0.886 wavelengths times the
    f-number wide (Szabo, Diagnostic Ultrasound Imaging, 2014, ch. 6 and 7).
    """
    wavelength_mm = DISPLAY_SPEED_M_S / 1e3 / probe.frequency_mhz
    return PulseWidths(
        wavelength_mm / 2 * _GAUSSIAN / settings.bandwidth,
        _BOTH_WAYS * wavelength_mm * _f_number(probe, settings),
        _BOTH_WAYS * wavelength_mm * settings.focus_mm / settings.element_height_mm,
    )


def _f_number(probe: Probe, settings: SimulatorSettings) -> float:
    """The f-number at `focus_mm`: of all elements of a phased probe, else of those that see a point."""
    if isinstance(probe, PhasedProbe):
        return max(settings.focus_mm / probe.aperture_mm, 1.0)
    if settings.active_aperture_mm == 0:  # `check_probe` refuses it where the width is used
        return math.inf
    return max(settings.focus_mm / settings.active_aperture_mm, settings.f_number)


def pulse_in_words(probe: Probe, settings: SimulatorSettings) -> str:
    """The widths of a frame's pulse and where they come from, in one line."""
    widths, own = pulse_widths(probe, settings), physical_widths(probe, settings)
    places = "along", f"across at {settings.focus_mm:g} mm", "out of the plane"
    parts = []
    for place, width_mm, own_mm, set_mm in zip(places, widths, own, _set_widths(settings), strict=True):
        finer = f" (two pixels; of a finer image {own_mm:.2f} mm)" if width_mm > own_mm else ""
        parts.append(f"{width_mm:.2f} mm {place}{finer if set_mm is None else ', as set'}")
    return f"pulse of {probe.frequency_mhz:g} MHz: {'; '.join(parts)}"


def _set_widths(settings: SimulatorSettings) -> tuple[float | None, float | None, float | None]:
    return settings.axial_fwhm_mm, settings.lateral_fwhm_mm, settings.elevational_fwhm_mm
