"""From what the rays of a pose bring back to its image, on a CPU or a GPU; neither Embree nor Numba is needed."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ablate.anatomy import Tissue
from ablate.ultrasound.imaging.bmode import Display, ScanConverter, grey_levels, receiver_noise, time_gain
from ablate.ultrasound.imaging.point_spread import blur, point_spread
from ablate.ultrasound.imaging.speckle import InsonifiedLines, Speckle
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.probe_kinds import Probe
from ablate.ultrasound.settings import SimulatorSettings

_CLUTTER_ROLL = (61, 1021)  # lines and samples between the noise of the display and that of clutter


@dataclass(frozen=True)
class Received:
    """What the rays of a pose bring back, for groups = layers * scanlines; no scatterers' seed is in it."""

    starts: np.ndarray  # (groups, 3) float64, of the scanlines in world coordinates, mm
    directions: np.ndarray  # (groups, 3) float64
    labels: np.ndarray  # (groups, samples) uint8, the tissues of the samples
    ranges_mm: np.ndarray  # (samples,) or (groups, samples), along its line to what a sample displays
    level_db: np.ndarray  # (groups, nodes) float32, the illumination from the first sample to the last
    surfaces: np.ndarray  # (scanlines, samples) float64, echoes of surfaces
    clutter: np.ndarray | None  # (scanlines, samples) float64, reverberation, amplitude at the receiver


@dataclass(frozen=True)
class Prepared:
    """The same as tensors on the device that makes images of it, with any number of seeds."""

    insonified: InsonifiedLines
    surfaces: torch.Tensor  # (scanlines, samples)
    clutter: torch.Tensor | None  # (scanlines, samples)


class SignalChain:
    """Makes images of what rays bring back, for one probe and one set of settings, on `settings.device`."""

    def __init__(self, tissues: Sequence[Tissue], probe: Probe, settings: SimulatorSettings) -> None:
        self.probe, self.settings = probe, settings
        dtype = getattr(torch, settings.precision.value)
        self.convert = ScanConverter(probe, settings, dtype)
        self.spread = point_spread(probe, settings, dtype)
        self.speckle = Speckle(tissues, probe, settings, dtype)
        self.gain = torch.from_numpy(time_gain(probe, settings)).to(settings.device, dtype)
        self._noise: tuple[int, torch.Tensor] | None = None

    def tensor(self, values: np.ndarray) -> torch.Tensor:
        """An array as the chain computes with it."""
        return torch.from_numpy(values).to(self.gain)

    def prepare(self, received: Received) -> Prepared:
        """What does not depend on the scatterers' seed."""
        level = torch.from_numpy(received.level_db)
        lines = received.starts, received.directions, received.labels, received.ranges_mm
        insonified = self.speckle.insonify(*lines, level)
        clutter = None if received.clutter is None else self.tensor(received.clutter) * self.spread.axial.sum()
        return Prepared(insonified, self.tensor(received.surfaces), clutter)

    def noise(self, pose: np.ndarray, seed: int) -> torch.Tensor:
        """The seed's noise, (2, scanlines, samples), rolled by a hash of the pose so that frames share no pattern."""
        if self._noise is None or self._noise[0] != seed:
            self._noise = seed, receiver_noise(self.settings, self.spread.axial, seed)
        key = zlib.crc32(pose.tobytes())
        return self._noise[1].roll((key % 65521, key // 7), dims=(1, 2))

    def signal(self, prepared: Prepared, seed: int, noise: torch.Tensor) -> torch.Tensor:
        """The signal received, (2, scanlines, samples): real and imaginary part."""
        signal = blur(self.speckle(prepared.insonified, seed), prepared.surfaces, self.spread)
        if prepared.clutter is not None:  # received from all sides, hence with random phases
            signal.addcmul_(prepared.clutter, noise.roll(_CLUTTER_ROLL, dims=(1, 2)))
        return signal

    def image(self, signal: torch.Tensor, noise: torch.Tensor, display: Display | None = None) -> np.ndarray:
        """The picture of a signal, (H, W) uint8; the signal is overwritten. The operator's gain amplifies the noise."""
        settings = self.settings
        floor = settings.reference_level * 10 ** (settings.noise_floor_db / 20)  # root mean square
        shown = signal.mul_(self.gain).add_(noise, alpha=floor)
        if display is not None:
            depth_mm = sample_depths_mm(self.probe, settings.axial_samples)
            shown.mul_(self.tensor(10 ** (display.gain_at(depth_mm / self.probe.depth_mm) / 20)))
            settings = display.applied_to(settings)
        return np.rint(self.convert(grey_levels(shown, settings))).astype(np.uint8)
