"""Places to start from: the standard planes of the built-in anatomy, or the probe sites of a scene folder."""

from dataclasses import replace

import numpy as np

from ablate.anatomy import Scene, SiteGrid, fetal_planes
from ablate.dataset import place_probe
from ablate.settings.study import SceneKind, StudySettings

_MOST_SITES = 60  # that a list can be searched by eye


def presets(settings: StudySettings, scene: Scene, grid: SiteGrid) -> dict[str, np.ndarray]:
    """Poses, (4, 4) float64, mm, by name; at least one.

    Of a grid with many sites, evenly spaced ones; there the probe stands upright on the skin and its plane is the first
    of the grid's rolls.

    Raises
    ------
    ValueError
        When the scene has no structure or no probe site of it can be used.
    """
    if settings.scene.kind is SceneKind.fetal:
        planes = fetal_planes(settings.scene.anatomy_seed, settings.dataset.press_mm)
        return {name.replace("_", " "): pose for name, pose in planes.items()}
    upright = replace(grid, tilts_deg=(0.0,), rolls_deg=grid.rolls_deg[:1])
    placed = place_probe(scene, upright, settings.dataset.press_mm, settings.probe).poses
    steps = np.linspace(0, len(placed) - 1, min(len(placed), _MOST_SITES)).round().astype(int)
    angles = len(grid.angles_deg)
    named = {}
    for pose in (placed[i] for i in steps):
        height, angle = grid.heights_mm[pose.site // angles], grid.angles_deg[pose.site % angles]
        named[f"{height:.0f} mm, {angle:.0f} degrees"] = pose.probe_to_world
    return named
