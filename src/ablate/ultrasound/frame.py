"""A simulated frame: its image, its maps, and what it was made with."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial

import numpy as np

from ablate.ultrasound.settings import Probe, SimulatorSettings


@dataclass(frozen=True)
class Beam:
    """A frame before scan conversion; (rows, scanlines) is `SimulatorSettings.beam_shape`.

    Attributes
    ----------
    segmentation : (rows, scanlines) uint8
        i + 1 for `scene.tissues[i]`: the tissue of the sample in the middle of each row.
    attenuation : (rows, scanlines) float32 in [0, 1]
        The integral attenuation map.
    interfaces : (rows, scanlines) float32 in [0, 1]
        What surfaces return, also by way of one another: -60 to 20 dB about white; empty where not asked for.
    illumination : (rows, scanlines) float32 in [0, 1]
        How much sound reaches each point, there and back, with the gain: -48 to 24 dB; empty where not asked for.
    image : (rows, scanlines) uint8
        Grey levels.
    grain : (rows, scanlines, 2) complex64
        The lattice of scatterers before any tissue (`lattice.grain`); empty where not asked for.
    compound : (rows, scanlines) float32 in [0, 1]
        The mean attenuation map of all angles that a frame is compounded of; empty where not asked for.
    """

    segmentation: np.ndarray
    attenuation: np.ndarray
    interfaces: np.ndarray = field(default_factory=partial(np.empty, (0, 0), np.float32))
    illumination: np.ndarray = field(default_factory=partial(np.empty, (0, 0), np.float32))
    image: np.ndarray = field(default_factory=partial(np.empty, (0, 0), np.uint8))
    grain: np.ndarray = field(default_factory=partial(np.empty, (0, 0, 2), np.complex64))
    compound: np.ndarray = field(default_factory=partial(np.empty, (0, 0), np.float32))


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
        Linear envelope before TGC, noise floor and log; the mean of all angles. Empty, (0, 0), where a simulator of the
        user's own has given grey levels.
    beam : Beam or None
        The same before scan conversion; image and attenuation are made from it. None in a frame made elsewhere.
    probe : Probe or None
        What it was simulated with; None in a frame made elsewhere.
    simulator : SimulatorSettings or None
        The settings that it was simulated with; None in a frame made elsewhere.
    """

    segmentation: np.ndarray
    attenuation: np.ndarray
    image: np.ndarray
    mask: np.ndarray
    envelope: np.ndarray
    beam: Beam | None = None
    probe: Probe | None = None
    simulator: SimulatorSettings | None = None
