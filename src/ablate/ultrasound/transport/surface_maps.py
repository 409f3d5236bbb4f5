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
from scipy.special import xlogy

from ablate.threads import in_parts, side_by_side
from ablate.ultrasound.compiled import Arrays, compiled, exponential
from ablate.ultrasound.imaging.point_spread import axial_kernel, layer_weights
from ablate.ultrasound.media import Media, RenderPlan
from ablate.ultrasound.probe import layer_offsets_mm, sample_depths_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import Geometry, asked_ray, at, closest_of
from ablate.ultrasound.surfaces.line_walk import inside_at, next_step, owner, toggle
from ablate.ultrasound.time_gain import time_gain_db
from ablate.ultrasound.transport import bounce
from ablate.ultrasound.transport.aperture import Aperture
from ablate.ultrasound.transport.lines import NODES, Nodes, clutter_lines, echo_lines, mean_level_db
from ablate.ultrasound.transport.tracing import Tracer

#: Levels that are 0 and 1 in the maps, dB: of an echo about white; of sound about tissue whose loss the gain makes up.
ECHO_DB, LIGHT_DB = (-60.0, 20.0), (-48.0, 24.0)
_LINES_OF_A_PART = 32
_LINES_BESIDE = 15  # scanlines whose pencils cross those ways to a point that matter most
_MOST_MORE_DB = 40.0  # of an echo whose own pencil hardly reaches it
_NORMALS = 8  # of a rough surface, over which its echo and what it lets through are averaged
_PATH_SEED = 2**63  # of the rays for haze, the same for every frame: other paths than those of an image
_NEPER_PER_POWER_DB = math.log(10) / 10
_MEAN_DEPTH = math.sqrt(2 / math.pi)  # of a surface's echo, in units of its thickness: the mean of a half normal


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
        self._geometry, self._plan, (self._beam, self._aperture) = geometry, plan, seen
        self._shape = settings.beam_shape
        self._depth_mm = probe.depth_mm
        self._lines = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings))
        gain_db = time_gain_db(sample_depths_mm(probe, self._shape[0]), probe, settings.time_gain)
        self._gains_db = np.stack([gain_db - 20 * math.log10(settings.reference_level), gain_db])
        self._normals = _lattice()
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
        made = np.empty(haze.shape, np.float32), np.empty(haze.shape, np.float32)
        show = partial(_show, direct, levels, haze, self._gains_db, made)
        in_parts(show, len(haze), _LINES_OF_A_PART)
        return np.ascontiguousarray(made[0].T), np.ascontiguousarray(made[1].T)

    def _direct(self, pose: np.ndarray) -> tuple[np.ndarray, Arrays]:
        """Echoes, (layers, scanlines, rows); levels of pencils and of all elements, (layers, scanlines, nodes), dB."""
        starts, directions = to_world(pose, self._lines[0]), self._lines[1] @ pose[:3, :3].T
        of_lines = *starts.shape[:2], -1
        starts, directions = starts.reshape(-1, 3), directions.reshape(-1, 3)
        lines = starts, directions, inside_at(self._geometry, starts, directions)
        made = np.zeros((len(starts), self._shape[0]), np.float32), np.zeros((len(starts), min(self._shape[0], NODES)))
        geometry = self._geometry.address, self._geometry.step_mm
        tables = self._plan.tissue_of_owner, self._normals
        follow = partial(_follow, geometry, lines, self._plan.media, tables, self._depth_mm, made)
        in_parts(follow, len(starts), _LINES_OF_A_PART)
        mean_db = mean_level_db(made[1], 1, self._beam)
        _, level_db = self._aperture.gain_and_level_db(mean_db)
        return made[0].reshape(of_lines), (mean_db.reshape(of_lines), level_db.reshape(of_lines))

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


