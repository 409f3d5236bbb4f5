"""Scatterers on the scanlines: strength, texture and illumination at every sample."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch

from ablate.anatomy import Tissue
from ablate.threads import in_parts
from ablate.ultrasound.imaging import scatterers
from ablate.ultrasound.imaging.point_spread import LINES_OF_A_PART, axial_kernel, lateral_sigma, layer_weights
from ablate.ultrasound.probe import fan_of
from ablate.ultrasound.settings import PlanMode, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage

_TEXTURE_SPACING_MM = 0.3
_MOST_CELLS = 1 << 24  # of the lattice along a scanline: float32 tells no more apart
Lines = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]  # starts, directions, labels, ranges_mm


@dataclass(frozen=True)
class InsonifiedLines:
    """Everything about the samples of a pose that does not depend on the scatterers' seed, as tensors."""

    starts: torch.Tensor  # (layers, scanlines, 3) float32, mm from the anchor along the world's axes
    directions: torch.Tensor  # (layers, scanlines, 3) float32
    anchor: np.ndarray  # (3,) float64, cells from the world's origin to the corner that the lattice is counted from
    ranges_mm: torch.Tensor  # (layers, scanlines, samples), along its line to what a sample displays
    tissue: torch.Tensor  # (layers, scanlines, samples) uint8
    amplitude: torch.Tensor  # (layers, scanlines, samples), of unit strength: illumination, texture, level and weight


