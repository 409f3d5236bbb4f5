"""The point spread function: separable, a Gaussian main lobe, and weak side lobes across the scanlines."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch.nn import functional as F

from ablate.threads import in_parts
from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.probe import fan_of, layer_offsets_mm, sample_depths_mm, scanline_positions
from ablate.ultrasound.pulse import pulse_widths
from ablate.ultrasound.settings import PhasedProbe, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage

FWHM_PER_SIGMA = 2 * math.sqrt(2 * math.log(2))
_BLOCKS = 64  # of depth, within which the lateral kernel is taken as constant
_SIDELOBES = 20.0  # widths of the main lobe that side lobes reach
_SIDELOBE_SEED = 0
_LOWEST_EXPONENT = -12.0  # of the main lobe's last entry
_LEAST = 1e-15  # of a kernel's entries; denormal numbers make a product much slower on some processors
_BLOCKS_OF_A_PART = 8  # that a thread takes at a time
LINES_OF_A_PART = 32
_TAIL = 4.0  # standard deviations kept of the axial kernel


def lateral_sigma(probe: Probe, settings: SimulatorSettings, depth_mm: np.ndarray) -> np.ndarray:
    """Standard deviation of the main lobe in scanlines, (depths, scanlines or 1) float64.

    It is that of `pulse_widths` straight ahead in `focus_mm`. A convex probe that is focused at every depth, in
    transmission and reception, has one angular width: within 2 % from 10 to 130 mm in PyMUST (docs/against_pymust.md).
    That of the others follows from their apertures, see `LinearProbe` and `PhasedProbe`.
    """
    width_mm = fan_of(probe).width_mm
    lines = max(settings.scanlines - 1, 1)
    sigma_mm = pulse_widths(probe, settings).lateral_mm / FWHM_PER_SIGMA
    at_focus = sigma_mm * lines / width_mm(np.array([settings.focus_mm]))[:, None]
    if not isinstance(probe, PhasedProbe):  # as the scanlines spread, so does the beam
        return np.broadcast_to(at_focus, (len(depth_mm), 1))
    far = np.maximum(depth_mm, probe.aperture_mm) / max(settings.focus_mm, probe.aperture_mm)
    wider = far * settings.focus_mm / depth_mm
    return at_focus * wider[:, None] / np.cos(scanline_positions(probe, settings.scanlines))


def axial_kernel(probe: Probe, settings: SimulatorSettings) -> np.ndarray:
    """The pulse's envelope at the spacing of the samples, peak 1, (odd length,) float64."""
    sigma = pulse_widths(probe, settings).axial_mm / FWHM_PER_SIGMA / (probe.depth_mm / settings.axial_samples)
    half = min(math.ceil(_TAIL * sigma), settings.axial_samples - 1)
    return np.exp(-0.5 * (np.arange(-half, half + 1) / sigma) ** 2)


def layer_weights(probe: Probe, settings: SimulatorSettings) -> tuple[np.ndarray, np.ndarray]:
    """Elevational weights of the layers at each sample, twice (layers, samples) float64: of scatterers and of surfaces.

    The squares of the former sum to 1, so independent scatterers keep their power. The latter sum to 1, so an echo that
    is in all layers keeps its amplitude. The beam is sqrt(1 + ((z - zf) / range)^2) times as wide as at the focus.
    """
    depth = sample_depths_mm(probe, settings.axial_samples)
    widening = np.sqrt(1 + ((depth - settings.focus_mm) / settings.focal_range_mm) ** 2)
    sigma = pulse_widths(probe, settings).elevational_mm / FWHM_PER_SIGMA * widening
    exponent = -0.5 * (layer_offsets_mm(settings)[:, None] / sigma) ** 2
    weights = np.exp(exponent - exponent.max(axis=0))
    return weights / np.sqrt((weights**2).sum(axis=0)), weights / weights.sum(axis=0)


