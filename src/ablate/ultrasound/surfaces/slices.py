"""Labels: which tissue owns each pixel's centre and each sample of the scanlines, and what sound can leave the face."""

from collections.abc import Sequence

import numpy as np

from ablate.anatomy import Tissue
from ablate.ultrasound.media import RenderPlan, loss_db_mm
from ablate.ultrasound.probe import pixel_coordinates_mm, sample_depths_mm, scanlines_in_plane, to_world
from ablate.ultrasound.settings import DepthMode, Probe, SimulatorSettings
from ablate.ultrasound.stages import Stage, stage
from ablate.ultrasound.surfaces.geometry import Geometry
from ablate.ultrasound.surfaces.line_walk import Samples, walk

FACE_MRAYL = 1.5  # of the last of a probe's matching layers: as water and soft tissue
NEAR_PART = 0.1  # of the imaging depth: sound must leave this part ...
#: ... with a smaller two-way loss than this, two thirds of a display of 60 dB. In 15 mm at 8 MHz soft tissue takes up
#: to 20 dB and bone 170; 2 mm of bone, a thin skull, take 26; gas takes 59 by its impedance alone.
BLOCKED_FROM_DB = 40.0
_ATTEMPTS = 4
_ASIDE_STEPS = 300
_NEARLY_ALONG = 0.9  # cosine
Lines = tuple[np.ndarray, np.ndarray]  # starts and unit directions, (n, 3) each


def sample_lines(
    geometry: Geometry, starts: np.ndarray, directions: np.ndarray, samples: Samples
) -> tuple[np.ndarray, np.ndarray]:
    """What each sample of some lines holds.

    A line that does not end inside nothing has missed a surface: it jumped over a corner, or ran along an edge. It
    is followed again a few hundredths of a millimetre beside, so that one missed surface does not change all samples
    behind it.

    Parameters
    ----------
    geometry : Geometry
        The triangles.
    starts, directions : (n, 3) float64
        mm in the geometry's coordinates, and unit vectors.
    samples : Samples
        Where they lie on a line, and the value of each structure.

    Returns
    -------
    values : (n, samples) uint8
        The value of each sample's owner.
    ranges_mm : (n, samples) float32
        How far along its line a sample lies; (n, 0) where nothing is stretched.
    """
    back, ahead = geometry.through(starts, directions)
    inside, values, ranges_mm = walk(geometry, starts, directions, (back, ahead), samples)
    rows = np.arange(len(starts))
    for attempt in range(1, _ATTEMPTS):
        rows = rows[(inside != 0).any(axis=1)]
        if not rows.size:
            break
        aside = attempt * _ASIDE_STEPS * geometry.step_mm * beside(directions[rows])
        reach = back[rows], ahead[rows]
        inside, values[rows], ranges_mm[rows] = walk(geometry, starts[rows] + aside, directions[rows], reach, samples)
    return values, ranges_mm


def beside(directions: np.ndarray) -> np.ndarray:
    """Vectors that lead off lines along these unit directions, (n, 3)."""
    turned = np.roll(directions, 1, axis=-1)
    along = np.abs((turned * directions).sum(axis=-1, keepdims=True)) > _NEARLY_ALONG  # as for (1, 1, 1)
    return np.where(along, turned * (1, -1, 0), turned)


@stage(Stage.pixel_labels)
def segment(
    geometry: Geometry, tissue_of_owner: np.ndarray, probe: Probe, fan: np.ndarray, pose: np.ndarray
) -> np.ndarray:
    """1 + the tissue that owns each pixel's centre, 0 outside the fan; one ray a pixel row, along x.

    Parameters
    ----------
    geometry : Geometry
        The triangles.
    tissue_of_owner : (structures + 1,) uint8
        The tissue of the background, and of each structure.
    probe : Probe
        Its image.
    fan : (H, W) bool
        Which pixels are in the fan.
    pose : (4, 4) float64
        From probe to the geometry's coordinates.

    Returns
    -------
    (H, W) uint8
        The labels.
    """
    x, z = pixel_coordinates_mm(probe, fan.shape)
    starts = to_world(pose, np.stack([np.full_like(z, x[0]), np.zeros_like(z), z], axis=-1))
    directions = np.broadcast_to(pose[:3, 0], starts.shape)
    spacing = (x[-1] - x[0]) / max(len(x) - 1, 1) or 1.0
    labels, _ = sample_lines(geometry, starts, directions, Samples(0.0, spacing, len(x), tissue_of_owner + np.uint8(1)))
    return np.multiply(labels, fan, out=labels)


