"""The formula: a B-mode image in closed form from the tissue and the sound at each point, without rays or weights.

It is what a network has to beat: whatever it renders worse than this was not worth a training.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.ndimage import grey_opening

from ablate.anatomy import Tissue
from ablate.ultrasound.imaging.bmode import grey_levels, means_of_rows
from ablate.ultrasound.imaging.point_spread import along_lines, blur, point_spread
from ablate.ultrasound.probe import sample_depths_mm
from ablate.ultrasound.settings import Probe, SimulatorPrecision, SimulatorSettings
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport.surface_maps import ECHO_DB, LIGHT_DB

#: Part of what its kept scores are known by: raise it when the same maps give another image.
FORMULA_VERSION = 2
_VALUES_OF_A_ROW = 2  # as the lattice of scatterers has
_HAZE_ROWS = 9  # an echo that is longer than these comes from reverberation, which has random phases
_SILENT_DB = -300.0


@dataclass(frozen=True)
class Insonified:
    """What the formula reads of a frame in beam space."""

    labels: np.ndarray  # (rows, scanlines) uint8, 1 for the first tissue, 0 outside the fan
    sound_db: np.ndarray  # (rows, scanlines) float: what reaches a point and returns, with the time gain; two-way
    echo: np.ndarray | None = None  # (rows, scanlines) float: amplitude of surface echoes, 1 of white
    grain: np.ndarray | None = None  # (rows, scanlines, 2) complex: the lattice of scatterers; None: white noise


class Formula:
    """Renders images of one probe and one set of settings in closed form.

    The level of the tissue's scatterers times the sound that reaches them times white noise, plus the echoes of
    surfaces, through the point spread function, plus the amplifier's noise, compressed: the simulator's own chain, fed
    with maps in place of rays.

    Parameters
    ----------
    tissues : sequence of Tissue
        Behind the labels 1, 2, ...
    probe : Probe
        Its scanlines.
    settings : SimulatorSettings
        Those of the simulation; there is no slow texture, and all layers are one.
    """

    def __init__(self, tissues: Sequence[Tissue], probe: Probe, settings: SimulatorSettings) -> None:
        rows = settings.beam_shape[0]
        each = min(settings.samples_per_row, _VALUES_OF_A_ROW)
        self.settings = settings = replace(
            settings,
            axial_samples=each * rows,
            samples_per_row=each,
            device="cpu",
            precision=SimulatorPrecision.float32,
        )
        self._spread = point_spread(probe, settings, torch.float32)
        white_db = 20 * np.log10(settings.reference_level)
        power = np.array([tissue.scatter_power for tissue in tissues])
        own_db = 10 * np.log10(power, where=power > 0, out=np.full(len(power), _SILENT_DB))
        self._level_db = np.append(_SILENT_DB, own_db + settings.scatterer_level_db - white_db)  # by label
        gain_db = time_gain_db(sample_depths_mm(probe, settings.axial_samples), probe, settings.time_gain)
        self._gain_of_rows_db = time_gain_db(sample_depths_mm(probe, rows), probe, settings.time_gain)[:, None]
        self._floor = 10 ** ((settings.noise_level_db - white_db + gain_db) / 20)

    def insonified(self, maps: Mapping[str, np.ndarray]) -> Insonified:
        """What maps of a frame in beam space, as `Pairs.read` gives them, tell the formula.

        `illumination` is taken before `attenuation`, both (rows, scanlines); `interfaces` and `grain` may be missing.
        """
        if "illumination" in maps:
            sound_db = _decibels(maps["illumination"], LIGHT_DB)
        else:
            with np.errstate(divide="ignore"):
                sound_db = 40 * np.log10(maps["attenuation"]) + self._gain_of_rows_db
        echo = 10 ** (_decibels(maps["interfaces"], ECHO_DB) / 20) if "interfaces" in maps else None
        return Insonified(maps["segmentation"], sound_db, echo, maps.get("grain"))

    def __call__(self, frame: Insonified, seed: int) -> np.ndarray:
        """Render a frame in beam space, (rows, scanlines) uint8; `seed` is of all noise that is not given.

        It is 0 outside the fan. A label without a tissue is a ValueError.
        """
        if int(frame.labels.max(initial=0)) >= len(self._level_db):
            raise ValueError(f"a label is {frame.labels.max()}, and there are {len(self._level_db) - 1} tissues")
        random = np.random.default_rng(seed)
        each = self.settings.samples_per_row
        amplitude = 10 ** ((self._level_db[frame.labels] + frame.sound_db) / 20)
        if frame.grain is None:
            white = random.standard_normal((2, *self._samples(amplitude).shape)) / np.sqrt(2)
        else:
            lattice = frame.grain[..., :each].transpose(1, 0, 2).reshape(frame.labels.shape[1], -1)
            white = np.stack([lattice.real, lattice.imag])
        scattered = (white * self._samples(amplitude)).astype(np.float32)
        echo = np.zeros_like(amplitude) if frame.echo is None else frame.echo
        haze = grey_opening(echo, (_HAZE_ROWS, 1))
        direct = np.sqrt(np.maximum(echo**2 - haze**2, 0)) / each  # shared by the samples of a row
        signal = blur(scattered, np.ascontiguousarray(self._samples(direct), np.float32), self._spread)
        signal += self._band_limited(random) * self._samples(haze)
        signal += self._band_limited(random) * self._floor
        power = np.square(signal, dtype=np.float64).sum(axis=0)
        grey_levels(power, self.settings.dynamic_range_db)
        return np.where(frame.labels > 0, np.rint(means_of_rows(power, self.settings)), 0).astype(np.uint8)

    def _samples(self, values: np.ndarray) -> np.ndarray:
        """Values of rows, (rows, scanlines), at samples, (scanlines, samples)."""
        return np.repeat(values.T, self.settings.samples_per_row, axis=1)

    def _band_limited(self, random: np.random.Generator) -> np.ndarray:
        """Complex noise of unit mean power with the pulse's bandwidth, (2, scanlines, samples) float32."""
        shape = (2, self.settings.scanlines, self.settings.axial_samples)
        axial = self._spread.axial
        white = torch.from_numpy(random.standard_normal(shape, np.float32))
        return along_lines(white, axial / (2 * axial.square().sum()).sqrt()).numpy()


def _decibels(shares: np.ndarray, zero_and_one_db: tuple[float, float]) -> np.ndarray:
    """Levels of a map of surfaces, of which 0 is silence."""
    zero_db, one_db = zero_and_one_db
    return np.where(shares > 0, zero_db + shares * (one_db - zero_db), -np.inf)
