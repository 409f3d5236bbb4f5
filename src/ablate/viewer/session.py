"""What the operator has set, whatever page it was set on; every change asks the worker for new views."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ablate.ultrasound import Probe
from ablate.ultrasound.probe import fan_size_mm
from ablate.viewer.hand import Hand, Hold
from ablate.viewer.state import State

OFF_BODY = "off the body: there is no skin at this place, and the probe stays where it was"
FROZEN = "frozen: the picture is held; the probe moves on"


class Session:
    """The probe as it is held, the scanner as it is set, and whether the picture is frozen.

    Only one thread at a time may call it.

    Parameters
    ----------
    state
        To start from.
    poses
        Presets by name; reset goes to the first of them.
    submit
        Called with every new state, unless the picture is frozen.
    """

    def __init__(
        self, hand: Hand, state: State, poses: Mapping[str, np.ndarray], submit: Callable[[State], object]
    ) -> None:
        self.hand, self.presets, self._submit = hand, dict(poses), submit
        self.state = self.start = state
        self.frozen = False
        self.words = ""
        self.hold = Hold(0.0, 0.0)
        self.listeners: list[Callable[[], object]] = []
        self.to_preset(next(iter(self.presets)))

    def move(self, **changes: float) -> None:
        """Change the hold: keys are those of `Hold`. Off the body the probe stays where it was."""
        self.put(replace(self.hold, **changes))

    def nudge(self, **steps: float) -> None:
        """Change the hold by steps."""
        self.move(**{name: getattr(self.hold, name) + step for name, step in steps.items()})

    def turn_to(self, rotation: np.ndarray) -> None:
        """Turn the probe where it stands, to a rotation (3, 3) from probe to world."""
        self.put(self.hand.turned(self.hold, rotation))

    def put(self, hold: Hold) -> None:
        """Hold the probe in another way."""
        held = self.hand.place(hold)
        if held is None:
            self.words = OFF_BODY
            self._tell()
            return
        self.hold, self.words = hold, held.words
        self._become(replace(self.state, pose=held.pose, hold=hold))

    def to_preset(self, name: str) -> None:
        """Hold the probe as a preset does, exactly."""
        self.to_pose(self.presets[name])

    def to_pose(self, pose: np.ndarray) -> None:
        """Hold the probe at a pose, (4, 4), mm; the hold is the one that comes nearest."""
        self.hold, self.words = self.hand.hold_of(pose), self.hand.judge(pose)
        self._become(replace(self.state, pose=pose, hold=self.hold))

    def scan(self, **changes: float) -> None:
        """Change the probe: keys are those of its kind. Pixels stay square, and there are as many rows."""
        probe: Probe = replace(self.state.probe, **changes)  # type: ignore[arg-type]  # keys of its kind
        settings = replace(self.state.simulator, image_shape=self._shape_for(probe))
        self._become(replace(self.state, probe=probe, simulator=settings))

    def simulate(self, **changes: Any) -> None:
        """Change settings of the simulator."""
        self._become(replace(self.state, simulator=replace(self.state.simulator, **changes)))

    def show(self, **changes: Any) -> None:
        """Change the display, the seed or the runs: keys are those of `State`."""
        self._become(replace(self.state, **changes))

    def new_speckle(self) -> None:
        """Draw other scatterers, and other noise of the generators."""
        self.show(seed=self.state.seed + 1)

    def freeze(self, frozen: bool) -> None:
        """Hold the picture, or let it follow the probe again."""
        self.frozen = frozen
        self._become(self.state)

    def reset(self) -> None:
        """Back to the scanner's settings, the seed and the place of the beginning; runs stay picked."""
        self.state = replace(self.start, runs=self.state.runs)
        self.to_preset(next(iter(self.presets)))

    def _shape_for(self, probe: Probe) -> tuple[int, int]:
        """Rows and columns of an image whose pixels have the proportions of those at the start."""
        rows, columns = self.start.simulator.image_shape
        (height, width), (first_height, first_width) = fan_size_mm(probe), fan_size_mm(self.start.probe)
        return rows, max(1, round(columns * (width / height) / (first_width / first_height)))

    def _become(self, state: State) -> None:
        self.state = state
        if not self.frozen:
            self._submit(state)
        self._tell()

    def _tell(self) -> None:
        for listener in self.listeners:
            listener()
