"""Spatial compounding: the sets of steered scanlines that a frame is averaged of, and what they bring on its grid.

Rays follow the steered scanlines. Scatterers stay on the frame's own, so that all sets see the same ones, each under
its own angle: what rays of a set bring is taken to the frame's grid, and its image is formed there, with its own wave
fronts. On steered scanlines of its own each set would sample other cells of the lattice, and its speckle would be
another one however small the angle is.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.imaging.point_spread import LINES_OF_A_PART, lateral_sigma
from ablate.ultrasound.media import DISPLAY_SPEED_M_S
from ablate.ultrasound.probe import fan_of, sample_depths_mm
from ablate.ultrasound.settings import Probe, SimulatorSettings

_KEY = 0xD1B54A32D192ED03  # keeps the paths of sets apart
_TAPER = 24  # the part of the scanlines at either end whose weight falls is one of so many


@dataclass(frozen=True)
class Steered:
    """One of the sets of scanlines that a frame is averaged of; of number 0 they are the frame's own.

    `range_mm` and `weight` are those of the frame's samples: how far along the set's scanlines they lie, (samples,),
    and how well the set sees them, (scanlines, samples) float32 in [0, 1].
    """

    probe: Probe
    settings: SimulatorSettings
    number: int

    @property
    def angle_rad(self) -> float:
        """By which scanlines are turned about their starts, towards growing x."""
        return math.radians(self.settings.compound_steer_deg) * self.number / max(self.settings.compound_angles // 2, 1)

    @property
    def path_seed(self) -> int:
        return (self.settings.path_seed + self.number * _KEY) % 2**64 if self.number else self.settings.path_seed

    @property
    def per_line_mm(self) -> float:
        """How much farther along its scanline a wave front is at each scanline than at the next one."""
        face_mm = float(fan_of(self.probe).width_mm(np.zeros(1))[0]) / max(self.settings.scanlines - 1, 1)
        return face_mm * math.sin(self.angle_rad)

    @property
    def turn_rad(self) -> float:
        """Standard deviation of the phases that the angle gives the scatterers of a sample, see `white_table`.

        The way there and back of a wave that is steered by a is 2 x sin a longer to a scatterer that lies x beside. The
        power of the beam, the square of a Gaussian, spreads a sample's scatterers with its standard deviation over
        sqrt(2). Under a curved face x grows with depth as sin a falls, so their product is that of the face.
        """
        sigma_lines = float(lateral_sigma(self.probe, self.settings, np.array([self.settings.focus_mm]))[0, 0])
        wavelength_mm = DISPLAY_SPEED_M_S / self.probe.frequency_mhz / 1e3
        return 2 * (2 * math.pi / wavelength_mm) * self.per_line_mm * sigma_lines / math.sqrt(2)

    @property
    def shift(self) -> np.ndarray:
        """By how many samples each of the frame's scanlines must be moved so that a wave front lies in one column."""
        lines = np.arange(self.settings.scanlines) - (self.settings.scanlines - 1) / 2
        spacing_mm = self.probe.depth_mm / self.settings.axial_samples
        return np.rint(lines * (self.per_line_mm / math.cos(self.angle_rad) / spacing_mm)).astype(int)

    @cached_property
    def range_mm(self) -> np.ndarray:
        return self._places(self.settings.axial_samples)[0]

    @cached_property
    def weight(self) -> np.ndarray:
        shape = self.settings.scanlines, self.settings.axial_samples
        if not self.number:
            return np.ones(shape, np.float32)
        range_mm, beside = self._places(shape[1])
        line = np.arange(shape[0])[:, None] + beside
        from_end = np.minimum(line, shape[0] - 1 - line) + 1
        seen = np.clip(from_end / max(shape[0] / _TAPER, 1), 0, 1) * (range_mm <= self.probe.depth_mm)
        return seen.astype(np.float32)

    def level(self, level_db: np.ndarray) -> np.ndarray:
        """Levels on the set's scanlines, (groups, nodes) dB, on those of the frame."""
        scanlines = self.settings.scanlines
        return np.concatenate([self.taken(level_db[i : i + scanlines]) for i in range(0, len(level_db), scanlines)])

    def taken(self, values: np.ndarray) -> np.ndarray:
        """Values on the set's scanlines at equal steps, (scanlines or 0, n), on those of the frame.

        From scanline to scanline they are interpolated along the set's wave fronts, on which a surface that faces it
        lies.
        """
        scanlines, count = values.shape
        first_mm, spacing_mm = self._steps(count)
        range_mm, beside = self._places(count)
        places = (range_mm - first_mm) / spacing_mm, beside
        on_frame = np.empty_like(values)
        gather = partial(_gather, values, places, self.per_line_mm / spacing_mm, on_frame)
        in_parts(gather, scanlines, LINES_OF_A_PART)
        return on_frame

    def _steps(self, count: int) -> tuple[float, float]:
        """The first of so many depths from the first sample to the last, and from one to the next, mm."""
        first_mm = self.probe.depth_mm / self.settings.axial_samples / 2
        return first_mm, (self.probe.depth_mm - 2 * first_mm) / max(count - 1, 1) or 1.0

    def _places(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Of points of the frame at such depths: how far along their steered scanline, mm; its number less theirs."""
        first_mm, spacing_mm = self._steps(count)
        depth_mm = first_mm + spacing_mm * np.arange(count)
        if count == self.settings.axial_samples:
            depth_mm = sample_depths_mm(self.probe, count)
        if not self.number:
            return depth_mm, np.zeros(count)
        fan = fan_of(self.probe)
        range_mm, beside = fan.steered(self.angle_rad, depth_mm)
        return range_mm, beside * ((self.settings.scanlines - 1) / (2 * fan.outer))


def steered_sets(probe: Probe, settings: SimulatorSettings) -> tuple[Steered, ...]:
    """The sets of a frame, from the largest angle on one side to that on the other; the frame's own in the middle."""
    half = settings.compound_angles // 2
    return tuple(Steered(probe, settings, number) for number in range(-half, half + 1))


def shares(sets: Sequence[Steered]) -> tuple[np.ndarray, ...]:
    """How much each set counts in the mean of those that see a sample, (scanlines, samples) float32 each."""
    total = np.sum([one.weight for one in sets], axis=0, dtype=np.float32)
    return tuple(one.weight / total for one in sets)


@compiled
def _gather(
    values: np.ndarray, places: tuple[np.ndarray, np.ndarray], slide: float, made: np.ndarray, begin: int, end: int
) -> None:
    """Fill some lines of what is made, (lines, n).

    `places` are the row of each value in `values`, (lines, rows), and how many lines beside it is found there; from a
    line to the next, a wave front is `slide` rows nearer.
    """
    (lines, rows), (at, beside) = values.shape, places
    for line in range(begin, end):
        for place in range(len(at)):
            across = min(max(line + beside[place], 0.0), lines - 1.0)
            before = min(int(across), max(lines - 2, 0))
            part = across - before
            a = _between(values, before, at[place] + part * slide, rows)
            b = _between(values, min(before + 1, lines - 1), at[place] - (1 - part) * slide, rows)
            made[line, place] = a + part * (b - a)


@compiled
def _between(values: np.ndarray, line: int, row: float, rows: int) -> float:
    """A value of a line between two rows, or the outer one beyond them."""
    row = min(max(row, 0.0), rows - 1.0)
    above = min(int(row), max(rows - 2, 0))
    here, there = values[line, above], values[line, min(above + 1, rows - 1)]
    return here + (row - above) * (there - here)
