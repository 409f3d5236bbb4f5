"""From what rays bring back to the B-mode image: gain, noise, logarithm, grey levels, rows, controls."""

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ablate.anatomy import Tissue
from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays, compiled
from ablate.ultrasound.imaging.compounding import shares, steered_sets
from ablate.ultrasound.imaging.point_spread import LINES_OF_A_PART, along_lines, blur, point_spread
from ablate.ultrasound.imaging.speckle import Lines, Speckle
from ablate.ultrasound.scan_conversion import ScanConverter
from ablate.ultrasound.settings import MOST_GAIN_DB, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.time_gain import time_gain_db

_KEY = 0x9E3779B97F4A7C15  # keeps the noise apart from the paths' draws
_LARGEST_GAIN_DB = 700.0  # finite as float32, so that 0 stays 0; every echo is white by then


@dataclass(frozen=True)
class Display:
    """The controls of a scanner's picture; with these defaults the picture is that of the settings.

    `gain_db` is added everywhere. `tgc_db` is added by depth: its values stand at equal distances from the face to the
    deepest sample, and between them it is linear. Noise is amplified as the echoes are. `dynamic_range_db` replaces
    that of the settings.

    Raises
    ------
    ValueError
        When a value is not finite or outside its range; the message names it.
    """

    gain_db: float = 0.0
    tgc_db: tuple[float, ...] = ()
    dynamic_range_db: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "tgc_db", tuple(float(value) for value in self.tgc_db))
        for name, value in (("gain_db", self.gain_db), *(("tgc_db", value) for value in self.tgc_db)):
            if not abs(value) <= MOST_GAIN_DB:  # NaN too
                raise ValueError(f"{name}={value:g}: allowed are numbers from {-MOST_GAIN_DB:g} to {MOST_GAIN_DB:g}")
        self.applied_to(SimulatorSettings())  # which checks the range

    def gain_at(self, depth: np.ndarray) -> np.ndarray:
        """What is added at shares of the imaging depth, an array of any shape with values in [0, 1]; dB."""
        if not self.tgc_db:
            return np.full(np.shape(depth), self.gain_db)
        return self.gain_db + np.interp(depth, np.linspace(0, 1, len(self.tgc_db)), self.tgc_db)

    def applied_to(self, settings: SimulatorSettings) -> SimulatorSettings:
        """Settings with this dynamic range; a ValueError when the range is not allowed."""
        if self.dynamic_range_db is None:
            return settings
        return replace(settings, dynamic_range_db=self.dynamic_range_db)

    def shown(self, image: np.ndarray, depth: np.ndarray, settings: SimulatorSettings) -> np.ndarray:
        """Apply the controls to a finished image, (H, W) uint8, that was made with other controls, the settings' own.

        `depth`, (H, W), is the share of the imaging depth of each pixel. What was clipped to black or white stays
        clipped, so this is right only between them; outside the fan, where `image` is 0, it stays black.
        """
        level_db = (image / 255.0 - 1) * settings.dynamic_range_db + self.gain_at(depth)
        grey = 255 * np.clip(level_db / self.applied_to(settings).dynamic_range_db + 1, 0, 1)
        return np.where(image > 0, np.rint(grey), 0).astype(np.uint8)