def lateral_kernels(
    probe: Probe, settings: SimulatorSettings, widen: float = 1.0, sidelobe_db: float = -np.inf
) -> np.ndarray:
    """What each scanline gets of each other one.

    The main lobe is a Gaussian. Side lobes are `_SIDELOBES` times as wide. Of every two widths of the main lobe, at
    random, one is positive and one negative, so that a smooth surface does not fill what lies beside it, and one bright
    point makes no row of dots.

    Parameters
    ----------
    probe : Probe
        Its scanlines.
    settings : SimulatorSettings
        How many there are, and how wide the main lobe is.
    widen : float
        Width of the main lobe, in units of `lateral_sigma`.
    sidelobe_db : float
        Power of the side lobes, that of the main lobe being 0 dB.

    Returns
    -------
    (blocks of depth, scanlines, scanlines) float64
        Rows sum to 1; one block where all are equal.
    """
    depth_mm = (np.arange(_BLOCKS) + 0.5) * probe.depth_mm / _BLOCKS
    sigma = widen * np.maximum(lateral_sigma(probe, settings, depth_mm), 1e-3 / widen)[:, :, None]
    sigma = sigma[:1] if (sigma == sigma[:1]).all() else sigma
    apart = np.arange(settings.scanlines)[:, None] - np.arange(settings.scanlines)
    main = np.exp(np.maximum(-0.5 * (apart / sigma) ** 2, _LOWEST_EXPONENT))
    main = np.where(main > np.exp(_LOWEST_EXPONENT), main, 0.0)
    main /= main.sum(axis=-1, keepdims=True)
    side, energy = _side_lobes(np.abs(apart) / (FWHM_PER_SIGMA * sigma))
    side -= main * side.sum(axis=-1, keepdims=True)
    power = (main**2).sum(axis=-1, keepdims=True) / (FWHM_PER_SIGMA * sigma * energy)  # main over side lobes
    kernels = main + 10 ** (sidelobe_db / 20) * np.sqrt(power) * side
    return np.where(np.abs(kernels) <= _LEAST, 0.0, kernels)


def _side_lobes(widths: np.ndarray) -> tuple[np.ndarray, float]:
    """Side lobes at distances in widths of the main lobe, and the integral of their square over all distances."""
    signs = np.random.default_rng(_SIDELOBE_SEED).choice((-1.0, 1.0), (2**9, 1)) * (1, -1)
    at_widths, reach = np.concatenate([[0.0], signs.ravel()]), _SIDELOBES / FWHM_PER_SIGMA

    def lobes(far: np.ndarray) -> np.ndarray:
        return np.exp(-0.5 * (far / reach) ** 2) * np.interp(far, np.arange(len(at_widths)), at_widths)

    fine = np.linspace(0, 6 * reach, 4001)
    return lobes(widths), 2 * float(np.trapezoid(lobes(fine) ** 2, fine))


@dataclass(frozen=True)
class PointSpread:
    """Kernels of one probe and settings."""

    lateral: torch.Tensor  # (blocks of depth or 1, scanlines, scanlines); the main lobe's rows sum to 1
    scatterer_scale: torch.Tensor  # (blocks or 1, scanlines, 1): makes squares sum to 1, a row's and the axial kernel's
    axial: torch.Tensor  # (taps,), peak 1


def point_spread(probe: Probe, settings: SimulatorSettings, dtype: torch.dtype) -> PointSpread:
    """Kernels for `blur`."""
    lateral = lateral_kernels(probe, settings, sidelobe_db=settings.sidelobe_db)
    axial = axial_kernel(probe, settings)
    scale = 1 / np.sqrt((lateral**2).sum(axis=-1, keepdims=True) * (axial**2).sum())
    return PointSpread(*(torch.from_numpy(values).to(settings.device, dtype) for values in (lateral, scale, axial)))


