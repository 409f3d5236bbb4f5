"""Two maps of surfaces: what they return, and how much sound reaches each point.

Segmentation and attenuation do not say how a surface is tilted out of the image plane, and that decides whether a rib
is white or black; nor what surfaces keep from the tissue behind them, as gas does, which attenuates little. Both follow
from one ray a scanline and layer, which surfaces refract about their own normals. Bone bends it away or reflects all of
it, so a straight line would put its shadow in the wrong place. What surfaces reflect to one another fills fluid with
haze. It is spread over many scanlines, so one traced ray on each of them is enough.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import torch

from ablate.threads import in_parts, side_by_side
from ablate.ultrasound.compiled import Arrays, compiled, exponential, step
from ablate.ultrasound.imaging.point_spread import axial_kernel, layer_weights
from ablate.ultrasound.media import RenderPlan
from ablate.ultrasound.probe import layer_offsets_mm, sample_depths_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.surfaces.line_walk import inside_at, owners
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport.aperture import Aperture
from ablate.ultrasound.transport.lines import NODES, Nodes, clutter_lines, echo_lines, mean_level_db
from ablate.ultrasound.transport.refracted_lines import Following, follow, lattice, start_lines
from ablate.ultrasound.transport.tracing import Tracer

#: Levels that are 0 and 1 in the maps, dB: of an echo about white; of sound about tissue whose loss the gain makes up.
ECHO_DB, LIGHT_DB = (-60.0, 20.0), (-48.0, 24.0)
_LINES_OF_A_PART = 32
_LINES_BESIDE = 15  # scanlines whose pencils cross those ways to a point that matter most
_MOST_MORE_DB = 40.0  # of an echo whose own pencil hardly reaches it
_PATH_SEED = 2**63  # of the rays for haze, the same for every frame: other paths than those of an image
_NEPER_PER_POWER_DB = math.log(10) / 10


class SurfaceMaps:
    """Makes the maps of a geometry, for one probe and one set of settings."""

    def __init__(
        self,
        geometry: Geometry,
        plan: RenderPlan,
        seen: tuple[torch.Tensor, Aperture],
        probe: Probe,
        settings: SimulatorSettings,
    ) -> None:
        self._geometry = geometry
        self._plan = plan
        self._beam, self._aperture = seen
        self._shape = settings.beam_shape
        self._depth_mm = probe.depth_mm
        self._lines = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings))
        gain_db = time_gain_db(sample_depths_mm(probe, self._shape[0]), probe, settings.time_gain)
        self._gains_db = np.stack([gain_db - 20 * math.log10(settings.reference_level), gain_db])
        self._normals = lattice()
        self._tracer = Tracer(geometry, plan, probe, replace(settings, rays=1, path_seed=_PATH_SEED))
        self._weights = layer_weights(probe, settings)[1]
        # of the amplitude of a row to that of its samples, which the pulse adds up
        self._haze = self._shape[0] / settings.axial_samples * axial_kernel(probe, settings).sum()

    @stage(Stage.surface_maps)
    def __call__(self, pose: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Interfaces and illumination, (rows, scanlines) float32 in [0, 1] each; `pose` leads to the geometry's world.

        A surface returns the share w E[R_p max(0, cos g)^n] 10^(-2 alpha f d / 20) of the amplitude. The angle g lies
        between the reflected direction and the way back to the element, and w is the product of E[1 - R_p^2] over the
        surfaces before. The mean E is over the normals of a rough surface (docs/simulator.md, sections 5 and 6). The
        illumination is w 10^(-2 alpha f d / 20), without the factors of a surface. The beam and the aperture are those
        of the image. Powers of the layers are averaged, and the time gain is added. Interfaces also have the power of
        reverberation, as one ray of each scanline and layer brings it back.
        """
        (direct, levels), haze = side_by_side(partial(self._direct, pose), partial(self._reverberation, pose))
        maps = np.empty(haze.shape, np.float32), np.empty(haze.shape, np.float32)
        show = partial(_show, direct, levels, haze, self._gains_db, maps)
        in_parts(show, len(haze), _LINES_OF_A_PART)
        return np.ascontiguousarray(maps[0].T), np.ascontiguousarray(maps[1].T)

    def _direct(self, pose: np.ndarray) -> tuple[np.ndarray, Arrays]:
        """Echoes, (layers, scanlines, rows); levels of pencils and of all elements, (layers, scanlines, nodes), dB."""
        starts, directions = to_world(pose, self._lines[0]), self._lines[1] @ pose[:3, :3].T
        line_shape = *starts.shape[:2], -1
        starts, directions = starts.reshape(-1, 3), directions.reshape(-1, 3)
        inside = inside_at(self._geometry, starts, directions)
        lines = start_lines(starts, directions, self._plan.tissue_of_owner[owners(inside)])
        through = Following(
            address=self._geometry.address,
            step_mm=self._geometry.step_mm,
            media=self._plan.media,
            tissue_of_owner=self._plan.tissue_of_owner,
            normals=self._normals,
            depth_mm=self._depth_mm,
            starts=starts,
            straight=directions,
            inside=inside,
            amplitude=np.zeros((len(starts), self._shape[0]), np.float32),
            sound=np.zeros((len(starts), min(self._shape[0], NODES))),
        )
        in_parts(partial(follow, lines, through), len(starts), _LINES_OF_A_PART)
        mean_db = mean_level_db(through.sound, 1, self._beam)
        _, level_db = self._aperture.gain_and_level_db(mean_db)
        return through.amplitude.reshape(line_shape), (mean_db.reshape(line_shape), level_db.reshape(line_shape))

    def _reverberation(self, pose: np.ndarray) -> np.ndarray:
        """Amplitudes of what surfaces reflect to one another, (scanlines, rows)."""
        bundle = self._tracer.at(pose)
        groups = len(bundle.starts)
        nodes = Nodes(0.0, 1.0, np.empty((groups, 0), bool), np.empty((groups, 0)))  # no light is asked for
        echoes = self._tracer(bundle, nodes)
        late = echoes[echoes["clutter"]]
        _, reverberation = echo_lines(late, np.empty((groups, 0)), nodes, self._weights, 1, self._depth_mm)
        haze = clutter_lines(reverberation, self._shape[0], torch.float64, self._haze, sets=1)
        return haze if len(haze) else np.zeros(self._shape[::-1])


