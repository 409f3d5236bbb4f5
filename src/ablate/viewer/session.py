"""What the operator has set, whatever page it was set on, and what is seen of it; a change asks for new views."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from ablate.ultrasound import ConvexProbe, Display, Probe, SimulatorSettings
from ablate.ultrasound.probe import fan_of
from ablate.ultrasound.settings import Sliders
from ablate.viewer.hand import Hand, Hold

OFF_BODY = "off the body: there is no skin at this place, and the probe stays where it was"
MOST_TURNED_DEG = 60  # rocked or tilted
FROZEN = "frozen: the picture is held; the probe moves on"


class Quality(StrEnum):
    """`coarse`, while the probe moves: fewer rays and one layer; `full`, at rest: the settings as they are."""

    coarse = "coarse"
    full = "full"


class Moving(StrEnum):
    """What is rendered while the probe moves: a coarse simulation and the generators, or the generators `alone`."""

    both = "simulator and generator"
    alone = "generator alone"


@dataclass(frozen=True, eq=False)
class ViewerState:
    """Everything that decides what is seen."""

    pose: np.ndarray  # (4, 4) float64, probe to world, mm
    probe: Probe = ConvexProbe()
    simulator: SimulatorSettings = SimulatorSettings()
    display: Display | None = Display()  # None is the picture of the simulator's settings
    seed: int = 0  # of the scatterers, and of a generator's noise
    runs: tuple[Path, ...] = ()  # folders of finished runs, whose generators render the same frame
    moving: Moving = Moving.both
    hold: Hold | None = None  # how the probe is held at this pose, where that is known


@dataclass(frozen=True, eq=False)
class Views:
    """What is seen of a state; (H, W) is `state.simulator.image_shape`."""

    state: ViewerState
    target: np.ndarray | None  # (H, W) uint8; None while the probe moves, where the generators render alone
    segmentation: np.ndarray  # (H, W) uint8
    attenuation: np.ndarray  # (H, W) float32
    mask: np.ndarray  # (H, W) bool, the fan
    generated: tuple[np.ndarray | None, ...]  # (H, W) uint8, one a run; None where it could not be rendered
    ms: dict[str, float]  # what each took: `target`, `maps`, and `generated 0`, ...
    notes: dict[str, str]  # what could not be shown or is shown with a reservation, by the same names
    quality: Quality
    time_gain_db: Sliders | None = None  # the curve in use, where the time gain is no straight line
    at_s: float = field(default_factory=time.monotonic)

    @property
    def image(self) -> np.ndarray | None:
        """The target, else the first generated image."""
        return next((image for image in (self.target, *self.generated) if image is not None), None)


class Session:
    """The probe as it is held, the scanner as it is set, and whether the picture is frozen.

    Only one thread at a time may call it.

    Parameters
    ----------
    hand : Hand
        Holds the probe.
    state : ViewerState
        Where it starts, but for the pose.
    poses : mapping of str to (4, 4) float64
        The presets by name, mm; it starts at the first one, and reset goes back there.
    submit : callable
        Called with every new state, unless the picture is frozen.
    """

    def __init__(
        self, hand: Hand, state: ViewerState, poses: Mapping[str, np.ndarray], submit: Callable[[ViewerState], object]
    ) -> None:
        self.hand = hand
        self.presets = dict(poses)
        self._submit = submit
        self.start = state
        self.state = state
        self.frozen = False
        self.words = ""
        self.hold = Hold(0.0, 0.0)
        self.listeners: list[Callable[[], object]] = []
        self.to_preset(next(iter(self.presets)))

    def move(self, **changes: float) -> None:
        """Change the hold: keys are those of `Hold`. Off the body the probe stays where it was."""
        for name in {"angle_deg", "roll_deg"} & changes.keys():
            if abs(changes[name]) > 180:
                changes[name] = (changes[name] + 180) % 360 - 180
        for name in {"rock_deg", "tilt_deg"} & changes.keys():
            most = max(MOST_TURNED_DEG, abs(getattr(self.hold, name)))  # a pose may be held beyond
            changes[name] = min(max(changes[name], -most), most)
        hold = replace(self.hold, **changes)
        held = self.hand.place(hold)
        if held is None:
            self.words = OFF_BODY
            self._tell()
        else:
            pose, self.words = held
            self.hold = hold
            self._become(replace(self.state, pose=pose, hold=hold))

    def nudge(self, **steps: float) -> None:
        """Change the hold by steps."""
        self.move(**{name: getattr(self.hold, name) + step for name, step in steps.items()})

    def to_preset(self, name: str) -> None:
        """Hold the probe as a preset does, exactly."""
        self.to_pose(self.presets[name])

    def to_pose(self, pose: np.ndarray) -> None:
        """Hold the probe at a pose, (4, 4), mm; the hold is the one that comes nearest."""
        self.hold = self.hand.hold_of(pose)
        self.words = self.hand.judge(pose)
        self._become(replace(self.state, pose=pose, hold=self.hold))

    def take(self, probe: Probe, simulator: SimulatorSettings, press_mm: float) -> None:
        """Take another probe, with the settings of its own that reset goes back to; its face is pressed in anew."""
        self.hand.take(probe, press_mm)
        self.start = replace(self.start, probe=probe, simulator=simulator)
        pose, self.words = self.hand.place(self.hold) or (self.state.pose, OFF_BODY)
        self._become(replace(self.state, probe=probe, simulator=simulator, pose=pose, hold=self.hold))

    def scan(self, **changes: float) -> None:
        """Change the probe: keys are those of its kind. Pixels stay square, and there are as many rows."""
        probe: Probe = replace(self.state.probe, **changes)  # type: ignore[arg-type]  # keys of its kind
        rows, columns = self.start.simulator.image_shape
        height, width = fan_of(probe).size_mm
        first_height, first_width = fan_of(self.start.probe).size_mm
        columns = max(1, round(columns * (width / height) / (first_width / first_height)))
        settings = replace(self.state.simulator, image_shape=(rows, columns))
        self._become(replace(self.state, probe=probe, simulator=settings))

    def simulate(self, **changes: Any) -> None:
        """Change settings of the simulator."""
        self._become(replace(self.state, simulator=replace(self.state.simulator, **changes)))

    def show(self, **changes: Any) -> None:
        """Change the display, the seed or the runs: keys are those of `ViewerState`."""
        self._become(replace(self.state, **changes))

    def new_speckle(self) -> None:
        """Draw other scatterers, and other noise of the generators."""
        self.show(seed=self.state.seed + 1)

    def freeze(self, frozen: bool) -> None:
        """Hold the picture, or let it follow the probe again."""
        self.frozen = frozen
        self._become(self.state)

    def reset(self) -> None:
        """Back to the scanner's settings and the seed of the beginning, at the first preset; runs stay picked."""
        self.state = replace(self.start, runs=self.state.runs)
        self.to_preset(next(iter(self.presets)))

    def _become(self, state: ViewerState) -> None:
        self.state = state
        if not self.frozen:
            self._submit(state)
        self._tell()

    def _tell(self) -> None:
        for listener in self.listeners:
            listener()