def _lattice() -> np.ndarray:
    """What `bounce.sample_scattering` takes as drawn, (_NORMALS, 3): tilts of equal weight, each in four directions.

    The logarithm of a tilt is its mean over one of equal parts of (0, 1), so the mean squared tilt is that of all.
    """
    tilts = _NORMALS // 4
    ends, turn = np.linspace(0, 1, tilts + 1), np.arange(tilts)[:, None] / tilts
    azimuth = (math.pi / 2 * (np.arange(4) + turn)).ravel()
    log_u = np.repeat(tilts * np.diff(xlogy(ends, ends) - ends), 4)
    return np.stack([log_u, np.cos(azimuth), np.sin(azimuth)], axis=-1)


@compiled
def _follow(
    geometry: tuple[int, float],
    lines: Arrays,
    media: Media,
    tables: Arrays,
    depth_mm: float,
    made: Arrays,
    begin: int,
    end: int,
) -> None:
    """Fill rows of some lines: the amplitudes of their surfaces, (lines, rows), and of the sound, (lines, nodes).

    Lines are where they start, their directions, and the structures that they start inside of.
    """
    (address, least_mm), (tissue_of_owner, normals), (amplitude, sound) = geometry, tables, made
    starts, directions, sets = lines
    rows, nodes, asked = amplitude.shape[1], sound.shape[1], asked_ray()
    row_mm, node_mm = depth_mm / rows, depth_mm / nodes
    for number in range(begin, end):
        inside, start, straight = sets[number].copy(), at(starts, number), at(directions, number)
        origin, direction, here = start, straight, tissue_of_owner[owner(inside)]
        displayed, loss_db, weight, step_mm, filled = 0.0, 0.0, 1.0, 0.0, 0
        structure = triangle = np.int32(-1)
        while displayed < depth_mm and weight > 0:
            stretch, loss_db_mm = float(media.stretch[here]), float(media.loss_db_mm[here])
            reach_mm = (depth_mm - displayed) / stretch
            hit = closest_of(address, asked, origin, direction, reach_mm)
            length_mm = hit.distance_mm + step_mm if hit.structure >= 0 else math.inf
            to_mm = hit.distance_mm if hit.structure >= 0 else reach_mm
            # The gel around a body does not light its inside, see `tracing`.
            heard = not (media.anechoic[here] and bounce.strays(origin, direction, to_mm, start, straight))
            to_mm = min(displayed + length_mm * stretch, depth_mm)
            ahead_db = loss_db_mm * ((filled + 0.5) * node_mm - displayed) / stretch
            level = weight * 10 ** (-(loss_db + ahead_db) / 10) if heard else 0.0
            factor = 10 ** (-loss_db_mm * node_mm / stretch / 10)
            while filled < nodes and (filled + 0.5) * node_mm < to_mm:
                sound[number, filled] = level
                level, filled = level * factor, filled + 1
            if hit.structure < 0:
                break
            fresh = hit.structure != structure or hit.triangle != triangle  # a plane is met only once
            if fresh:
                toggle(inside, hit.structure)
            beyond = tissue_of_owner[owner(inside)]
            point = bounce.along(origin, direction, hit.distance_mm)
            displayed, loss_db = displayed + length_mm * stretch, loss_db + length_mm * loss_db_mm
            step_mm = next_step(step_mm, fresh and hit.distance_mm > step_mm, least_mm)
            structure, triangle = hit.structure, hit.triangle
            if media.differs[here, beyond]:
                speeds = float(media.speed_m_s[here]), float(media.speed_m_s[beyond])
                impedances = float(media.impedance_mrayl[here]), float(media.impedance_mrayl[beyond])
                faces = bounce.Interface(speeds[0], speeds[1], impedances[0], impedances[1], media.refracts)
                surface = tissue_of_owner[hit.structure + 1]
                exponent, specularity = float(media.lobe_exponent[surface]), float(media.specularity[surface])
                to_element = start[0] - point[0], start[1] - point[1], start[2] - point[2]
                distance_mm = max(math.sqrt(bounce.dot(to_element, to_element)), 1e-6)
                returned, passed, onward = 0.0, 0.0, (0.0, 0.0, 0.0)
                count = len(normals) if exponent > 0 else 1
                for k in range(count):
                    drawn = normals[k, 0], normals[k, 1], normals[k, 2]
                    scattering = bounce.sample_scattering(direction, hit.normal, faces, exponent, drawn, media.rough)
                    towards = bounce.dot(scattering.reflected, to_element) / distance_mm
                    if specularity == 0:
                        returned += abs(scattering.pressure)
                    elif towards > 0:
                        returned += abs(scattering.pressure) * math.exp(specularity * math.log(towards))
                    through = 1 - scattering.pressure * scattering.pressure
                    passed += through
                    onward = bounce.along(onward, scattering.transmitted, through)
                row = (displayed + _MEAN_DEPTH * media.thickness_mm[surface] * stretch) / row_mm - 0.5
                if row < rows and bounce.aside(point, start, straight) < bounce.IN_BEAM_MM**2:
                    at_row = min(max(int(row), 0), rows - 1)
                    beside, part = min(at_row + 1, rows - 1), min(max(row - at_row, 0.0), 1.0)
                    echo = weight * returned / count * 10 ** (-loss_db / 10)
                    amplitude[number, at_row] += (1 - part) * echo
                    amplitude[number, beside] += part * echo
                weight *= passed / count
                length = math.sqrt(bounce.dot(onward, onward))
                if length > 0:
                    direction = onward[0] / length, onward[1] / length, onward[2] / length
            origin, here = bounce.along(point, direction, step_mm), beyond


