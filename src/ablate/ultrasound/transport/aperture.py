"""The aperture: many elements see a point, so what stands before a few of them casts a soft shadow.

Rays follow each scanline as a pencil. What the pencils have lost up to each depth is known, so the loss on the straight
way from an element beside the scanline to a point on it is the sum of what each pencil loses where that way crosses it.
The amplitude that reaches a point is the mean over the elements that see it, and so is what they receive from it. For a
layered medium, whose pencils are alike, nothing changes. A shadow's core ends where the elements see past what casts
it, as in a photograph. Sound also bends around: where the first Fresnel zone is wider than the elements' ways, sound
takes that room. Its radius is sqrt(wavelength z' (z - z') / z) at the depth z' on the way to z (Born and Wolf,
Principles of Optics, ch. 8).
"""

import math
from functools import partial

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays, compiled, exponential
from ablate.ultrasound.media import DISPLAY_SPEED_M_S
from ablate.ultrasound.probe import fan_of
from ablate.ultrasound.settings import PhasedProbe, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.transport.lines import NO_SOUND_DB

_ELEMENTS = 24  # that stand for all that see a point
_DEPTHS = 64
_ROWS_OF_A_PART = 4
_NEPER_PER_DB = math.log(10) / 20
_ZONES = 1.25  # radii of the zone; shadows of rods are then those of waves (tests/ultrasound/test_aperture.py)
_MOST_DB = 300.0  # that other elements add to what a pencil brings
_SILENT_DB = 1 - 2 * _MOST_DB  # where all of them are


class Aperture:
    """The ways from the elements that see a point to it, for one probe and one set of settings."""

    def __init__(self, probe: Probe, settings: SimulatorSettings) -> None:
        depth_mm = (np.arange(_DEPTHS) + 1) * (probe.depth_mm / _DEPTHS)
        place = (2 * np.arange(_ELEMENTS) + 1) / _ELEMENTS - 1
        self._weights = np.cos(np.pi / 2 * place) ** 2  # Hann's apodisation
        span = np.minimum(settings.active_aperture_mm, depth_mm / settings.f_number)
        if isinstance(probe, PhasedProbe):
            span = np.minimum(span, probe.aperture_mm)
        middle_mm = depth_mm - depth_mm[0] / 2  # of the steps of a way
        left = np.maximum(1 - middle_mm / depth_mm[:, None], 0.0)  # of a way, (depths of points, steps)
        zone_mm = np.sqrt(left * middle_mm * (DISPLAY_SPEED_M_S / probe.frequency_mhz / 1e3))
        half_mm = np.maximum(span[:, None] / 2 * left, _ZONES * zone_mm)
        last = max(settings.scanlines - 1, 1)
        pitch_mm = np.maximum(fan_of(probe).width_mm(middle_mm) / last, 1e-9)
        ways = place[:, None] * (half_mm / pitch_mm)[:, None, :]
        self._ways = np.rint(np.clip(ways, -last, last)).astype(np.int64)  # scanlines beside, (depths, elements, steps)
        beside_mm = span[:, None] / 2 * place  # of the elements, on the face
        face_mm = np.maximum(fan_of(probe).width_mm(np.zeros(1)) / last, 1e-9)
        at_face = 0 * beside_mm if isinstance(probe, PhasedProbe) else np.clip(beside_mm / face_mm, -1e9, 1e9)
        line = np.arange(settings.scanlines)[None, None] + at_face[:, :, None]
        self._exists = ((line >= -0.5) & (line <= last + 0.5)).astype(float)  # elements beyond the array's ends do not
        self._lines = settings.scanlines

    @stage(Stage.aperture)
    def gain_and_level_db(self, level_db: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What all elements together bring more than the pencil of each scanline, both ways, and the level with it.

        Parameters
        ----------
        level_db : (groups, nodes) float
            Of the pencils, both ways, at equal distances from the first sample to the last.

        Returns
        -------
        gain_db, level_db : (groups, nodes) float64
            No level is above 0, where nothing is lost. Where a pencil is silent, the level is that of the other ways.
        """
        groups, nodes = level_db.shape
        at_depths = np.minimum((np.arange(_DEPTHS) + 1) * nodes // _DEPTHS, nodes - 1)
        # A pencil that is louder farther on, because few of its rays came back into it, has blocked nothing before.
        lost_db = np.minimum(-level_db / 2, _MOST_DB)  # one way
        lost_db = np.minimum.accumulate(lost_db[:, ::-1], axis=1)[:, ::-1]
        by_line = lost_db[:, at_depths].reshape(-1, self._lines, _DEPTHS)
        at_depth = np.ascontiguousarray(by_line.transpose(0, 2, 1), np.float32)
        gain = np.zeros_like(at_depth)
        steps = np.diff(at_depth, axis=1, prepend=np.float32(0))
        padded = np.pad(steps, ((0, 0), (0, 0), (self._lines, self._lines)), mode="edge")
        elements = self._ways, self._weights, self._exists
        in_parts(partial(_add_up, padded, at_depth, elements, gain), len(gain) * _DEPTHS, _ROWS_OF_A_PART)
        by_group = gain.transpose(0, 2, 1).reshape(groups, _DEPTHS)
        heard = np.where(lost_db[:, at_depths] < _MOST_DB, np.arange(_DEPTHS), 0)
        held = np.take_along_axis(by_group, np.maximum.accumulate(heard, axis=1), axis=1)
        gain_db = np.minimum(_between(held, nodes), 2 * lost_db)
        of_others = _between(by_group, nodes) - 2 * lost_db
        of_others = np.where(of_others > _SILENT_DB, of_others, NO_SOUND_DB)
        return gain_db, np.where(level_db > NO_SOUND_DB, level_db + gain_db, of_others)


def _between(by_depth: np.ndarray, nodes: int) -> np.ndarray:
    """Values at the depths, (groups, depths), interpolated to the nodes, (groups, nodes)."""
    place = np.clip((np.arange(nodes) + 1) * (_DEPTHS / nodes) - 1, 0, _DEPTHS - 1)
    below = np.minimum(place.astype(int), max(_DEPTHS - 2, 0))
    return by_depth[:, below] + (place - below) * (by_depth[:, below + 1] - by_depth[:, below])


@compiled
def _add_up(steps: np.ndarray, lost: np.ndarray, elements: Arrays, gain: np.ndarray, begin: int, end: int) -> None:
    """Fill some rows of `gain`, (layers, depths, lines): layer by layer, a row a depth.

    From the losses on each step of each pencil, (layers, steps, 3 lines), and their sums.
    """
    (ways, weights, exists), (_, depths, lines) = elements, gain.shape
    for row in range(begin, end):
        layer, depth = row // depths, row % depths
        amplitude, weight = np.zeros(lines), np.zeros(lines)
        for element in range(len(weights)):
            way = lost[layer, depth].copy()
            for step in range(depth + 1):
                first = lines + ways[depth, element, step]
                crossed = steps[layer, step, first : first + lines]
                for line in range(lines):
                    way[line] -= crossed[line]
            there = exists[depth, element]
            for line in range(lines):
                share = weights[element] * there[line]
                weight[line] += share
                amplitude[line] += share * exponential(min(way[line], _MOST_DB) * _NEPER_PER_DB)
        for line in range(lines):
            if weight[line] > 0:  # else no element but that of the pencil, as of a single scanline
                gain[layer, depth, line] = 40 * np.log10(max(amplitude[line] / weight[line], 1e-15))