@stage(Stage.attenuation_labels)
def plane_labels(
    geometry: Geometry,
    tissue_of_owner: np.ndarray,
    probe: Probe,
    settings: SimulatorSettings,
    pose: np.ndarray,
    steered_rad: float = 0.0,
) -> np.ndarray:
    """The tissue of each sample of the image plane's scanlines.

    Parameters
    ----------
    geometry : Geometry
        The triangles.
    tissue_of_owner : (structures + 1,) uint8
        The tissue of the background, and of each structure.
    probe : Probe
        Its scanlines.
    settings : SimulatorSettings
        How many scanlines and samples there are.
    pose : (4, 4) float64
        From probe to the geometry's coordinates.
    steered_rad : float
        Angle that the scanlines are steered by.

    Returns
    -------
    (scanlines, samples) uint8
        Indices in `Scene.tissues`.
    """
    starts, directions = (part[0] for part in scanlines_in_plane(probe, settings.scanlines, np.zeros(1), steered_rad))
    starts, directions = to_world(pose, starts), directions @ pose[:3, :3].T
    spacing = probe.depth_mm / settings.axial_samples
    samples = Samples(spacing / 2, spacing, settings.axial_samples, tissue_of_owner)
    return sample_lines(geometry, starts, directions, samples)[0]


@stage(Stage.scanline_labels)
def scanline_labels(
    geometry: Geometry, plan: RenderPlan, lines: Lines, probe: Probe, settings: SimulatorSettings
) -> tuple[np.ndarray, np.ndarray]:
    """The tissue that each sample of each scanline and layer displays.

    Parameters
    ----------
    geometry : Geometry
        The triangles.
    plan : RenderPlan
        The tissues of its structures.
    lines : tuple of two (groups, 3) float64
        Starts, mm in the geometry's coordinates, and unit directions.
    probe : Probe
        How deep it sees.
    settings : SimulatorSettings
        How many samples there are, and what their depth means.

    Returns
    -------
    labels : (groups, samples) uint8
        Indices in `Scene.tissues`.
    ranges_mm : (samples,) or, in time-of-flight mode, (groups, samples) float32
        How far along its line a sample lies.
    """
    spacing = probe.depth_mm / settings.axial_samples
    stretched = settings.depth_mode is DepthMode.time_of_flight
    samples = Samples(spacing / 2, spacing, settings.axial_samples, plan.tissue_of_owner)
    if stretched:
        samples = samples._replace(stretch_of_owner=plan.media.stretch[plan.tissue_of_owner])
    labels, ranges = sample_lines(geometry, *lines, samples)
    return labels, ranges if stretched else sample_depths_mm(probe, samples.number).astype(np.float32)


def contact_warning(labels: np.ndarray, tissues: Sequence[Tissue], probe: Probe) -> str | None:
    """What keeps the probe from seeing the scene; its image is right all the same, but dark or empty.

    Either more than half of the scanlines start in a tissue that lets hardly any sound out, as bone and gas do; or all
    of them stay in the background, the first tissue, which has no scatterers though the scene has other tissues. The
    words are the same for all poses that are wrong in the same way, so that a warning can be given once.
    `labels`, (scanlines, samples), index `tissues`; they are of all layers, so that what only outer ones see counts.
    """
    if len(tissues) > 1 and tissues[0].scatter_power == 0 and not labels.any():
        return f"no scanline meets anything but {tissues[0].name}, the background: the probe looks past the scene"
    near = labels[:, : int(NEAR_PART * labels.shape[1])]
    if near.size == 0:  # too few samples to tell
        return None
    first = near[:, 0]
    other = near != first[:, None]
    run = np.where(other.any(axis=1), other.argmax(axis=1), near.shape[1])
    run_mm = run * (probe.depth_mm / labels.shape[1])
    impedance = np.array([t.impedance_mrayl for t in tissues])
    # Through the face and back: the transmitted share of the intensity is the two-way amplitude.
    face_db = -20 * np.log10(4 * FACE_MRAYL * impedance / (FACE_MRAYL + impedance) ** 2)
    path_db_mm = np.array([2 * loss_db_mm(t, probe.frequency_mhz) for t in tissues])
    blocked = face_db[first] + path_db_mm[first] * run_mm > BLOCKED_FROM_DB
    if blocked.mean() <= 0.5:
        return None
    names = " and ".join(tissues[i].name for i in np.unique(first[blocked]))
    return f"most scanlines start in {names}, which lets hardly any sound out: the image is dark beyond it"
