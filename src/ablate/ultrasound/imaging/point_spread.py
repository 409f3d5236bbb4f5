"""The spatially variant point spread function: separable, Gaussian, wider away from the focus."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch.nn import functional as F

from ablate.threads import in_parts
from ablate.ultrasound.probe import fan_of, layer_offsets_mm, sample_depths_mm, scanline_positions
from ablate.ultrasound.settings import ConvexProbe, LinearProbe, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage

FWHM_PER_SIGMA = 2 * math.sqrt(2 * math.log(2))
_BLOCKS = 64  # of depth, within which the lateral kernel is taken as constant
_LINES_AT_ONCE = 32  # rows of a window of the lateral kernels
_LOWEST_EXPONENT = -12.0  # of the lateral kernel's last entry
_BLOCKS_OF_A_PART = 8  # that a thread takes at a time
LINES_OF_A_PART = 32
_TAIL = 4.0  # standard deviations kept of the axial kernel
_WINDOW = 64  # samples that one product of `along_lines` makes


def beam_widening(settings: SimulatorSettings, depth_mm: np.ndarray) -> np.ndarray:
    """Width of the beam over its width at the focus, sqrt(1 + ((z - zf) / range)^2)."""
    return np.sqrt(1 + ((depth_mm - settings.focus_mm) / settings.focal_range_mm) ** 2)


def lateral_sigma(probe: Probe, settings: SimulatorSettings, depth_mm: np.ndarray, widen: float = 1.0) -> np.ndarray:
    """Standard deviation of the beam times `widen`, in scanlines, (depths, scanlines or 1) float64.

    A convex probe's grows as `beam_widening`. That of the other two follows from their apertures, see `LinearProbe` and
    `PhasedProbe`, and is `lateral_fwhm_mm` straight ahead in `focus_mm`.
    """
    spacing = (fan_of(probe).width_mm(depth_mm) / max(settings.scanlines - 1, 1))[:, None]  # one scanline's: the fan's
    if isinstance(probe, ConvexProbe):
        widening = beam_widening(settings, depth_mm)[:, None]
    elif isinstance(probe, LinearProbe):
        widening = np.ones((len(depth_mm), 1))
    else:
        far = np.maximum(depth_mm, probe.aperture_mm) / max(settings.focus_mm, probe.aperture_mm)
        widening = far[:, None] / np.cos(scanline_positions(probe, settings.scanlines))
    return widen * settings.lateral_fwhm_mm / FWHM_PER_SIGMA * widening / spacing


def axial_kernel(probe: Probe, settings: SimulatorSettings) -> np.ndarray:
    """The pulse's envelope at the spacing of the samples, peak 1, (odd length,) float64."""
    sigma = settings.axial_fwhm_mm / FWHM_PER_SIGMA / (probe.depth_mm / settings.axial_samples)
    half = min(math.ceil(_TAIL * sigma), settings.axial_samples - 1)
    return np.exp(-0.5 * (np.arange(-half, half + 1) / sigma) ** 2)


def layer_weights(probe: Probe, settings: SimulatorSettings) -> tuple[np.ndarray, np.ndarray]:
    """Elevational weights of the layers at each sample, twice (layers, samples) float64: of scatterers and of surfaces.

    The squares of the former sum to 1, so independent scatterers keep their power. The latter sum to 1, so an echo that
    is in all layers keeps its amplitude.
    """
    depth = sample_depths_mm(probe, settings.axial_samples)
    sigma = settings.elevational_fwhm_mm / FWHM_PER_SIGMA * beam_widening(settings, depth)
    exponent = -0.5 * (layer_offsets_mm(settings)[:, None] / sigma) ** 2
    weights = np.exp(exponent - exponent.max(axis=0))
    return weights / np.sqrt((weights**2).sum(axis=0)), weights / weights.sum(axis=0)


def lateral_kernels(probe: Probe, settings: SimulatorSettings, depth_mm: np.ndarray, widen: float = 1.0) -> np.ndarray:
    """What each scanline gets of each other one at some depths, (depths, scanlines, scanlines) float64.

    The width in scanlines is sigma(z) over their distance, times `widen`. Rows sum to 1; far from the diagonal they
    are zero.
    """
    sigma = lateral_sigma(probe, settings, depth_mm, widen)
    apart = np.arange(settings.scanlines)[:, None] - np.arange(settings.scanlines)
    exponent = -0.5 * (apart / np.maximum(sigma, 1e-3)[:, :, None]) ** 2
    lateral = np.where(exponent > _LOWEST_EXPONENT, np.exp(np.maximum(exponent, _LOWEST_EXPONENT)), 0.0)
    return lateral / lateral.sum(axis=-1, keepdims=True)


