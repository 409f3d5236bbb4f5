"""`scene=folder`: meshes or labels of your own with a scene.yaml, simulated."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ablate import anatomy
from ablate.anatomy import ANATOMY_VERSION, LABELS_VERSION, Scene, SiteGrid
from ablate.settings.study import ConfigurationError, StudySettings, Task, refusing
from ablate.sources import simulated
from ablate.storage import digest_of_files


class SceneFolder:
    """The folder that `scene.folder` names."""

    has_scene: ClassVar[bool] = True

    def __init__(self, settings: StudySettings) -> None:
        self.settings = settings

    @property
    def folder(self) -> Path:
        return Path(self.settings.scene.folder or "")

    def identity(self) -> dict[str, Any]:
        """See `Source.identity`."""
        checked = anatomy.validate_scene_folder(self.folder)
        files = digest_of_files([self.folder / "scene.yaml", *checked.files])
        scene: dict[str, Any] = {"kind": "folder", "version": ANATOMY_VERSION, "files": files}
        if checked.labels:
            scene["labels_version"] = LABELS_VERSION
            if checked.labels.table and checked.sites and checked.sites.region:  # what the probe looks at, by its name
                scene["table"] = digest_of_files([checked.labels.table])
        return simulated.identity_of(self.settings, scene)

    def check(self, label: str) -> int:  # noqa: ARG002  # any variant can be simulated
        """See `Source.check`."""
        if not self.settings.scene.folder:
            raise ConfigurationError("scene=folder needs scene.folder=path/to/folder")
        with refusing():
            sites = anatomy.validate_scene_folder(self.folder).sites
        if sites is None and not self._needs_no_sites:
            raise ConfigurationError(f"{self.folder}/scene.yaml has no `sites`: where to put the probe")
        return simulated.check_frames(self.settings, sites)

    def offered(self, maps: frozenset[str]) -> frozenset[str]:
        """All maps."""
        return maps

    def scene(self) -> tuple[Scene, SiteGrid]:
        """See `Source.scene`."""
        loaded = anatomy.load_scene(self.folder, simulated.anatomy_cache(self.settings))
        if self._needs_no_sites:
            return loaded, anatomy.validate_scene_folder(self.folder).sites or SiteGrid()
        return loaded, anatomy.load_sites(self.folder)

    def planes(self) -> Mapping[str, np.ndarray]:
        """None: what stands in a scene.yaml are probe sites."""
        return {}

    def fill(self, folder: Path, maps: frozenset[str], recipe: Mapping[str, object]) -> None:
        """See `Source.fill`."""
        simulated.simulate_data(self.settings, self.scene(), folder, maps, recipe)

    @property
    def _needs_no_sites(self) -> bool:
        """Whether the poses are given otherwise."""
        settings = self.settings
        posed = bool(settings.pose) and settings.task in (Task.render, Task.view)
        return bool(settings.dataset.poses) or posed or bool(settings.plane)


SOURCE = SceneFolder
