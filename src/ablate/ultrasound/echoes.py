"""What is known of a frame before its image is formed, and what a simulator of the user's may return of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ablate.anatomy import Tissue
from ablate.ultrasound.imaging.bmode import Prepared, SignalChain
from ablate.ultrasound.imaging.point_spread import layer_weights
from ablate.ultrasound.imaging.scatterers import Samples
from ablate.ultrasound.probe import fan_of, layer_offsets_mm, sample_depths_mm, scanline_positions
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.time_gain import time_gain_db

_LEAST = 1e-15  # of a layer's weight, as of those of scatterers


@dataclass(frozen=True)
class Echoes:
    """All that is known of a frame before its image is formed: what a simulator of your own is given.

    Samples lie on the scanlines of the frame, at `SimulatorSettings.axial_samples` equal steps of depth; a scatterer
    lies at each sample of each layer. Amplitudes are those at the receiver before the time gain, 1 that of a flat
    perfect reflector seen face on. Axes are the probe's: x lateral, y elevational, z depth, from the middle of the
    face.

    Attributes
    ----------
    x_mm, z_mm : (samples, scanlines) float64
        Where a scanner that assumes 1540 m/s shows the samples, in the image plane.
    y_mm : (layers,) float64
        Where the layers lie across it.
    strength : (layers, samples, scanlines) complex64
        Of the scatterers; 0 where the tissue has none. The phase stands for the place of a scatterer within half a
        wavelength.
    weight : (layers, samples) float32
        Elevational, of the scatterers of each layer; squares sum to 1 over layers.
    transmission : (layers, samples, scanlines) float32
        Amplitude that is left of sound that goes to each scatterer and back.
    surfaces : (samples, scanlines) float32
        Amplitudes that surfaces send back, by way of one another too, summed over layers.
    reverberation : (samples, scanlines) complex64
        What comes back after more reflections than the beam holds together: out of focus, with random phases.
    labels : (layers, samples, scanlines) uint8
        The tissue at each sample, its number in `tissues`.
    tissues : tuple of Tissue
        All of the scene.
    probe : Probe
        Shape, depth and frequency.
    settings : SimulatorSettings
        Widths of the pulse, dynamic range, white, and all else.
    pose : (4, 4) float64
        From probe to world, mm.
    seed : int
        Of the scatterers; a re-simulation has another one.
    """

    x_mm: np.ndarray
    z_mm: np.ndarray
    y_mm: np.ndarray
    strength: np.ndarray
    weight: np.ndarray
    transmission: np.ndarray
    surfaces: np.ndarray
    reverberation: np.ndarray
    labels: np.ndarray
    tissues: tuple[Tissue, ...]
    probe: Probe
    settings: SimulatorSettings
    pose: np.ndarray
    seed: int

    @property
    def scattered(self) -> np.ndarray:
        """What the scatterers of all layers send back, (samples, scanlines) complex64."""
        received: np.ndarray = (self.strength * self.transmission * self.weight[:, :, None]).sum(axis=0)
        return received

    @property
    def depth_mm(self) -> np.ndarray:
        """Of the samples, along their scanlines, (samples,) float64."""
        return sample_depths_mm(self.probe, self.settings.axial_samples)

    @property
    def gain_db(self) -> np.ndarray:
        """The time gain at the samples, two ways, (samples,) float64."""
        return time_gain_db(self.depth_mm, self.probe, self.settings.time_gain)


@dataclass(frozen=True)
class Rf:
    """Beamformed radio-frequency lines, (n, scanlines) real, in the middles of n equal parts of the imaging depth."""

    lines: np.ndarray


@dataclass(frozen=True)
class Iq:
    """Beamformed complex lines, (n, scanlines), demodulated or not, in the middles of n equal parts of the depth."""

    lines: np.ndarray


def echoes_of(chain: SignalChain, prepared: Prepared, pose: np.ndarray, seed: int) -> Echoes:
    """What rays have brought back at a pose, sample by sample, of scanlines that are not steered.

    Parameters
    ----------
    chain : SignalChain
        Of the probe and the settings.
    prepared : Prepared
        What rays have brought back.
    pose : (4, 4) float
        From probe to world, mm.
    seed : int
        Of the scatterers.
    """
    probe, settings, speckle = chain.probe, chain.settings, chain.speckle
    returned = prepared.sets[len(prepared.sets) // 2]
    weight = np.maximum(layer_weights(probe, settings)[0], _LEAST).astype(np.float32)
    lossless = speckle.insonify(prepared.lines, np.zeros_like(returned.level_db), seed)
    received = speckle.insonify(prepared.lines, returned.level_db, seed)
    unattenuated = lossless._replace(amplitude=lossless.amplitude / weight[:, None])
    starts, directions, anchor, *sample_values = unattenuated
    strength = np.empty(unattenuated.amplitude.shape, np.complex64)
    for layer in range(settings.layers):
        only = slice(layer, layer + 1)
        one = Samples(starts[only], directions[only], anchor, *(values[only] for values in sample_values))
        strength[layer].real, strength[layer].imag = speckle(one, seed)
    line_starts, along = fan_of(probe).lines(scanline_positions(probe, settings.scanlines))
    places = line_starts + sample_depths_mm(probe, settings.axial_samples)[:, None, None] * along
    return Echoes(
        x_mm=places[..., 0],
        z_mm=places[..., 2],
        y_mm=layer_offsets_mm(settings),
        strength=_by_depth(strength),
        weight=weight,
        transmission=_by_depth((received.amplitude / lossless.amplitude).astype(np.float32)),
        surfaces=_by_depth(returned.surfaces.astype(np.float32)),
        reverberation=_by_depth(chain.reverberation(returned.clutter, pose, seed).astype(np.complex64)),
        labels=_by_depth(received.tissue),
        tissues=chain.tissues,
        probe=probe,
        settings=settings,
        pose=pose,
        seed=seed,
    )


def _by_depth(lines: np.ndarray) -> np.ndarray:
    """Values of scanlines, (..., scanlines, samples), as (..., samples, scanlines)."""
    return np.ascontiguousarray(lines.swapaxes(-1, -2))