@compiled
def _show(
    direct: np.ndarray, levels_db: Arrays, haze: np.ndarray, gains_db: np.ndarray, made: Arrays, begin: int, end: int
) -> None:
    """Fill both maps of some scanlines, (scanlines, rows), from what `_direct` and `_reverberation` return.

    Gains, (2, rows), are those of echoes, whose white is 0 dB, and of sound.
    """
    (pencils_db, all_db), (interfaces, illumination) = levels_db, made
    (layers, lines, rows), nodes = direct.shape, pencils_db.shape[2]
    place = np.minimum(np.maximum((np.arange(rows) + 0.5) * (nodes / rows) - 0.5, 0), nodes - 1)
    before = np.minimum(place.astype(np.int64), max(nodes - 2, 0))
    part, after = place - before, np.minimum(before + 1, nodes - 1)
    least = 10 ** ((ECHO_DB[0] - gains_db[0]) / 10)
    for line in range(begin, end):
        echo, light, more_db = np.square(haze[line]), np.zeros(nodes), np.empty(nodes)
        for layer in range(layers):
            # The mean over elements is no more than what the best of them brings, which interpolation in depth forgets.
            best = pencils_db[layer, line].copy()
            for beside in range(max(line - _LINES_BESIDE // 2, 0), min(line + _LINES_BESIDE // 2 + 1, lines)):
                for node in range(nodes):
                    one, two = best[node], pencils_db[layer, beside, node]
                    best[node] = one if one > two else two
            for node in range(nodes):
                level_db = min(all_db[layer, line, node], best[node])
                light[node] += exponential(level_db * _NEPER_PER_POWER_DB) / layers
                more_db[node] = min(level_db - pencils_db[layer, line, node], _MOST_MORE_DB)
            for row in range(rows):
                if direct[layer, line, row] > 0:
                    gain_db = more_db[before[row]] + part[row] * (more_db[after[row]] - more_db[before[row]])
                    echo[row] += direct[layer, line, row] ** 2 * exponential(gain_db * _NEPER_PER_POWER_DB) / layers
        light_db = 10 * np.log10(np.maximum(light, 1e-30))
        for row in range(rows):
            level_db = light_db[before[row]] + part[row] * (light_db[after[row]] - light_db[before[row]])
            share = (level_db + gains_db[1, row] - LIGHT_DB[0]) / (LIGHT_DB[1] - LIGHT_DB[0])
            illumination[line, row] = min(max(share, 0.0), 1.0)
            echo_db = ECHO_DB[0] if echo[row] <= least[row] else 10 * math.log10(echo[row]) + gains_db[0, row]
            interfaces[line, row] = min((echo_db - ECHO_DB[0]) / (ECHO_DB[1] - ECHO_DB[0]), 1.0)
