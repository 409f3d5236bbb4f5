"""Frames that reach beyond the end of the volume that their scene was made from: they are cut off straight there."""

from collections.abc import Sequence

import numpy as np

from ablate.anatomy import Scene, is_behind_walls
from ablate.ultrasound import Probe, fan_mask
from ablate.ultrasound.probe import pixel_coordinates_mm, to_world

_SHAPE = (48, 64)  # points at which a frame is looked at
_LEAST_SHARE = 0.01  # of the fan, or nobody sees it
_NAMED = 5


def cut_share(scene: Scene, probe: Probe, pose: np.ndarray) -> float:
    """The share of a frame's fan that lies behind the end of the volume; `pose` is probe to world, (4, 4), mm."""
    x, z = np.meshgrid(*pixel_coordinates_mm(probe, _SHAPE))
    inside = fan_mask(probe, _SHAPE)
    points = np.stack([x[inside], np.zeros(inside.sum()), z[inside]], axis=-1)
    return float(is_behind_walls(scene, to_world(pose, points)).mean())


def cut_frames(scene: Scene, probe: Probe, poses: Sequence[np.ndarray] | np.ndarray) -> str:
    """A sentence about the frames of some poses that are cut off; empty where there is none."""
    cut = [number for number, pose in enumerate(poses) if cut_share(scene, probe, pose) >= _LEAST_SHARE]
    if not cut:
        return ""
    named = ", ".join(map(str, cut[:_NAMED])) + (", ..." if len(cut) > _NAMED else "")
    behind = f"behind it is only {scene.background.name}"
    return f"{len(cut)} of {len(poses)} frames are cut off straight where the volume ends, {behind}: {named}"
