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
_ROWS_OF_A_PART, _GROUPS_OF_A_PART = 4, 64
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

        Given are the levels of the pencils, both ways, at equal distances from the first sample to the last. All are
        (groups, nodes) float64. No level is above 0, where nothing is lost. Where a pencil is silent, the level is that
        of the other ways.
        """
        groups, nodes = level_db.shape
        if groups % self._lines:  # compiled code checks no bounds
            raise ValueError(f"{groups} pencils, allowed are multiples of the {self._lines} scanlines")
        at_depths = np.minimum((np.arange(_DEPTHS) + 1) * nodes // _DEPTHS, nodes - 1)
        lost_db = np.empty((groups, nodes))
        at_depth = np.empty((groups // self._lines, _DEPTHS, self._lines), np.float32)
        in_parts(partial(_add_losses, level_db, at_depths, lost_db, at_depth), groups, _GROUPS_OF_A_PART)
        gain = np.zeros_like(at_depth)
        steps = np.diff(at_depth, axis=1, prepend=np.float32(0))
        padded = np.pad(steps, ((0, 0), (0, 0), (self._lines, self._lines)), mode="edge")
        elements = self._ways, self._weights, self._exists
        in_parts(partial(_add_up, padded, at_depth, elements, gain), len(gain) * _DEPTHS, _ROWS_OF_A_PART)
        place = np.clip((np.arange(nodes) + 1) * (_DEPTHS / nodes) - 1, 0, _DEPTHS - 1)
        below = np.minimum(place.astype(int), max(_DEPTHS - 2, 0))
        between, levels = (at_depths, below, place - below), (level_db, lost_db)
        result = np.empty((groups, nodes)), np.empty((groups, nodes))
        in_parts(partial(_share, gain, between, levels, result), groups, _GROUPS_OF_A_PART)
        return result


@compiled
def _add_losses(
    level_db: np.ndarray, at_depths: np.ndarray, lost_db: np.ndarray, at_depth: np.ndarray, begin: int, end: int
) -> None:
    """Fill the losses on the way to each node, one way, (groups, nodes), and to each depth, (layers, depths, lines).

    A pencil that is louder farther on, because few of its rays came back into it, has blocked nothing before.
    """
    (_, nodes), (_, depths, lines) = level_db.shape, at_depth.shape
    for group in range(begin, end):
        least = _MOST_DB
        for node in range(nodes - 1, -1, -1):
            least = min(least, -level_db[group, node] / 2)
            lost_db[group, node] = least
        for depth in range(depths):
            at_depth[group // lines, depth, group % lines] = lost_db[group, at_depths[depth]]


@compiled
def _share(gain: np.ndarray, between: Arrays, levels: Arrays, result: Arrays, begin: int, end: int) -> None:
    """Fill gain and level at the nodes, (groups, nodes) each, from the gain at the depths, (layers, depths, lines).

    At depths where a pencil is silent, the gain of the last depth that it reaches is held. `between` are the node at
    each depth, and for each node the depth before it and its share of the way to the next one.
    """
    (at_depths, before, part), (level_db, lost_db), (gain_db, reached_db) = between, levels, result
    _, depths, lines = gain.shape
    held = np.empty(depths, np.float32)
    for group in range(begin, end):
        own, last = gain[group // lines, :, group % lines], 0
        for depth in range(depths):
            last = depth if lost_db[group, at_depths[depth]] < _MOST_DB else last
            held[depth] = own[last]
        for node in range(len(before)):
            below, lost = before[node], 2 * lost_db[group, node]
            more = min(held[below] + part[node] * (held[below + 1] - held[below]), lost)
            others = own[below] + part[node] * (own[below + 1] - own[below]) - lost
            gain_db[group, node] = more
            if level_db[group, node] > NO_SOUND_DB:
                reached_db[group, node] = level_db[group, node] + more
            else:
                reached_db[group, node] = others if others > _SILENT_DB else NO_SOUND_DB


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
            seen = exists[depth, element]
            for line in range(lines):
                share = weights[element] * seen[line]
                weight[line] += share
                amplitude[line] += share * exponential(min(way[line], _MOST_DB) * _NEPER_PER_DB)
        for line in range(lines):
            if weight[line] > 0:  # else no element but that of the pencil, as of a single scanline
                gain[layer, depth, line] = 40 * np.log10(max(amplitude[line] / weight[line], 1e-15))
