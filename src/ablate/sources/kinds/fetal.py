"""`scene=fetal`: the built-in anatomy, simulated."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ablate import anatomy
from ablate.anatomy import ANATOMY_VERSION, Scene, SiteGrid
from ablate.setting import shown
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.sources import simulated


class BuiltInAnatomy:
    """The second-trimester abdomen of `ablate.anatomy.fetal_abdomen`."""

    has_scene: ClassVar[bool] = True

    def __init__(self, settings: StudySettings) -> None:
        self.settings = settings

    def identity(self) -> dict[str, Any]:
        """See `Source.identity`."""
        scene = {
            "kind": "fetal",
            "version": ANATOMY_VERSION,
            "triangles": self.settings.scene.triangles,
            "anatomy_seed": self.settings.scene.anatomy_seed,
        }
        return simulated.identity_of(self.settings, scene)

    def check(self, label: str) -> int:  # noqa: ARG002  # any variant can be simulated
        """See `Source.check`."""
        if folder := self.settings.scene.folder:
            other = "scene=pairs where it holds pictures"
            raise ConfigurationError(
                f"scene.folder={shown(folder)}: the built-in anatomy has no folder; add scene=folder, or {other}"
            )
        return simulated.check_frames(self.settings, anatomy.fetal_sites())

    def offered(self, maps: frozenset[str]) -> frozenset[str]:
        """All maps."""
        return maps

    def scene(self) -> tuple[Scene, SiteGrid]:
        """See `Source.scene`."""
        chosen = self.settings.scene
        cache = simulated.anatomy_cache(self.settings)
        return anatomy.fetal_abdomen(chosen.triangles, chosen.anatomy_seed, cache_dir=cache), anatomy.fetal_sites()

    def planes(self) -> Mapping[str, np.ndarray]:
        """See `Source.planes`."""
        return anatomy.fetal_planes(self.settings.scene.anatomy_seed, self.settings.dataset.press_mm)

    def fill(self, folder: Path, maps: frozenset[str], recipe: Mapping[str, object]) -> None:
        """See `Source.fill`."""
        simulated.simulate_data(self.settings, self.scene(), folder, maps, recipe)


SOURCE = BuiltInAnatomy
