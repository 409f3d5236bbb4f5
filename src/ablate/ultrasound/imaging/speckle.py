"""Scatterers on the scanlines: strength, texture and illumination at every sample."""

from collections.abc import Sequence
from functools import partial

import numpy as np

from ablate.anatomy import Tissue
from ablate.threads import in_parts
from ablate.ultrasound.imaging import lattice, scatterers, texture
from ablate.ultrasound.imaging.point_spread import LINES_OF_A_PART, axial_kernel, lateral_sigma, layer_weights
from ablate.ultrasound.settings import PlanMode, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage

_TEXTURE_SPACING_MM = 0.3  # at most, of the samples that texture is computed at; a fine one has two a cell
Lines = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # starts, directions, labels, ranges_mm


class Speckle:
    """Scatterers of a scene's tissues on the scanlines of a probe; `dtype` is the signal's, positions stay float32.

    `turns_rad` are those that waves give them, see `scatterers.white_table`.
    """

    def __init__(
        self,
        tissues: Sequence[Tissue],
        probe: Probe,
        settings: SimulatorSettings,
        dtype: type[np.floating],
        turns_rad: Sequence[float] = (0.0,),
    ) -> None:
        self._probe, self._settings, self.dtype = probe, settings, dtype
        self._spacing_mm = probe.depth_mm / settings.axial_samples
        self._pitch_mm = lattice.pitch_mm(probe, settings)
        self._tables = {turn: _table(tissues, turn).astype(dtype) for turn in turns_rad}
        self._silent = np.array([settings.plan is PlanMode.auto and tissue.scatter_power == 0 for tissue in tissues])
        self._textures = np.array([[*(1 / mm for mm in t.texture_mm), t.texture_contrast_db] for t in tissues])
        kernel = axial_kernel(probe, settings)
        cells_mm = [min(t.texture_mm) for t in tissues if t.texture_contrast_db]
        texture_mm = min([_TEXTURE_SPACING_MM, *(mm / 2 for mm in cells_mm)])
        self._stride = max(1, int(texture_mm / self._spacing_mm))
        correlation = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :]
        self._kernel_correlation = correlation / correlation[0]  # 1 at lag 0
        self._weights_db = 20 * np.log10(np.maximum(layer_weights(probe, settings)[0], 1e-15))

    @stage(Stage.scatterer_level)
    def insonify(self, lines: Lines, level_db: np.ndarray, seed: int) -> scatterers.Samples:
        """Prepare the scatterers of a pose; `seed` is theirs, and decides the texture.

        For groups = layers * scanlines, the lines are starts and directions, (groups, 3) float64 in the body's
        coordinates, mm, labels (groups, samples) of the tissues, and ranges, mm, (samples,) or (groups, samples).
        `level_db`, (groups, nodes), is the illumination from the first sample to the last.
        """
        starts, directions, labels, ranges_mm = lines
        shape = self._settings.layers, self._settings.scanlines, self._settings.axial_samples
        nodes = level_db.shape[-1]
        node_db = level_db.reshape(*shape[:2], nodes) + self._own_db(starts, directions, nodes)
        ranges = np.broadcast_to(ranges_mm.astype(np.float32), labels.shape)
        textured = any((labels[:, :: self._stride] == tissue).any() for tissue in np.flatnonzero(self._textures[:, 3]))
        count = max(nodes, shape[2] // self._stride) if textured else nodes
        coarse = np.rint(np.linspace(0, shape[2] - 1, count)).astype(int)[: shape[2]]
        amplitude = np.empty(labels.shape, self.dtype)
        line_geometry = starts.astype(np.float32), directions.astype(np.float32), ranges, labels
        textures = self._textures, texture.texture_volume(), texture.texture_start(seed), coarse
        fill = partial(texture.insonify, amplitude, node_db.reshape(-1, nodes), line_geometry, textures)
        in_parts(fill, len(labels), LINES_OF_A_PART)

        places = lattice.places_of((starts, directions), self._pitch_mm, self._settings)
        ranges, tissue, amplitude = (values.reshape(shape) for values in (ranges, labels, amplitude))
        return scatterers.Samples(*places, ranges, tissue, amplitude)

    @stage(Stage.scatterers)
    def __call__(self, lines: scatterers.Samples, seed: int, turn_rad: float = 0.0) -> np.ndarray:
        """Sum over layers of amplitude x scatterer, (2, scanlines, samples): real and imaginary part."""
        summed = np.empty((2, *lines.amplitude.shape[1:]), lines.amplitude.dtype)
        cells = np.float32(1 / self._pitch_mm), scatterers.mix_seed(seed)
        add_up = partial(scatterers.sum_scatterers, summed, lines, cells, (self._silent, self._tables[turn_rad]))
        in_parts(add_up, summed.shape[1], LINES_OF_A_PART)
        return summed

    def _own_db(self, starts: np.ndarray, directions: np.ndarray, nodes: int) -> np.ndarray:
        """Level of the scatterers themselves, less what samples add that share a cell, (layers, scanlines, nodes)."""
        layers, scanlines = self._settings.layers, self._settings.scanlines
        at_nodes = np.rint(np.linspace(0, self._settings.axial_samples - 1, nodes)).astype(int)
        gain = scatterers.shared_cell_gain(directions, self._spacing_mm, self._pitch_mm, self._kernel_correlation)
        line_db = self._settings.scatterer_level_db - 10 * np.log10(gain)
        own_db = line_db.reshape(layers, scanlines, 1) + self._weights_db[:, None, at_nodes]
        own_db = own_db - self._across_db(starts[:scanlines], directions[:scanlines], at_nodes)
        weights = 10 ** (self._weights_db[:, at_nodes] / 20)
        layer_gains = scatterers.shared_cell_gain_of_layers(starts[::scanlines], weights, self._pitch_mm)
        return own_db - 10 * np.log10(layer_gains)

    def _across_db(self, starts: np.ndarray, directions: np.ndarray, samples: np.ndarray) -> np.ndarray:
        """What neighbouring scanlines of a layer add because they share lattice cells, (scanlines, depths), dB."""
        step_mm = np.linalg.norm(np.gradient(starts, axis=0), axis=-1) if len(starts) > 1 else np.full(1, np.inf)
        if step_mm.min() > 2 * self._pitch_mm:  # over sqrt(3), at the face and so everywhere
            return np.zeros((1, len(samples)))
        depth_mm = (samples + 0.5) * self._spacing_mm
        steps = np.gradient(starts, axis=0)[:, None] + depth_mm[:, None] * np.gradient(directions, axis=0)[:, None]
        sigma = lateral_sigma(self._probe, self._settings, depth_mm).T
        return 10 * np.log10(scatterers.shared_cell_gain_across(steps, sigma, self._pitch_mm))


def _table(tissues: Sequence[Tissue], turn_rad: float) -> np.ndarray:
    """Real and imaginary parts of the tissues' tables, one after the other, (tissues * TABLE_SIZE, 2) float32."""
    table = np.concatenate([scatterers.scatterer_table(tissue, turn_rad) for tissue in tissues])[:, None]
    return np.concatenate([table.real, table.imag], axis=1)
