"""From complex lines to grey levels: time-gain compensation, noise floor, logarithm, 8 bits."""

from __future__ import annotations

import numpy as np
import torch

from ablate.ultrasound.point_spread import along_lines
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.settings import ConvexProbe, SimulatorSettings

_KEY = 0x9E3779B97F4A7C15  # keeps the noise apart from the paths' draws
_LARGEST_GAIN_DB = 700.0  # finite as float32, so that silence stays silence; all that is audible is white by then


def time_gain(probe: ConvexProbe, settings: SimulatorSettings) -> np.ndarray:
    """Gain of each sample that makes up for `tgc_db_cm_mhz` on the way there and back, (samples,) float64."""
    depth_cm = sample_depths_mm(probe, settings.axial_samples) / 10
    gain_db = 2 * settings.tgc_db_cm_mhz * probe.frequency_mhz * depth_cm
    return 10 ** (np.minimum(gain_db, _LARGEST_GAIN_DB) / 20)


def receiver_noise(settings: SimulatorSettings, axial: torch.Tensor, seed: int) -> torch.Tensor:
    """Complex Gaussian noise of unit mean power with the pulse's bandwidth.

    Parameters
    ----------
    settings : SimulatorSettings
    axial : (taps,) tensor
        The pulse.
    seed : int
        Of the scatterers; `settings.path_seed` is the other half of the key.

    Returns
    -------
    (2, scanlines, samples) tensor of the type of `axial`
    """
    key = np.array([(settings.path_seed + _KEY) % 2**64, seed % 2**64], np.uint64)  # a list would become float64
    generator = np.random.Generator(np.random.Philox(key=key))
    shape = (2, settings.scanlines, settings.axial_samples)
    white = torch.from_numpy(generator.standard_normal(shape, np.float32)).to(axial)
    return along_lines(white, axial / (2 * axial.square().sum()).sqrt())


def floor_amplitude(settings: SimulatorSettings) -> float:
    """Root mean square of the display's noise, `noise_floor_db` under the reference level."""
    return settings.reference_level * 10 ** (settings.noise_floor_db / 20)


def grey_levels(signal: torch.Tensor, settings: SimulatorSettings) -> torch.Tensor:
    """20 log10 of the envelope against the reference level, `dynamic_range_db` on 0 to 255.

    Parameters
    ----------
    signal : (2, scanlines, samples) tensor
        With gain and noise.
    settings : SimulatorSettings

    Returns
    -------
    (scanlines, samples) tensor, not yet rounded
        Silence, at minus infinity dB, is black whatever the dynamic range.
    """
    power = signal.square().sum(dim=0) / settings.reference_level**2
    level_db = 10 * torch.log10(power)
    return (level_db / settings.dynamic_range_db + 1).clamp_(0, 1).mul_(255)
