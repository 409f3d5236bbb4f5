"""One run that a command line asks for: its settings, its label, its identity, and the place that they give it."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ablate.settings.study import StudySettings
from ablate.storage import digest
from ablate.validation import check_name

if TYPE_CHECKING:
    from ablate.runs.data_set import DataSet
    from ablate.runs.run import Run

COMPARISON = "comparison"  # folder beside those of the variants


@dataclass(frozen=True)
class Job:
    """One cell of a sweep.

    What reads files is imported where it is asked for: a command line is checked without it.

    Attributes
    ----------
    label : str
        The variant and what else was changed beside it, such as `sa2h.depth-8`.
    changed : tuple of (str, object)
        The dotted keys that were changed beside the variant, with their values.
    """

    settings: StudySettings
    label: str
    changed: tuple[tuple[str, Any], ...] = field(default=(), compare=False)

    def __post_init__(self) -> None:
        check_name("variant", self.label, {COMPARISON})

    @property
    def name(self) -> str:
        return f"{self.label}/seed{self.settings.seed}"

    @property
    def folder(self) -> Path:
        return self.settings.study_dir / self.label / f"seed{self.settings.seed}"

    @cached_property
    def semantic(self) -> dict[str, Any]:
        """The settings that decide the result, as JSON values; computed once, as files of scenes are read for it."""
        from ablate.runs.identity import semantic

        return semantic(self.settings)

    @cached_property
    def hash(self) -> str:
        """The identity of the run: a digest of `semantic`."""
        return digest(self.semantic)

    @property
    def data(self) -> DataSet:
        """The pairs that it reads, as they lie on disk now."""
        from ablate.runs.data_set import DataSet

        name = f"{self.settings.scene_name}-{digest(self.semantic['data'])}"
        return DataSet(self.settings.results / "data" / name)

    @property
    def run(self) -> Run:
        """Its folder as it is now."""
        from ablate.runs.run import Run

        return Run(self.folder)


def parameters(s: StudySettings) -> dict[str, float]:
    """Count the parameters of the generator and of the discriminator, which is 0 for a job that trains without one."""
    from ablate import networks

    discriminator = networks.count_discriminator(s.model, s.training.discriminator_width)
    return {
        "parameters_generator": float(networks.count_generator(s.model)),
        "parameters_discriminator": float(discriminator if s.training.has_discriminator else 0),
    }