@stage(Stage.point_spread)
def blur(
    scatterers: np.ndarray, surfaces: np.ndarray | None, spread: PointSpread, shift: np.ndarray | None = None
) -> np.ndarray:
    """Scatterers through the PSF of unit energy, plus surfaces through that whose main lobe has unit peak and sum.

    Parameters
    ----------
    scatterers : (channels, scanlines, samples) float
        Real and imaginary part, or the former alone.
    surfaces : (scanlines, samples) float, or None
        Amplitudes; None where there are none.
    spread : PointSpread
        The kernels.
    shift : (scanlines,) int, optional
        By how many samples each scanline is moved so that a wave front, along which beams spread, lies in one column.

    Returns
    -------
    (channels, scanlines, samples) float
        Real and imaginary part.
    """
    if shift is not None:
        room = int(np.abs(shift).max())
        scatterers = _moved(scatterers, room + shift, 2 * room)
        surfaces = None if surfaces is None else _moved(surfaces, room + shift, 2 * room)
    lateral = spread.lateral
    given = torch.from_numpy(scatterers).to(lateral)
    flat = None if surfaces is None else torch.from_numpy(surfaces).to(lateral.device)
    total = torch.empty_like(given)
    blocks = _BLOCKS if len(lateral) > 1 else _BLOCKS // _BLOCKS_OF_A_PART  # of one kernel, larger ones are faster
    edges = np.linspace(0, given.shape[2], blocks + 1).round().astype(int)

    def across(begin: int, end: int) -> None:
        for block in range(begin, end):
            some, kernel = slice(edges[block], edges[block + 1]), min(block, len(lateral) - 1)
            for channel, signal in enumerate(given):
                blurred = torch.mm(lateral[kernel], signal[:, some]).mul_(spread.scatterer_scale[kernel])
                if channel == 0 and flat is not None:
                    blurred.addmm_(lateral[kernel], flat[:, some].to(lateral.dtype))
                total[channel, :, some] = blurred

    in_parts(across, blocks, max(1, blocks // _BLOCKS_OF_A_PART) if given.device.type == "cpu" else blocks)
    if shift is not None:
        total = torch.stack(
            [total[:, line, room + by : total.shape[2] - room + by] for line, by in enumerate(shift)], 1
        )
    return along_lines(total, spread.axial).cpu().numpy()


def _moved(lines: np.ndarray, by: np.ndarray, more: int) -> np.ndarray:
    """Lines, (..., scanlines, samples), each moved by so many samples among zeros, (..., scanlines, samples + more)."""
    moved = np.zeros((*lines.shape[:-1], lines.shape[-1] + more), lines.dtype)
    for line, samples in enumerate(by):
        moved[..., line, samples : samples + lines.shape[-1]] = lines[..., line, :]
    return moved


def along_lines(lines: torch.Tensor, kernel: torch.Tensor) -> torch.Tensor:
    """Convolve lines, (2, scanlines, samples), along the last axis with a symmetric kernel, zeros beyond the ends."""
    if lines.device.type != "cpu":
        return F.conv1d(lines.flatten(0, 1)[:, None], kernel[None, None], padding="same").view(lines.shape)
    result = torch.empty_like(lines, memory_format=torch.contiguous_format)  # so that `made` is a view of it
    given, made = lines.flatten(0, 1).numpy(), result.flatten(0, 1).numpy()
    in_parts(partial(_convolve, given, kernel.numpy(), made), len(given), LINES_OF_A_PART)
    return result


@compiled
def _convolve(lines: np.ndarray, kernel: np.ndarray, result: np.ndarray, begin: int, end: int) -> None:
    """Fill some lines of `result`, (n, samples), each while it is in the cache."""
    samples, half = lines.shape[1], len(kernel) // 2
    for row in range(begin, end):
        line, made = lines[row], result[row]
        for sample in range(samples):
            made[sample] = kernel[half] * line[sample]
        for apart in range(1, min(half, samples - 1) + 1):
            weight, before, after = kernel[half + apart], made[apart:], line[apart:]
            for sample in range(samples - apart):
                before[sample] += weight * line[sample]
            for sample in range(samples - apart):
                made[sample] += weight * after[sample]