class Across:
    """Products with (blocks, scanlines, scanlines) matrices that are zero far from the diagonal, one a block of depth.

    Only a window about the diagonal is multiplied: three times less work for the paper's 192 scanlines.
    """

    def __init__(self, kernels: np.ndarray, device: str, dtype: torch.dtype) -> None:
        self.blocks, self.lines, _ = kernels.shape
        rows, columns = np.nonzero(kernels.any(axis=0))
        self._half = int(np.abs(rows - columns).max())
        self._groups = -(-self.lines // _LINES_AT_ONCE)
        self._window = _LINES_AT_ONCE + 2 * self._half
        more = self._groups * _LINES_AT_ONCE - self.lines
        padded = np.pad(kernels, ((0, 0), (0, more), (self._half, self._half + more)))
        first = _LINES_AT_ONCE * np.arange(self._groups)[:, None]
        rows, columns = first + np.arange(_LINES_AT_ONCE), first + np.arange(self._window)
        windows = padded[:, rows[:, :, None], columns[:, None, :]].reshape(-1, _LINES_AT_ONCE, self._window)
        self._windows = torch.from_numpy(windows).to(device, dtype)

    def __call__(self, values: torch.Tensor, first: int = 0) -> torch.Tensor:
        """Apply to (k, scanlines, n) values of the blocks from `first` on."""
        more = self._groups * _LINES_AT_ONCE - self.lines
        padded = F.pad(values, (0, 0, self._half, self._half + more))
        windows = padded.unfold(1, self._window, _LINES_AT_ONCE).flatten(0, 1).transpose(1, 2)
        own = self._windows[first * self._groups : (first + len(values)) * self._groups]
        return torch.bmm(own, windows).reshape(len(values), -1, values.shape[-1])[:, : self.lines]


@dataclass(frozen=True)
class PointSpread:
    """Kernels of one probe and settings."""

    lateral: Across  # rows sum to 1
    scatterer_scale: torch.Tensor  # (scanlines, blocks): makes squares sum to 1, a row's and the axial kernel's
    axial: torch.Tensor  # (taps,), peak 1
    block: int  # samples that share a lateral kernel


def point_spread(probe: Probe, settings: SimulatorSettings, dtype: torch.dtype) -> PointSpread:
    """Kernels for `blur`."""
    samples = settings.axial_samples
    block = -(-samples // _BLOCKS)
    blocks = -(-samples // block)
    lateral = lateral_kernels(probe, settings, (np.arange(blocks) + 0.5) * block * (probe.depth_mm / samples))
    axial = axial_kernel(probe, settings)
    energy = np.sqrt((lateral**2).sum(axis=-1)) * math.sqrt((axial**2).sum())
    return PointSpread(
        lateral=Across(lateral, settings.device, dtype),
        scatterer_scale=torch.from_numpy(1 / energy.T.copy()).to(settings.device, dtype),
        axial=torch.from_numpy(axial).to(settings.device, dtype),
        block=block,
    )


@stage(Stage.point_spread)
def blur(scatterers: torch.Tensor, surfaces: torch.Tensor, spread: PointSpread) -> torch.Tensor:
    """Scatterers through the PSF of unit energy, plus surfaces through that of unit peak and unit lateral sum.

    Scatterers and the result are (2, scanlines, samples), real and imaginary part; surfaces are (scanlines, samples).
    """
    lines, samples = surfaces.shape
    blocks = spread.lateral.blocks
    stacked = torch.cat([scatterers, surfaces[None]])
    stacked = F.pad(stacked, (0, blocks * spread.block - samples)).reshape(3, lines, blocks, spread.block)
    total = stacked.new_empty(2, lines, blocks, spread.block)
    result = stacked.new_empty(2, lines, samples)

    def across(begin: int, end: int) -> None:
        by_block = stacked[:, :, begin:end].permute(2, 1, 0, 3).reshape(end - begin, lines, 3 * spread.block)
        spread_out = spread.lateral(by_block, begin).reshape(end - begin, lines, 3, spread.block)
        both = spread_out[:, :, :2] * spread.scatterer_scale.T[begin:end, :, None, None]
        both[:, :, 0] += spread_out[:, :, 2]
        total[:, :, begin:end] = both.permute(2, 1, 0, 3)

    def along(begin: int, end: int) -> None:
        result[:, begin:end] = along_lines(total[:, begin:end].flatten(2)[..., :samples], spread.axial)

    on_cpu = stacked.device.type == "cpu"
    in_parts(across, blocks, _BLOCKS_OF_A_PART if on_cpu else blocks)
    in_parts(along, lines, LINES_OF_A_PART if on_cpu else lines)
    return result


def along_lines(lines: torch.Tensor, kernel: torch.Tensor) -> torch.Tensor:
    """Convolve lines, (..., samples), along the last axis with a symmetric kernel, zeros beyond the ends.

    One product of overlapping windows with a banded matrix: many times faster than a one-channel convolution.
    """
    samples, half = lines.shape[-1], len(kernel) // 2
    window = _WINDOW + 2 * half
    padded = F.pad(lines, (half, half + -samples % _WINDOW)).unfold(-1, window, _WINDOW)
    band = kernel.new_zeros(_WINDOW, window)
    for row in range(_WINDOW):
        band[row, row : row + len(kernel)] = kernel
    return (padded @ band.T).flatten(-2)[..., :samples]
