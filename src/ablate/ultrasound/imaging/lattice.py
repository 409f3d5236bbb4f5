"""The lattice of scatterers on the scanlines of a probe: where it lies, and what it is before any tissue.

The lattice belongs to the body. It needs no ray and no triangle: the pose, the probe and a seed tell all of it, so a
network can read it (`model.noise=body`), and its speckle then moves with the anatomy, as the simulator's does.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from ablate.threads import in_parts
from ablate.ultrasound.compiled import compiled
from ablate.ultrasound.imaging.point_spread import LINES_OF_A_PART, layer_weights
from ablate.ultrasound.imaging.scatterers import ANCHOR_CELLS, entry_of_cell, mix_seed, white_table
from ablate.ultrasound.probe import (
    check_pose,
    check_seed,
    fan_of,
    layer_offsets_mm,
    sample_depths_mm,
    scanlines_in_plane,
    to_world,
)
from ablate.ultrasound.settings import Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage

_MOST_CELLS = 1 << 24  # of the lattice along a scanline: float32 tells no more apart
# Cells from a corner of the lattice to the body's origin: planes through it, as x = 0, would else lie on cells' faces.
_OFFSET = np.array([0.37, 0.43, 0.31])
_POSE_STEPS = 2.0**32  # a mm: poses are rounded to it, so that a body that moves with the probe rounds no cell away


class Places(NamedTuple):
    """Where the scanlines of all layers lie in the lattice."""

    starts: np.ndarray  # (layers, scanlines, 3) float32, mm from the anchor along the body's axes
    directions: np.ndarray  # (layers, scanlines, 3) float32
    anchor: np.ndarray  # (3,) uint32, cells from the body's origin to where the lattice is counted from, modulo 2^32


def pose_in_body(pose: np.ndarray, body: np.ndarray) -> np.ndarray:
    """A probe's pose in a body's coordinates, (4, 4) float64; `pose` and `body` lead to the world, mm."""
    rotation = body[:3, :3].T
    moved = np.eye(4)
    moved[:3, :3] = rotation @ pose[:3, :3]
    moved[:3, 3] = rotation @ (pose[:3, 3] - body[:3, 3])
    return np.rint(moved * _POSE_STEPS) / _POSE_STEPS


def body_lines(pose: np.ndarray, probe: Probe, settings: SimulatorSettings) -> tuple[np.ndarray, np.ndarray]:
    """Starts, mm, and directions, (layers * scanlines, 3) float64, of a pose of `pose_in_body`."""
    starts, directions = scanlines_in_plane(probe, settings.scanlines, layer_offsets_mm(settings))
    return to_world(pose, starts.reshape(-1, 3)), directions.reshape(-1, 3) @ pose[:3, :3].T


def pitch_mm(probe: Probe, settings: SimulatorSettings) -> float:
    """Side of a lattice cell."""
    return max(settings.scatterer_pitch_mm, fan_of(probe).reach_mm / _MOST_CELLS)


def places_of(lines: tuple[np.ndarray, np.ndarray], pitch: float, settings: SimulatorSettings) -> Places:
    """Where the lines of `body_lines` lie in a lattice whose cells have a side of `pitch`, mm."""
    starts, directions = lines
    # near the first start, so that float32 tells cells apart: 0 within 50 m of the origin at a pitch of 0.1 mm
    anchor = np.rint(starts[0] / (pitch * ANCHOR_CELLS)) * ANCHOR_CELLS
    from_anchor = (starts + (_OFFSET - anchor) * pitch).astype(np.float32)
    cells = np.array([int(number) % 2**32 for number in anchor], np.uint32)
    shape = (settings.layers, settings.scanlines, 3)
    return Places(from_anchor.reshape(shape), directions.astype(np.float32).reshape(shape), cells)


@stage(Stage.grain)
def grain(
    pose: np.ndarray,
    probe: Probe,
    settings: SimulatorSettings,
    seed: int = 0,
    body: np.ndarray | None = None,
) -> np.ndarray:
    """The lattice of scatterers as a pose sees it, before any tissue, ray and point spread function.

    White complex noise of unit power: of every sample the entry that its lattice cell chooses, of all layers, with the
    layers' weights. The simulator's scatterers have the same phases, and amplitudes that grow with these. Samples lie
    at their depths, as those of S and A do: with `depth_mode=time_of_flight` the image shows other samples there.

    Parameters
    ----------
    pose : (4, 4) float
        Rigid transform from probe to world, mm.
    probe : Probe
        Its scanlines.
    settings : SimulatorSettings
        Samples, layers and the pitch of the lattice; `samples_per_row` samples are the two values of a row.
    seed : int
        Of the scatterers, as of `Simulator.render`.
    body : (4, 4) float, optional
        Rigid transform from body to world, mm, as `Scene.body`; the world's axes without it.

    Returns
    -------
    (rows, scanlines, 2) complex64
        Of the first and the second half of each row's samples.

    Raises
    ------
    ValueError
        When a pose is not rigid or the seed negative.
    """
    seed = check_seed(seed)
    posed = pose_in_body(check_pose(pose), np.eye(4) if body is None else check_pose(body))
    pitch = pitch_mm(probe, settings)
    places = places_of(body_lines(posed, probe, settings), pitch, settings)
    depths_mm = sample_depths_mm(probe, settings.axial_samples).astype(np.float32)
    weights = layer_weights(probe, settings)[0].astype(np.float32)
    white = white_table()
    table = np.stack([white.real, white.imag], axis=1)
    field = np.empty((settings.scanlines, settings.axial_samples, 2), np.float32)
    lattice = np.float32(1 / pitch), mix_seed(seed)
    in_parts(partial(_sum_lattice, field, places, (depths_mm, weights, table), lattice), len(field), LINES_OF_A_PART)
    return _of_rows(field.view(np.complex64)[..., 0], settings)


def _of_rows(field: np.ndarray, settings: SimulatorSettings) -> np.ndarray:
    """Values of samples, (scanlines, samples), as those of both halves of each row, (rows, scanlines, 2)."""
    rows, scanlines = settings.beam_shape
    each = field.shape[1] // rows
    half = -(-each // 2)  # the sample in the middle of an odd number belongs to both
    samples_of_rows = field.reshape(scanlines, rows, each)
    halves = [samples_of_rows[..., :half], samples_of_rows[..., each - half :]]
    summed = np.stack([part.sum(axis=-1) for part in halves], axis=-1) / np.float32(np.sqrt(half))
    return np.ascontiguousarray(summed.transpose(1, 0, 2), np.complex64)


@compiled
def _sum_lattice(
    field: np.ndarray,
    places: Places,
    tables: tuple[np.ndarray, np.ndarray, np.ndarray],
    lattice: tuple[np.float32, np.uint32],
    begin: int,
    end: int,
) -> None:
    """Fill some scanlines of `field`, (scanlines, samples, 2): real and imaginary part.

    The tables are depths, (samples,) mm, weights, (layers, samples), and variates, (TABLE_SIZE, 2).
    """
    starts, directions, anchor = places
    depths_mm, weights, variates = tables
    for line in range(begin, end):
        field[line] = 0
        for layer in range(len(weights)):
            start, along = starts[layer, line], directions[layer, line]
            for sample in range(len(depths_mm)):
                entry = entry_of_cell(start, along, depths_mm[sample], anchor, lattice)
                weight = weights[layer, sample]
                field[line, sample, 0] += variates[entry, 0] * weight
                field[line, sample, 1] += variates[entry, 1] * weight