@compiled
def _show(
    direct: np.ndarray, levels_db: Arrays, haze: np.ndarray, gains_db: np.ndarray, made: Arrays, begin: int, end: int
) -> None:
    """Fill both maps of some scanlines, (scanlines, rows), from what `_direct` and `_reverberation` return.

    Gains, (2, rows), are those of echoes, whose white is 0 dB, and of sound.
    """
    (pencils_db, all_db), (interfaces, illumination) = levels_db, made
    layers, _, rows = direct.shape
    nodes = pencils_db.shape[2]
    place = np.minimum(np.maximum((np.arange(rows) + 0.5) * (nodes / rows) - 0.5, 0), nodes - 1)
    before = np.minimum(place.astype(np.int64), max(nodes - 2, 0))
    part, after = place - before, np.minimum(before + 1, nodes - 1)
    least = 10 ** ((ECHO_DB[0] - gains_db[0]) / 10)
    for line in range(begin, end):
        echo, light, more_db = np.square(haze[line]), np.zeros(nodes), np.empty(nodes)
        for layer in range(layers):
            # The mean over elements is no more than what the best of them brings, which interpolation in depth forgets.
            best = _largest_beside(pencils_db[layer], line)
            for node in range(nodes):
                level_db = min(all_db[layer, line, node], best[node])
                light[node] += exponential(level_db * _NEPER_PER_POWER_DB) / layers
                more_db[node] = min(level_db - pencils_db[layer, line, node], _MOST_MORE_DB)
            for row in range(rows):
                if direct[layer, line, row] > 0:
                    gain_db = _between(more_db, before[row], after[row], part[row])
                    echo[row] += direct[layer, line, row] ** 2 * exponential(gain_db * _NEPER_PER_POWER_DB) / layers
        light_db = 10 * np.log10(np.maximum(light, 1e-30))
        for row in range(rows):
            level_db = _between(light_db, before[row], after[row], part[row]) + gains_db[1, row]
            illumination[line, row] = _scaled(level_db, LIGHT_DB)
            level_db = ECHO_DB[0] if echo[row] <= least[row] else 10 * math.log10(echo[row]) + gains_db[0, row]
            interfaces[line, row] = _scaled(level_db, ECHO_DB)


@step
def _between(values: np.ndarray, before: int, after: int, part: float) -> float:
    """Interpolate between two values, `part` of the way."""
    return values[before] + part * (values[after] - values[before])


@step
def _scaled(level_db: float, zero_and_one_db: tuple[float, float]) -> float:
    """A level on a scale from 0 to 1, and the nearest of both beyond."""
    zero_db, one_db = zero_and_one_db
    return min(max((level_db - zero_db) / (one_db - zero_db), 0.0), 1.0)


@compiled
def _largest_beside(levels_db: np.ndarray, line: int) -> np.ndarray:
    """The largest level of a scanline and of those beside it at each node, of (scanlines, nodes)."""
    lines, nodes = levels_db.shape
    best = levels_db[line].copy()
    for beside in range(max(line - _LINES_BESIDE // 2, 0), min(line + _LINES_BESIDE // 2 + 1, lines)):
        for node in range(nodes):
            one, two = best[node], levels_db[beside, node]
            best[node] = one if one > two else two
    return best
