"""What an operator sets of the picture after reception: gain, time-gain sliders and dynamic range."""

from dataclasses import dataclass, replace

import numpy as np

from ablate.ultrasound.settings import SimulatorSettings
from ablate.validation import check_number

_MOST_DB = 100.0


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
            check_number(name, value, -_MOST_DB, _MOST_DB)

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
