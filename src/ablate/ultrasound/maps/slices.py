"""Labels: which tissue owns each pixel's centre, and each sample of the scanlines."""

import numpy as np

from ablate.ultrasound.media import Media
from ablate.ultrasound.probe import pixel_coordinates_mm, sample_depths_mm, scanlines_in_plane, to_world
from ablate.ultrasound.probe_kinds import Probe
from ablate.ultrasound.settings import DepthMode, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.embree import Geometry
from ablate.ultrasound.surfaces.line_walk import Samples, walk
from ablate.ultrasound.transport.rays import Bundle

_ATTEMPTS = 4
_ASIDE_STEPS = 300
_NEARLY_ALONG = 0.9  # cosine


def sample_lines(
    geometry: Geometry, starts: np.ndarray, directions: np.ndarray, samples: Samples
) -> tuple[np.ndarray, np.ndarray]:
    """What each sample of lines holds, (n, samples) uint8, and its distance along its line, (n, samples) float32, mm.

    A line that does not end inside nothing has missed a surface: it jumped over a corner, or ran along an edge. It
    is followed again a few hundredths of a millimetre beside, so that one missed surface does not change all samples
    behind it. `starts` and unit `directions` are (n, 3); distances are (n, 0) where nothing is stretched.
    """
    back, ahead = geometry.through(starts, directions)
    values, ranges_mm = samples.empty(len(starts))
    rows = np.arange(len(starts))
    for attempt in range(_ATTEMPTS):
        aside = attempt * _ASIDE_STEPS * geometry.step_mm * beside(directions[rows])
        origins = starts[rows] + aside - back[rows, None] * directions[rows]
        length = (back + ahead)[rows]
        inside, values[rows], ranges_mm[rows] = walk(geometry, origins, directions[rows], length, samples, back[rows])
        rows = rows[(inside != 0).any(axis=1)]
        if not rows.size:
            break
    return values, ranges_mm


def beside(directions: np.ndarray) -> np.ndarray:
    """Vectors that lead off lines along these unit directions, (n, 3)."""
    turned = np.roll(directions, 1, axis=-1)
    along = np.abs((turned * directions).sum(axis=-1, keepdims=True)) > _NEARLY_ALONG  # as for (1, 1, 1)
    return np.where(along, turned * (1, -1, 0), turned)


@stage(Stage.pixel_labels)
def segment(
    geometry: Geometry, tissue_of_owner: np.ndarray, probe: Probe, shape: tuple[int, int], pose: np.ndarray
) -> np.ndarray:
    """The tissue that owns each pixel's centre, in and outside the fan, (H, W) uint8; one ray a pixel column, along z.

    `pose` takes probe coordinates to the geometry's.
    """
    x, z = pixel_coordinates_mm(probe, shape)
    top = np.stack([x, np.zeros_like(x), np.full_like(x, z[0])], axis=-1)
    starts = to_world(pose, top)
    directions = np.broadcast_to(pose[:3, 2], starts.shape)
    spacing = (z[-1] - z[0]) / max(shape[0] - 1, 1) or 1.0
    labels, _ = sample_lines(geometry, starts, directions, Samples(0.0, spacing, shape[0], tissue_of_owner))
    return np.ascontiguousarray(labels.T)


@stage(Stage.attenuation_labels)
def plane_labels(
    geometry: Geometry, tissue_of_owner: np.ndarray, probe: Probe, settings: SimulatorSettings, pose: np.ndarray
) -> np.ndarray:
    """The tissue of each sample of the image plane's scanlines, (scanlines, samples) uint8."""
    starts, directions = (part[0] for part in scanlines_in_plane(probe, settings.scanlines, np.zeros(1)))
    starts, directions = to_world(pose, starts), directions @ pose[:3, :3].T
    spacing = probe.depth_mm / settings.axial_samples
    samples = Samples(spacing / 2, spacing, settings.axial_samples, tissue_of_owner)
    return sample_lines(geometry, starts, directions, samples)[0]


@stage(Stage.scanline_labels)
def scanline_labels(
    geometry: Geometry,
    tissue_of_owner: np.ndarray,
    media: Media,
    bundle: Bundle,
    probe: Probe,
    settings: SimulatorSettings,
) -> tuple[np.ndarray, np.ndarray]:
    """The tissue that each sample of each scanline and layer displays, (groups, samples) uint8.

    Also its distance along its line in mm, float32: (samples,) or, in time-of-flight mode, (groups, samples).
    """
    spacing = probe.depth_mm / settings.axial_samples
    stretched = settings.depth_mode is DepthMode.time_of_flight
    stretch = media.stretch[tissue_of_owner] if stretched else None
    samples = Samples(spacing / 2, spacing, settings.axial_samples, tissue_of_owner, stretch)
    labels, ranges = sample_lines(geometry, bundle.starts, bundle.directions, samples)
    return labels, ranges if stretched else sample_depths_mm(probe, samples.count).astype(np.float32)
