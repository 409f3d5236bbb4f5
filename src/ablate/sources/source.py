"""What a study asks of the place where its pairs come from.

A new kind of source is a module of `ablate.sources.kinds` and its file in conf/scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from ablate.setting import did_you_mean, shown
from ablate.settings.study import ConfigurationError, StudySettings

if TYPE_CHECKING:
    import numpy as np

    from ablate.anatomy import Scene, SiteGrid


class Source(Protocol):
    """Where pairs come from, for the settings of one job."""

    has_scene: ClassVar[bool]
    """Whether there is an anatomy that can be simulated at any pose; pairs made elsewhere have none."""

    def __init__(self, settings: StudySettings) -> None: ...

    def identity(self) -> dict[str, Any]:
        """What every pair is made from, as JSON values. Files are read: equal contents give equal values."""

    def check(self, label: str) -> int:
        """Refuse files or settings that cannot be used, for the variant `label`; a ConfigurationError of one line.

        Returns the number of training frames that there will be.
        """

    def offered(self, maps: frozenset[str]) -> frozenset[str]:
        """Those of the maps that there can be."""

    def scene(self) -> tuple[Scene, SiteGrid]:
        """The anatomy and its own grid of probe sites; a ValueError where there is none, or a mesh is unusable."""

    def planes(self) -> Mapping[str, np.ndarray]:
        """Standard planes of the anatomy: poses, (4, 4) float64, mm, by name; none where it has none."""

    def fill(self, folder: Path, maps: frozenset[str], recipe: Mapping[str, object]) -> None:
        """Make the data set in `folder`, or what is missing of it.

        The `recipe`, what was left out and why, and what else a reader needs are kept in `about.json`.
        """


def kinds() -> tuple[str, ...]:
    """The kinds of sources that there are."""
    package = import_module("ablate.sources.kinds")
    return tuple(sorted(module.name for module in iter_modules(package.__path__)))


def source_of(settings: StudySettings) -> Source:
    """The source that `scene.kind` names; a kind that there is not is a ConfigurationError."""
    kind = settings.scene.kind
    if kind not in kinds():
        hint = did_you_mean(kind, kinds())
        raise ConfigurationError(f"scene.kind={shown(kind)}: allowed are {', '.join(kinds())}{hint}")
    source: type[Source] = import_module(f"ablate.sources.kinds.{kind}").SOURCE
    return source(settings)
