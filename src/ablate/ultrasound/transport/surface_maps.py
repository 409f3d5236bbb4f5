"""Two maps that need no ray drawn: what surfaces return by themselves, and how much sound reaches each point.

Segmentation and attenuation do not say how a surface is tilted out of the image plane, and that decides whether a rib
is white or black; nor what surfaces keep from the tissue behind them, as gas does, which attenuates little. Both are
known from the crossings of straight scanlines with the meshes. Echoes of reflected rays are not in these maps.
"""

import math
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from ablate.threads import in_parts
from ablate.ultrasound.compiled import Arrays, compiled
from ablate.ultrasound.media import RenderPlan
from ablate.ultrasound.probe import layer_offsets_mm, sample_depths_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import KEEP, Geometry, all_of, asked_line, asked_ray, at, surfaces_of
from ablate.ultrasound.surfaces.line_walk import again, highest
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport.aperture import Aperture
from ablate.ultrasound.transport.bounce import pressure_reflection, transmission_cosine

#: Levels that are 0 and 1 in the maps, dB: of an echo about white; of sound about tissue whose loss the gain makes up.
ECHO_DB, LIGHT_DB = (-60.0, 20.0), (-48.0, 24.0)
_LINES_OF_A_PART = 32
_LINES_BESIDE = 15  # scanlines whose pencils cross those ways to a point that matter most
_MOST_MORE_DB = 40.0  # of an echo whose own pencil hardly reaches it
_COSINES = 129  # of incidence, at which the share that is received is tabulated, and between which it is linear
_LOBE = 256  # normals of a rough surface
_MEAN_DEPTH = math.sqrt(2 / math.pi)  # of a surface's echo, in units of its thickness: the mean of a half normal


class _Tables(NamedTuple):
    """Of tissues, (tissues,) float64 unless said otherwise."""

    speed_m_s: np.ndarray
    impedance_mrayl: np.ndarray
    loss_db_mm: np.ndarray
    depth_mm: np.ndarray  # of the echo behind a surface, which is rough
    received: np.ndarray  # (tissues, _COSINES): share of a surface's echo that its element receives, by incidence
    differs: np.ndarray  # (tissues, tissues) bool


