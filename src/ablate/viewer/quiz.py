"""Find this plane: a question, and how far an answer is from it."""

import random
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

_FOUND_MM, _FOUND_DEG = 15.0, 12.0
_TURNED_ROUND = Rotation.from_euler("Z", 180, degrees=True)


@dataclass(frozen=True)
class Miss:
    """How far a pose is from the plane that was asked for.

    `distance_mm` is that of the face's middle, and `angle_deg` the turn that is left; a probe that is turned round by
    180 degrees shows the same plane, mirrored.
    """

    distance_mm: float
    angle_deg: float

    @property
    def found(self) -> bool:
        return self.distance_mm <= _FOUND_MM and self.angle_deg <= _FOUND_DEG

    @property
    def points(self) -> int:
        """100 for the exact pose, 50 where distance and angle are at the limits of `found`, down to 0."""
        return round(100 * 0.5 ** ((self.distance_mm / _FOUND_MM + self.angle_deg / _FOUND_DEG) / 2))


def miss(pose: np.ndarray, wanted: np.ndarray) -> Miss:
    """Measure how far a pose is from the wanted one, (4, 4) each, mm."""
    left = Rotation.from_matrix(wanted[:3, :3]).inv() * Rotation.from_matrix(pose[:3, :3])
    angle = min(left.magnitude(), (_TURNED_ROUND * left).magnitude())
    return Miss(float(np.linalg.norm(pose[:3, 3] - wanted[:3, 3])), float(np.rad2deg(angle)))


class Quiz:
    """Asks for presets in random order, each once before any is asked for again; `wanted` is the name of the last."""

    def __init__(self, presets: Mapping[str, np.ndarray], seed: int | None = None) -> None:
        self._presets, self._random = dict(presets), random.Random(seed)
        self._left: list[str] = []
        self.wanted: str | None = None

    def ask(self) -> str:
        """Choose the next plane to find, and return its name."""
        if not self._left:
            self._left = [name for name in self._presets if name != self.wanted or len(self._presets) == 1]
            self._random.shuffle(self._left)
        self.wanted = self._left.pop()
        return self.wanted

    @property
    def pose(self) -> np.ndarray:
        """The plane that was asked for; a ValueError before the first question."""
        if self.wanted is None:
            raise ValueError("no plane has been asked for yet")
        return self._presets[self.wanted]