class Speckle:
    """Scatterers of a scene's tissues on the scanlines of a probe; `dtype` is the signal's, positions stay float32."""

    def __init__(
        self, tissues: Sequence[Tissue], probe: Probe, settings: SimulatorSettings, dtype: torch.dtype
    ) -> None:
        self._probe, self._settings, self._dtype = probe, settings, dtype
        self._spacing_mm = probe.depth_mm / settings.axial_samples
        self._pitch_mm = max(settings.scatterer_pitch_mm, fan_of(probe).reach_mm / _MOST_CELLS)
        tables = torch.from_numpy(scatterers.scatterer_tables(tissues)).to(settings.device)
        self._tables = torch.view_as_real(tables).flatten(0, 1).to(dtype)
        planned = settings.plan is PlanMode.auto
        self._silent = np.array([planned and tissue.scatter_power == 0 for tissue in tissues])
        self._textures = np.array([[*(1 / mm for mm in t.texture_mm), t.texture_contrast_db] for t in tissues])
        kernel = axial_kernel(probe, settings)
        correlation = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :]
        self._kernel_correlation = correlation / correlation[0]  # 1 at lag 0
        self._weights_db = 20 * np.log10(np.maximum(layer_weights(probe, settings)[0], 1e-15))

    @stage(Stage.scatterer_level)
    def insonify(self, lines: Lines, level_db: np.ndarray) -> InsonifiedLines:
        """Prepare the scatterers of a pose.

        For groups = layers * scanlines, the lines are starts and directions, (groups, 3) float64 in world coordinates,
        mm, labels (groups, samples) of the tissues, and ranges, mm, (samples,) or (groups, samples). `level_db`,
        (groups, nodes), is the illumination from the first sample to the last.
        """
        (starts, directions, labels, ranges_mm), settings = lines, self._settings
        shape = settings.layers, settings.scanlines, settings.axial_samples
        gain = scatterers.shared_cell_gain(directions, self._spacing_mm, self._pitch_mm, self._kernel_correlation)
        line_db = settings.scatterer_level_db - 10 * np.log10(gain)
        nodes = level_db.shape[-1]
        at_nodes = np.rint(np.linspace(0, shape[2] - 1, nodes)).astype(int)
        own_db = line_db.reshape(*shape[:2], 1) + self._weights_db[:, None, at_nodes]
        first_layer = slice(0, shape[1])
        own_db = own_db - self._across_db(starts[first_layer], directions[first_layer], at_nodes)
        weights = 10 ** (self._weights_db[:, at_nodes] / 20)
        of_layers = scatterers.shared_cell_gain_of_layers(starts[:: shape[1]], weights, self._pitch_mm)
        own_db = own_db - 10 * np.log10(of_layers)
        node_db = (level_db.reshape(*shape[:2], nodes) + own_db).reshape(-1, nodes)
        ranges = np.broadcast_to(ranges_mm.astype(np.float32), labels.shape)
        stride = max(1, int(_TEXTURE_SPACING_MM / self._spacing_mm))
        textured = (self._textures[:, 3] != 0)[labels[:, ::stride]].any()
        places = max(2, shape[2] // stride) if textured else nodes
        coarse = np.rint(np.linspace(0, shape[2] - 1, places)).astype(int)[: shape[2]]
        amplitude = torch.empty(labels.shape, dtype=self._dtype)
        of_lines = starts.astype(np.float32), directions.astype(np.float32), ranges, labels
        texture = self._textures, scatterers.texture_volume(), coarse
        fill = partial(scatterers.insonify, amplitude.numpy(), node_db, *of_lines, *texture)
        in_parts(fill, len(labels), LINES_OF_A_PART)

        def tensor(values: np.ndarray, *size: int) -> torch.Tensor:
            return torch.from_numpy(values).to(settings.device).reshape(*size)

        # near the first start, so that float32 tells cells apart: 0 within 50 m of the origin at a pitch of 0.1 mm
        anchor = np.rint(starts[0] / (self._pitch_mm * scatterers.ANCHOR_CELLS)) * scatterers.ANCHOR_CELLS
        from_anchor = tensor((starts - anchor * self._pitch_mm).astype(np.float32), *shape[:2], 3)
        along = torch.from_numpy(np.atleast_2d(ranges_mm).astype(np.float32)).to(settings.device).expand(labels.shape)
        return InsonifiedLines(
            from_anchor,
            tensor(of_lines[1], *shape[:2], 3),
            anchor,
            along.view(shape),
            tensor(labels, *shape),
            amplitude.to(settings.device).view(shape),
        )

    @stage(Stage.scatterers)
    def __call__(self, lines: InsonifiedLines, seed: int) -> torch.Tensor:
        """Sum over layers of amplitude x scatterer, (2, scanlines, samples) tensor: real and imaginary part."""
        _, scanlines, samples = lines.amplitude.shape
        summed = torch.zeros((2, scanlines, samples), dtype=self._dtype, device=lines.amplitude.device)
        on_cpu = summed.device.type == "cpu"
        add = partial(self._add_compiled if on_cpu else self._add, summed, lines, seed)
        in_parts(add, scanlines, LINES_OF_A_PART if on_cpu else scanlines)
        return summed

    def _add(self, summed: torch.Tensor, lines: InsonifiedLines, seed: int, begin: int, end: int) -> None:
        """Add what some scanlines receive, with a few operations of torch on all their samples."""
        some = slice(begin, end)
        total = torch.zeros((end - begin, summed.shape[-1], 2), dtype=self._dtype, device=summed.device)
        for layer, amplitude in enumerate(lines.amplitude[:, some]):
            starts, directions, along = (
                each[layer, some] for each in (lines.starts, lines.directions, lines.ranges_mm)
            )
            points = [starts[:, axis, None] + directions[:, axis, None] * along for axis in range(3)]
            entry = scatterers.cell_hash(points, self._pitch_mm, seed, lines.anchor)
            entry.add_(lines.tissue[layer, some].to(torch.int32), alpha=scatterers.TABLE_SIZE)
            strength = self._tables.index_select(0, entry.flatten()).view_as(total)
            total.addcmul_(strength, amplitude[..., None])
        summed[:, some] = total.permute(2, 0, 1)

    def _add_compiled(self, summed: torch.Tensor, lines: InsonifiedLines, seed: int, begin: int, end: int) -> None:
        """The same sample by sample, without those that are silent."""
        some = slice(begin, end)
        scatterers.add_scatterers(
            summed[:, some].numpy(),
            lines.starts[:, some].numpy(),
            lines.directions[:, some].numpy(),
            lines.ranges_mm[:, some].numpy(),
            np.array([scatterers.wrapped(int(cells)) for cells in lines.anchor], np.int32).view(np.uint32),
            np.float32(1 / self._pitch_mm),
            np.int32(scatterers.mix_seed(seed)).view(np.uint32),
            lines.tissue[:, some].numpy(),
            self._silent,
            self._tables.numpy(),
            lines.amplitude[:, some].numpy(),
        )

    def _across_db(self, starts: np.ndarray, directions: np.ndarray, samples: np.ndarray) -> np.ndarray:
        """What neighbouring scanlines of a layer add because they share lattice cells, (scanlines, depths), dB."""
        step_mm = np.linalg.norm(np.gradient(starts, axis=0), axis=-1) if len(starts) > 1 else np.full(1, np.inf)
        if step_mm.min() > 2 * self._pitch_mm:  # over sqrt(3), at the face and so everywhere
            return np.zeros((1, len(samples)))
        depth_mm = (samples + 0.5) * self._spacing_mm
        steps = np.gradient(starts, axis=0)[:, None] + depth_mm[:, None] * np.gradient(directions, axis=0)[:, None]
        sigma = lateral_sigma(self._probe, self._settings, depth_mm).T
        return 10 * np.log10(scatterers.shared_cell_gain_across(steps, sigma, self._pitch_mm))