@compiled
def _received(
    given: Arrays, shift: tuple[int, int], gain: np.ndarray, floor: float, made: Arrays, begin: int, end: int
) -> None:
    """Fill some scanlines of what is `made`: the envelope, and the power with noise and gain, (scanlines, samples).

    Given are signal, which is overwritten, and noise, real and imaginary part, (2, scanlines, samples). Reverberation,
    given as (scanlines or 0, samples), comes from all sides, hence with random phases, which are not the amplifier's
    noise at the same place. That is of rms `floor` before the `gain`, (samples,), which makes white 1.
    """
    (signal, clutter, noise), (envelope, power) = given, made
    lines, samples = power.shape
    shifted = np.empty((4, samples), noise.dtype)
    for line in range(begin, end):
        for row in range(4):  # both parts of the amplifier's noise, then of that of reverberation
            first = (shift[1] + (row // 2) * (samples // 2)) % samples
            from_line = noise[row % 2, (line + shift[0] + (row // 2) * (lines // 2)) % lines]
            shifted[row, : samples - first], shifted[row, samples - first :] = from_line[first:], from_line[:first]
        real, imaginary = signal[0, line], signal[1, line]
        if len(clutter):
            for sample in range(samples):
                real[sample] += clutter[line, sample] * shifted[2, sample]
                imaginary[sample] += clutter[line, sample] * shifted[3, sample]
        for sample in range(samples):
            a, b = real[sample], imaginary[sample]
            envelope[line, sample] = math.sqrt(a * a + b * b)
            a, b = (a + floor * shifted[0, sample]) * gain[sample], (b + floor * shifted[1, sample]) * gain[sample]
            power[line, sample] = a * a + b * b


def grey_levels(power: np.ndarray, range_db: float) -> None:
    """Change power, 1 of white, into levels from 0 to 255, not yet rounded; no signal is black whatever the range."""
    with np.errstate(divide="ignore"):
        np.log(power, out=power)  # four times as fast as log10 without AVX-512
    power *= 10 / (math.log(10) * range_db)
    power += 1
    np.clip(power, 0, 1, out=power)
    power *= 255


def means_of_rows(lines: np.ndarray, settings: SimulatorSettings) -> np.ndarray:
    """The mean of the samples of each row, (rows, scanlines), of values (scanlines, samples)."""
    each = min(settings.samples_per_row, lines.shape[1])  # divides the number of samples, as settings are checked
    return np.asarray(np.mean([lines[:, first::each] for first in range(each)], axis=0)).T


@dataclass(frozen=True)
class Prepared:
    """The scanlines and what rays bring back on them, for images with any number of seeds."""

    lines: Lines  # of `Speckle.insonify`
    sets: tuple["Returned", ...]  # of each of `SignalChain.sets`


@dataclass(frozen=True)
class Returned:
    """What rays of one set of scanlines bring back, on those of the frame; echoes are amplitudes at the receiver."""

    level_db: np.ndarray  # (groups, nodes)
    surfaces: np.ndarray  # (scanlines, samples); of steered scanlines after the pulse
    clutter: np.ndarray  # reverberation after the pulse, (scanlines, samples), or (0, samples) where there is none


class SignalChain:
    """Makes images of what rays bring back, for one probe and one set of settings, on `settings.device`."""

    def __init__(self, tissues: Sequence[Tissue], probe: Probe, settings: SimulatorSettings) -> None:
        self.tissues, self.probe, self.settings = tuple(tissues), probe, settings
        self.dtype: torch.dtype = getattr(torch, settings.precision.value)
        self.convert = ScanConverter(probe, settings.beam_shape, settings.image_shape)
        self.spread = point_spread(probe, settings, self.dtype)
        self.sets = steered_sets(probe, settings)
        turns_rad = [one.turn_rad for one in self.sets]
        self.speckle = Speckle(tissues, probe, settings, getattr(np, settings.precision.value), turns_rad)
        self._range_mm = np.minimum([one.range_mm for one in self.sets], probe.depth_mm)
        gain_db = np.minimum(time_gain_db(self._range_mm, probe, settings.time_gain), _LARGEST_GAIN_DB)
        self._gain = 10 ** (gain_db / 20)  # of each set's samples, two-way, by how far they are along their scanlines
        self._shares = shares(self.sets)
        self._noise: tuple[int, np.ndarray] | None = None

    def noise(self, pose: np.ndarray, seed: int) -> tuple[np.ndarray, list[tuple[int, int]]]:
        """Complex Gaussian noise of unit mean power with the pulse's bandwidth, (2, scanlines, samples).

        It follows `path_seed` and the scatterers' seed. Also by how many scanlines and samples a frame is to shift it,
        a hash of the pose, so that frames share no pattern; of each set of scanlines.
        """
        kept = self._noise  # looked at once: threads may render other seeds
        if kept is None or kept[0] != seed:
            keys = (self.settings.path_seed + _KEY) % 2**64, int(seed) % 2**64  # Python's numbers: no overflow
            numbers = np.array(keys, np.uint64)  # as a list they would become float64
            generator, axial = np.random.Generator(np.random.Philox(key=numbers)), self.spread.axial
            shape = (2, self.settings.scanlines, self.settings.axial_samples)
            white = torch.from_numpy(generator.standard_normal(shape, np.float32)).to(axial)
            kept = self._noise = seed, along_lines(white, axial / (2 * axial.square().sum()).sqrt()).cpu().numpy()
        salts = (one.number.to_bytes(1, signed=True) if one.number else b"" for one in self.sets)
        keys_of_sets = [zlib.crc32(pose.tobytes() + salt) for salt in salts]
        return kept[1], [(key % 65521, key // 7) for key in keys_of_sets]

    def reverberation(self, clutter: np.ndarray, pose: np.ndarray, seed: int) -> np.ndarray:
        """Reverberation of the frame's own scanlines with the phases that its image has, (scanlines, samples) complex.

        `clutter` is that of `Returned`; pose and seed are those of `image`.
        """
        noise, shifts = self.noise(pose, seed)
        if not len(clutter):
            return np.zeros(noise.shape[1:], np.complex64)
        shift = shifts[len(shifts) // 2]
        by = [-(first + count // 2) for first, count in zip(shift, clutter.shape, strict=True)]
        real, imaginary = np.roll(noise, by, axis=(1, 2))
        return clutter * (real + 1j * imaginary)

    def image(
        self, prepared: Prepared | None, pose: np.ndarray, seed: int, display: Display | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The picture of what rays bring back, or of nothing, and its envelope, as `shown` gives them.

        Parameters
        ----------
        prepared : Prepared or None
            What rays have brought back at the pose; None where nothing can.
        pose : (4, 4) float
            From probe to world; the noise depends on it.
        seed : int
            Of the scatterers and of the noise.
        display : Display, optional
            What an operator sets of the picture.
        """
        signals = [self._signal(prepared, number, seed) for number in range(len(self.sets))]
        return self.shown(signals, pose, seed, display)

    def shown(
        self,
        signals: Sequence[tuple[np.ndarray, np.ndarray]],
        pose: np.ndarray,
        seed: int,
        display: Display | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Detect, amplify and compress signals, and average them.

        The receiver's noise has one level before the gain: it is seen where the gain is large, deep and in fluid.

        Parameters
        ----------
        signals : sequence of two arrays
            Of each of `sets`: the signal, (2, scanlines, samples), which is overwritten, and the reverberation,
            (scanlines or 0, samples).
        pose : (4, 4) float
            From probe to world; the noise depends on it.
        seed : int
            Of the noise.
        display : Display, optional
            What an operator sets of the picture.

        Returns
        -------
        picture : (rows, scanlines) uint8
            A row is the mean grey level of `samples_per_row` samples.
        envelope : (scanlines, samples) float
            Its amplitude before the gain.
        """
        settings, (noise, shifts) = self.settings, self.noise(pose, seed)
        gain = self._gain / settings.reference_level
        floor = 10 ** (settings.noise_level_db / 20)  # rms
        if display is not None:
            gain = gain * 10 ** (display.gain_at(self._range_mm / self.probe.depth_mm) / 20)
            settings = display.applied_to(settings)
        envelope, grey = np.zeros((2, *noise.shape[1:]), noise.dtype)
        envelope_of_one, power_of_one = (
            np.empty_like(envelope) if len(signals) > 1 else part for part in (envelope, grey)
        )
        picture = np.empty(settings.beam_shape, np.uint8)

        def show_lines(begin: int, end: int) -> None:
            some = slice(begin, end)
            for number, (signal, shift) in enumerate(zip(signals, shifts, strict=True)):
                _received((*signal, noise), shift, gain[number], floor, (envelope_of_one, power_of_one), begin, end)
                if len(signals) > 1:
                    envelope[some] += self._shares[number][some] * envelope_of_one[some]
                    grey[some] += self._shares[number][some] * np.sqrt(power_of_one[some])
            if len(signals) > 1:
                np.square(grey[some], out=grey[some])
            grey_levels(grey[some], settings.dynamic_range_db)
            picture[:, some] = np.rint(means_of_rows(grey[some], settings))

        stage(Stage.grey_levels)(in_parts)(show_lines, len(grey), LINES_OF_A_PART)
        return picture, envelope

    def _signal(self, prepared: Prepared | None, number: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """The signal of a set, (2, scanlines, samples), and its reverberation, (scanlines or 0, samples)."""
        if prepared is None:
            shape, dtype = (2, self.settings.scanlines, self.settings.axial_samples), self.speckle.dtype
            return np.zeros(shape, dtype), np.empty((0, shape[2]), dtype)
        one, returned = self.sets[number], prepared.sets[number]
        insonified = self.speckle.insonify(prepared.lines, returned.level_db, seed)
        scatterers = self.speckle(insonified, seed, one.turn_rad)
        if not one.number:
            return blur(scatterers, returned.surfaces, self.spread), returned.clutter
        signal = blur(scatterers, None, self.spread, one.shift)
        signal[0] += returned.surfaces
        return signal, returned.clutter

    def returned(self, number: int, level_db: np.ndarray, surfaces: np.ndarray, clutter: np.ndarray) -> Returned:
        """What rays of a set bring back on its own scanlines, on those of the frame.

        Echoes of surfaces have the pulse before they are interpolated: those of a tilted surface do not add up else.

        Parameters
        ----------
        number : int
            Of the set in `sets`.
        level_db : (groups, nodes) float
            The illumination.
        surfaces : (scanlines, samples) float
            Echoes of surfaces.
        clutter : (scanlines or 0, samples) float
            Reverberation.
        """
        one = self.sets[number]
        if not one.number:
            return Returned(level_db, surfaces, clutter)
        if surfaces.any():
            surfaces = blur(np.zeros((1, *surfaces.shape)), surfaces, self.spread, one.shift)[0]
        return Returned(one.level(level_db), one.taken(surfaces), one.taken(clutter))
