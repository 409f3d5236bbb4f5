"""Labels: which tissue owns each pixel's centre, and each sample of the scanlines."""

from __future__ import annotations

import numpy as np

from ablate.ultrasound.bundle import Bundle
from ablate.ultrasound.embree import Geometry
from ablate.ultrasound.media import Media
from ablate.ultrasound.ownership import Crossings, walk_lines
from ablate.ultrasound.probe import pixel_coordinates_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import ConvexProbe, DepthMode, SimulatorSettings


def fill_rows(row: np.ndarray, first: np.ndarray, value: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Rows of a table that hold one value from each entry's first column to the next one's.

    Parameters
    ----------
    row : (n,) int
        Every row occurs, and its first entry begins at column 0.
    first : (n,) int
        First column of each entry; within a row it never falls.
    value : (n, ...)
    shape : (rows, columns)

    Returns
    -------
    (rows, columns, ...)
    """
    rows, columns = shape
    order = np.argsort(row, kind="stable")
    begin = row[order].astype(np.int64) * columns + np.clip(first[order], 0, columns)
    counts = np.diff(begin, append=rows * columns)
    return np.repeat(value[order], counts, axis=0).reshape(rows, columns, *value.shape[1:])


def first_sample(distance_mm: np.ndarray, first_mm: float, spacing_mm: float) -> np.ndarray:
    """Index of the first sample at or beyond a distance, int64; samples lie at first + k spacing."""
    return np.ceil((distance_mm.astype(np.float64) - first_mm) / spacing_mm).astype(np.int64)


def sample_owners(crossings: Crossings, rows: int, first_mm: float, spacing_mm: float, samples: int) -> np.ndarray:
    """Owner of each sample of each row, (rows, samples) int32."""
    first = first_sample(crossings.distance_mm, first_mm, spacing_mm)
    return fill_rows(crossings.row, np.maximum(first, 0), crossings.owner, (rows, samples))


def displayed(crossings: Crossings, stretch: np.ndarray) -> Crossings:
    """The same crossings at displayed distances, ordered by row.

    Parameters
    ----------
    crossings : Crossings
    stretch : (structures + 1,) float
        Displayed length over geometric length for each owner.

    Returns
    -------
    Crossings
    """
    order = np.argsort(crossings.row, kind="stable")
    row, distance = crossings.row[order], crossings.distance_mm[order].astype(np.float64)
    owner = crossings.owner[order]
    length = np.diff(distance, append=0.0)
    length[np.diff(row, append=-1) != 0] = 0  # a row's last piece has no end
    end = np.cumsum(length * stretch[owner])
    begin = np.concatenate([[0.0], end[:-1]])
    first = np.flatnonzero(np.diff(row, prepend=-1) != 0)
    return Crossings(row, begin - np.repeat(begin[first], np.diff(first, append=len(row))), owner)


def sample_ranges_mm(
    crossings: Crossings, shown: Crossings, stretch: np.ndarray, shape: tuple[int, int], spacing_mm: float
) -> np.ndarray:
    """How far along its line the point lies that each sample displays, (rows, samples) float32, mm."""
    order = np.argsort(crossings.row, kind="stable")
    distance = crossings.distance_mm[order]
    rate = 1 / stretch[shown.owner]
    line = np.stack([distance - rate * shown.distance_mm, rate], axis=-1).astype(np.float32)
    first = np.maximum(first_sample(shown.distance_mm, spacing_mm / 2, spacing_mm), 0)
    pieces = fill_rows(shown.row, first, line, shape)
    depth = ((np.arange(shape[1]) + 0.5) * spacing_mm).astype(np.float32)
    return pieces[..., 0] + pieces[..., 1] * depth


def segment(
    geometry: Geometry,
    tissue_of_owner: np.ndarray,
    probe: ConvexProbe,
    shape: tuple[int, int],
    pose: np.ndarray,
) -> np.ndarray:
    """The tissue that owns each pixel's centre: one ray a pixel column, along the probe's z.

    Parameters
    ----------
    geometry : Geometry
    tissue_of_owner : (structures + 1,) uint8
    probe : ConvexProbe
    shape : (H, W)
    pose : (4, 4) float64
        Probe to the geometry's coordinates, mm.

    Returns
    -------
    (H, W) uint8
        Index of the tissue, inside and outside the fan.
    """
    x, z = pixel_coordinates_mm(probe, shape)
    top = np.stack([x, np.zeros_like(x), np.full_like(x, z[0])], axis=-1)
    starts = to_world(pose, top)
    directions = np.broadcast_to(pose[:3, 2], starts.shape)
    crossings = walk_lines(geometry, starts, directions, len(tissue_of_owner) - 1)
    spacing = (z[-1] - z[0]) / max(shape[0] - 1, 1) or 1.0
    owners = sample_owners(crossings, len(x), 0.0, spacing, shape[0])
    return np.ascontiguousarray(tissue_of_owner[owners].T)


def plane_labels(
    geometry: Geometry,
    tissue_of_owner: np.ndarray,
    probe: ConvexProbe,
    settings: SimulatorSettings,
    pose: np.ndarray,
) -> np.ndarray:
    """The tissue of each sample of the image plane's scanlines, (scanlines, samples) uint8."""
    starts, directions = (part[0] for part in scanlines_in_plane(probe, settings.scanlines, np.zeros(1)))
    starts, directions = to_world(pose, starts), directions @ pose[:3, :3].T
    crossings = walk_lines(geometry, starts, directions, len(tissue_of_owner) - 1)
    spacing = probe.depth_mm / settings.axial_samples
    owners = sample_owners(crossings, len(starts), spacing / 2, spacing, settings.axial_samples)
    return tissue_of_owner[owners]


def sampled_lines(
    geometry: Geometry,
    tissue_of_owner: np.ndarray,
    media: Media,
    bundle: Bundle,
    probe: ConvexProbe,
    settings: SimulatorSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """What each sample of each scanline and layer displays.

    Returns
    -------
    labels : (groups, samples) uint8
        Index of the tissue.
    ranges_mm : (samples,) or, in time-of-flight mode, (groups, samples) float32
        Where along its line the displayed point lies.
    """
    groups, samples = len(bundle.starts), settings.axial_samples
    spacing = probe.depth_mm / samples
    stretch = media.stretch[tissue_of_owner]
    crossings = walk_lines(geometry, bundle.starts, bundle.directions, len(tissue_of_owner) - 1)
    ranges = ((np.arange(samples) + 0.5) * spacing).astype(np.float32)
    if settings.depth_mode is DepthMode.time_of_flight:
        shown = displayed(crossings, stretch)
        ranges = sample_ranges_mm(crossings, shown, stretch, (groups, samples), spacing)
        crossings = shown
    owners = sample_owners(crossings, groups, spacing / 2, spacing, samples)
    return tissue_of_owner[owners], ranges
