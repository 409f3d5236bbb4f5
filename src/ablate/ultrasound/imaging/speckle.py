"""Scatterers on the scanlines: strength, texture and illumination at every sample."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch.nn import functional as F

from ablate.anatomy import Tissue
from ablate.threads import in_parts
from ablate.ultrasound.imaging import scatterers
from ablate.ultrasound.imaging.point_spread import LINES_OF_A_PART, axial_kernel, lateral_sigma, layer_weights
from ablate.ultrasound.probe import fan_of
from ablate.ultrasound.settings import PlanMode, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage

_DB_TO_NEPER = math.log(10) / 20
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
        textures = np.array([[*(1 / mm for mm in t.texture_mm), t.texture_contrast_db] for t in tissues], np.float32)
        self._contrasts = textures[:, 3]
        self._textures = torch.from_numpy(textures).to(settings.device)
        kernel = axial_kernel(probe, settings)
        correlation = np.correlate(kernel, kernel, "full")[len(kernel) - 1 :]
        self._kernel_correlation = correlation / correlation[0]  # 1 at lag 0
        self._weights_db = 20 * np.log10(np.maximum(layer_weights(probe, settings)[0], 1e-15))

    @stage(Stage.scatterer_level)
    def insonify(self, lines: Lines, level_db: torch.Tensor) -> InsonifiedLines:
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
        level = level_db.reshape(*shape[:2], nodes) + torch.from_numpy(own_db.astype(np.float32))
        level = level.to(settings.device)
        label = torch.from_numpy(labels).to(settings.device).reshape(shape)

        def tensor(values: np.ndarray, *size: int) -> torch.Tensor:
            return torch.from_numpy(values.astype(np.float32)).to(settings.device).reshape(*size)

        ends = tensor(starts, *shape[:2], 3), tensor(directions, *shape[:2], 3)
        ranges = tensor(ranges_mm, -1, shape[2]).expand(len(labels), -1).view(shape)
        textured = self._contrasts[np.bincount(labels.ravel(), minlength=1).nonzero()].any()
        amplitude = torch.empty(shape, dtype=self._dtype, device=settings.device)

        def of_lines(begin: int, end: int) -> None:
            some = slice(begin, end)
            part = level[:, some]
            if textured:
                texture = self._texture_db(ends[0][:, some], ends[1][:, some], ranges[:, some], label[:, some])
                part = _interpolated(part, texture.shape[-1]) + texture
            torch.exp(_interpolated(part * _DB_TO_NEPER, shape[2]).to(self._dtype), out=amplitude[:, some])

        in_parts(of_lines, shape[1], LINES_OF_A_PART if settings.device == "cpu" else shape[1])
        # near the first start, so that float32 tells cells apart: 0 within 50 m of the origin at a pitch of 0.1 mm
        anchor = np.rint(starts[0] / (self._pitch_mm * scatterers.ANCHOR_CELLS)) * scatterers.ANCHOR_CELLS
        from_anchor = tensor(starts - anchor * self._pitch_mm, *shape[:2], 3)
        return InsonifiedLines(from_anchor, ends[1], anchor, ranges, label, amplitude)

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
        if len(starts) == 1:
            return np.zeros((1, len(samples)))
        depth_mm = (samples + 0.5) * self._spacing_mm
        steps = np.gradient(starts, axis=0)[:, None] + depth_mm[:, None] * np.gradient(directions, axis=0)[:, None]
        sigma = lateral_sigma(self._probe, self._settings, depth_mm).T
        return 10 * np.log10(scatterers.shared_cell_gain_across(steps, sigma, self._pitch_mm))

    def _texture_db(
        self, starts: torch.Tensor, directions: torch.Tensor, ranges_mm: torch.Tensor, label: torch.Tensor
    ) -> torch.Tensor:
        """Gain of the slow texture at samples some `_TEXTURE_SPACING_MM` apart, from the first to the last, dB."""
        stride = max(1, int(_TEXTURE_SPACING_MM / self._spacing_mm))
        samples = label.shape[-1]
        coarse = torch.linspace(0, samples - 1, max(2, samples // stride)).round().long()[:samples]
        coarse = coarse.to(label.device)
        points = starts[:, :, None] + directions[:, :, None] * ranges_mm[..., coarse, None]
        return scatterers.texture_gain_db(points, label[..., coarse].long(), self._textures)


def _interpolated(values: torch.Tensor, size: int) -> torch.Tensor:
    """From nodes between the first and the last sample to so many, along the last axis."""
    return F.interpolate(values, size=size, mode="linear", align_corners=True)
