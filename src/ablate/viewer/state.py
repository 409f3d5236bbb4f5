"""What is asked of the viewer's core, and what it gives back."""

from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from ablate.ultrasound import ConvexProbe, Display, Probe, SimulatorSettings
from ablate.viewer.hand import Hold


class Quality(StrEnum):
    """`coarse`, while the probe moves: fewer rays and one layer; `full`, at rest: the settings as they are."""

    coarse = "coarse"
    full = "full"


class Moving(StrEnum):
    """What is rendered while the probe moves: a coarse simulation and the generators, or the generators `alone`."""

    both = "simulator and generator"
    alone = "generator alone"


@dataclass(frozen=True, eq=False)
class State:
    """Everything that decides what is seen.

    Attributes
    ----------
    pose : (4, 4) float64
        Probe to world, mm.
    display : Display or None
        None is the picture of the simulator's settings.
    seed : int
        Of the scatterers, and of a generator's noise.
    runs : tuple of Path
        Folders of finished runs, whose generators render the same frame.
    moving : Moving
    hold : Hold or None
        How the probe is held at this pose, where that is known.
    """

    pose: np.ndarray
    probe: Probe = ConvexProbe()
    simulator: SimulatorSettings = SimulatorSettings()
    display: Display | None = Display()
    seed: int = 0
    runs: tuple[Path, ...] = ()
    moving: Moving = Moving.both
    hold: Hold | None = None


@dataclass(frozen=True, eq=False)
class Views:
    """What is seen of a state; (H, W) is `state.simulator.image_shape`.

    Attributes
    ----------
    target : (H, W) uint8 or None
        The simulated B-mode image; None while the probe moves, where the generators render alone.
    segmentation : (H, W) uint8
    attenuation : (H, W) float32
    mask : (H, W) bool
        The fan.
    generated : tuple of (H, W) uint8 or None
        One a run of the state; None where it could not be rendered.
    ms : mapping of str to float
        What each took, milliseconds: `target`, `maps`, and `generated 0`, ...
    notes : mapping of str to str
        Sentences about what could not be shown or is shown with a reservation, by the same names.
    """

    target: np.ndarray | None
    segmentation: np.ndarray
    attenuation: np.ndarray
    mask: np.ndarray
    generated: tuple[np.ndarray | None, ...] = ()
    ms: dict[str, float] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    quality: Quality = Quality.full