class SurfaceMaps:
    """Makes the maps of a geometry, for one probe and one set of settings."""

    def __init__(
        self, geometry: Geometry, plan: RenderPlan, aperture: Aperture, probe: Probe, settings: SimulatorSettings
    ) -> None:
        self._geometry, self._owners, self._aperture = geometry, plan.tissue_of_owner, aperture
        self._shape = settings.beam_shape
        self._spacing_mm = probe.depth_mm / settings.axial_samples * settings.samples_per_row
        self._lines = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings))
        gain_db = time_gain_db(sample_depths_mm(probe, self._shape[0]), probe, settings.time_gain)
        self._gain_db, self._white_db = gain_db[:, None], 20 * math.log10(settings.reference_level)
        media = plan.media
        self._tables = _Tables(
            media.speed_m_s.astype(float),
            media.impedance_mrayl.astype(float),
            media.loss_db_mm.astype(float),
            _MEAN_DEPTH * media.thickness_mm.astype(float),
            np.array([_received(*pair) for pair in zip(media.specularity, media.lobe_exponent, strict=True)]),
            media.differs,
        )

    @stage(Stage.surface_maps)
    def __call__(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Interfaces and illumination, (rows, scanlines) float32 in [0, 1] each; `pose` leads to the geometry's world.

        A surface between tissues 1 and 2 returns w R_p E[max(0, cos 2i)^n] 10^(-2 alpha f d / 20) of the amplitude,
        where w is the product of 1 - R_p^2 of the surfaces before it, and the mean is over the normals i of a rough
        surface (docs/simulator.md, sections 5 and 6). Without the factors of the surface itself it is the illumination.
        The aperture is that of the image. Powers of the layers are averaged, and the time gain is added.
        """
        starts, directions = to_world(pose, self._lines[0]), self._lines[1] @ pose[:3, :3].T
        layers, count = starts.shape[:2]
        starts, directions = starts.reshape(-1, 3), directions.reshape(-1, 3)
        back, ahead = self._geometry.through(starts, directions)
        origins = (starts - back[:, None] * directions).astype(np.float32)
        lines = origins, directions.astype(np.float32), (back + ahead).astype(np.float32), back
        made = np.zeros((len(starts), self._shape[0])), np.zeros((len(starts), self._shape[0]))
        words = max(1, -(-self._geometry.structures // 32))
        asked = self._geometry.address, KEEP, self._geometry.step_mm, words
        follow = partial(_follow, asked, lines, self._owners, self._tables, self._spacing_mm, made)
        in_parts(follow, len(starts), _LINES_OF_A_PART)
        pencils_db = made[1].reshape(layers, count, -1)
        _, level_db = self._aperture.gain_and_level_db(made[1])
        # The mean over elements is no more than what the best of them brings, which interpolation in depth forgets.
        best_db = maximum_filter1d(pencils_db, _LINES_BESIDE, axis=1, mode="nearest")
        level_db = np.minimum(level_db.reshape(pencils_db.shape), best_db)
        more_db = np.clip(level_db - pencils_db, None, _MOST_MORE_DB)
        by_layer = np.stack([made[0].reshape(pencils_db.shape) * 10 ** (more_db / 20), 10 ** (level_db / 20)])
        echo, light = (10 * np.log10(np.maximum(np.square(by_layer).mean(axis=1), 1e-30))).transpose(0, 2, 1)
        return self._shown(echo - self._white_db, ECHO_DB), self._shown(light, LIGHT_DB)

    def _shown(self, level_db: np.ndarray, ends_db: tuple[float, float]) -> np.ndarray:
        shares = (level_db + self._gain_db - ends_db[0]) / (ends_db[1] - ends_db[0])
        return np.clip(shares, 0, 1).astype(np.float32)


def _received(specularity: float, lobe_exponent: float) -> np.ndarray:
    """E[max(0, cos 2i)^n] over the normals of a power-cosine lobe, by the cosine of incidence of the mesh, (cosines,).

    The normals are a lattice of the golden ratio, so the mean is the same every time.
    """
    index = np.arange(_LOBE)
    cos_tilt = ((index + 0.5) / _LOBE) ** lobe_exponent
    azimuth = 2 * math.pi * ((index * (math.sqrt(5) - 1) / 2) % 1)
    cos_i = np.linspace(0, 1, _COSINES)[:, None]
    sin_i, sin_tilt = np.sqrt(1 - cos_i**2), np.sqrt(1 - cos_tilt**2)
    towards = 2 * (cos_i * cos_tilt + sin_i * sin_tilt * np.cos(azimuth)) ** 2 - 1
    share: np.ndarray = np.where(towards > 0, np.maximum(towards, 1e-12) ** specularity, 0.0).mean(axis=1)
    return share


@compiled
def _follow(
    geometry: tuple[int, int, float, int],
    lines: Arrays,
    tissue_of_owner: np.ndarray,
    tables: _Tables,
    spacing_mm: float,
    made: Arrays,
    begin: int,
    end: int,
) -> None:
    """Fill rows of some lines: the amplitudes of their surfaces, and the level of the sound, dB, (lines, rows)."""
    address, keep, least_mm, words = geometry
    amplitude, level_db = made
    origins, directions, lengths_mm, before_mm = lines
    speed, impedance, loss_db_mm, behind_mm, received, differs = tables
    rows, cosines = amplitude.shape[1], received.shape[1]
    asked, line, inside = asked_ray(), asked_line(keep), np.zeros(words, np.uint32)
    for number in range(begin, end):
        met, line = all_of(address, asked, line, at(origins, number), at(directions, number), lengths_mm[number])
        distances, structures, incidence = surfaces_of(line, met)
        inside[:] = 0
        here, reached, loss_db, weight, filled = tissue_of_owner[0], 0.0, 0.0, 1.0, 0
        for k in range(met + 1):
            distance = math.inf
            if k < met:
                if again(distances, structures, k, least_mm):
                    continue
                distance = distances[k] - before_mm[number]
            passed_db = 20 * math.log10(max(weight, 1e-15)) - loss_db
            while filled < rows and (filled + 0.5) * spacing_mm < distance:
                level_db[number, filled] = passed_db - 2 * loss_db_mm[here] * ((filled + 0.5) * spacing_mm - reached)
                filled += 1
            if k == met:
                break
            structure = structures[k]
            inside[structure >> 5] ^= np.uint32(1) << np.uint32(structure & 31)
            owned_by = 0
            for word in range(words):
                if inside[word]:
                    owned_by = 32 * word + highest(inside[word])
            beyond = tissue_of_owner[owned_by]
            loss_db += 2 * loss_db_mm[here] * max(distance - reached, 0.0)
            reached = max(distance, 0.0)
            if distance > 0 and differs[here, beyond]:
                surface = tissue_of_owner[structure + 1]
                cos_i = min(float(incidence[k]), 1.0)
                cos_t = transmission_cosine(cos_i, speed[here], speed[beyond])
                pressure = pressure_reflection(impedance[here], impedance[beyond], cos_i, cos_t)
                row = (distance + behind_mm[surface]) / spacing_mm - 0.5
                if row < rows:
                    at_row = min(max(int(row), 0), rows - 1)
                    beside, part = min(at_row + 1, rows - 1), min(max(row - at_row, 0.0), 1.0)
                    place = cos_i * (cosines - 1)
                    first = min(int(place), cosines - 2)
                    share, next_share = received[surface, first], received[surface, first + 1]
                    share += (place - first) * (next_share - share)
                    echo = weight * abs(pressure) * share * 10 ** (-loss_db / 20)
                    amplitude[number, at_row] += (1 - part) * echo
                    amplitude[number, beside] += part * echo
                weight *= 1 - pressure * pressure
            here = beyond
