"""Which frames a data set of a scene holds: their poses, sites and parts, in the order of the data set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ablate.anatomy import Scene, SiteGrid
from ablate.config import StudySettings
from ablate.dataset import Placement, choose_frames, place_probe, resample_grid, split_frames


@dataclass(frozen=True)
class Layout:
    """The frames of a data set before any is simulated.

    Attributes
    ----------
    poses : (n, 4, 4) float64
        Probe to world, mm.
    sites : (n,) int64
    split : (n,) uint8 of `Part`
    placement : Placement
        What the frames were chosen from, and what was dropped.
    """

    poses: np.ndarray
    sites: np.ndarray
    split: np.ndarray
    placement: Placement

    def __len__(self) -> int:
        return len(self.sites)


def lay_out(settings: StudySettings, scene: Scene, grid: SiteGrid) -> Layout:
    """Place the probe, choose the frames and split them; where fewer poses can be used than asked for, all of them.

    Raises
    ------
    ValueError
        When no pose can be used, or too few sites are left to be split.
    """
    chosen = settings.dataset
    placement = place_probe(scene, resample_grid(grid, chosen.grid), chosen.press_mm, settings.probe)
    poses = placement.poses
    picked = choose_frames([p.site for p in poses], min(chosen.frames, len(poses)), chosen.seed)
    sites = np.array([poses[i].site for i in picked])
    split = split_frames(sites, chosen.split, chosen.validation, chosen.test, chosen.seed)
    order = np.argsort(split, kind="stable")  # validation and test frames lie together: few shards hold both
    return Layout(np.stack([poses[picked[i]].probe_to_world for i in order]), sites[order], split[order], placement)
