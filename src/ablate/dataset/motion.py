"""Frames after a known motion of the probe: is the grain of an image that of the body, or that of the screen?"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from ablate.dataset.pairs import Pairs
from ablate.dataset.split import equally_spaced
from ablate.ultrasound.probe import fan_of, pixel_coordinates_mm, scanline_positions
from ablate.ultrasound.settings import LinearProbe, PhasedProbe, Probe

#: The folder of these frames in that of their data set.
MOVED_FOLDER = "motion"
_MOST = 8  # frames that are moved, and
_SHARE = 4  # at most every fourth test frame
_ROCK_LINES = 2
_SLIDE_MM = 1.0
_LIFT_MM = 0.3


class Motion(StrEnum):
    """How the probe moves: rocked by two scanlines, slid 1 mm along the skin, shifted 0.3 mm out of its plane."""

    rock = "rock"
    slide = "slide"
    lift = "lift"


@dataclass(frozen=True)
class Moved:
    """Frames after motions.

    Attributes
    ----------
    pairs : Pairs
        With the maps of their data set.
    before : (n,) int
        The frame of the data set that each was before.
    motions : tuple of Motion
        Of each.
    """

    pairs: Pairs
    before: np.ndarray
    motions: tuple[Motion, ...]


def moved_frames(test_frames: np.ndarray) -> np.ndarray:
    """Numbers of the test frames that are moved."""
    return equally_spaced(test_frames, min(_MOST, max(1, len(test_frames) // _SHARE)))


def motion_of(motion: Motion, probe: Probe, scanlines: int) -> np.ndarray:
    """The rigid transform, (4, 4) float64, mm, from the probe's coordinates after a motion to those before.

    A pose after the motion is the pose before times this. A linear probe, whose scanlines are parallel, is not rocked
    but slid by two of them.
    """
    moved = np.eye(4)
    if motion is Motion.slide:
        moved[0, 3] = _SLIDE_MM
    elif motion is Motion.lift:
        moved[1, 3] = _LIFT_MM
    else:
        positions = scanline_positions(probe, scanlines)
        step = _ROCK_LINES * float(positions[-1] - positions[0]) / max(scanlines - 1, 1)
        if isinstance(probe, LinearProbe):
            moved[0, 3] = step
            return moved
        radius = 0.0 if isinstance(probe, PhasedProbe) else fan_of(probe).reach_mm - probe.depth_mm
        cosine, sine = math.cos(step), math.sin(step)
        moved[:3, :3] = [[cosine, 0.0, sine], [0.0, 1.0, 0.0], [-sine, 0.0, cosine]]
        moved[:3, 3] = [radius * sine, 0.0, radius * (cosine - 1)]
    return moved


def moved_poses(poses: np.ndarray, probe: Probe, scanlines: int) -> tuple[np.ndarray, tuple[Motion, ...]]:
    """Poses, (k, 4, 4), after every motion, (3 k, 4, 4), and these motions, pose by pose."""
    motions = {motion: motion_of(motion, probe, scanlines) for motion in Motion}
    moved = [pose @ motion for pose in poses for motion in motions.values()]
    return np.stack(moved), tuple(motions) * len(poses)


def places_before(
    motion: Motion, probe: Probe, scanlines: int, image_shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Row and column, px, where the image before a motion shows what each pixel shows after it.

    What left the plane is taken for what lies beside it in the plane.

    Parameters
    ----------
    motion : Motion
        Of the probe.
    probe : Probe
        Its image.
    scanlines : int
        Of a frame; the probe is rocked by two of them.
    image_shape : (H, W)
        Of the image.

    Returns
    -------
    two of (H, W) float64
        Rows and columns, also beyond the image.
    """
    x, z = pixel_coordinates_mm(probe, image_shape)
    points = np.stack([*np.broadcast_arrays(x[None, :], 0.0, z[:, None])], axis=-1)
    transform = motion_of(motion, probe, scanlines)
    before = points @ transform[:3, :3].T + transform[:3, 3]
    steps: Sequence[float] = [(axis[-1] - axis[0]) / max(len(axis) - 1, 1) or 1.0 for axis in (z, x)]
    return (before[..., 2] - z[0]) / steps[0], (before[..., 0] - x[0]) / steps[1]
