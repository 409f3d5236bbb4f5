"""One run of a study: its settings, its label, and the name and place that they give it."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from omegaconf import OmegaConf

from ablate.config import StudySettings, json_ready
from ablate.studies.jobs.conf_folder import configuration_dir
from ablate.studies.jobs.hydra_internals import Override, parse_overrides
from ablate.training.settings import TrainingSettings
from ablate.validation import check_name

COMPARISON = "comparison"  # folder beside those of the variants
CUSTOM = "custom"  # the variant that a user's network takes the place of


@dataclass(frozen=True)
class Job:
    """One cell of a sweep; `label` is the variant and what else was changed beside it (`sa2h.depth-8`)."""

    settings: StudySettings
    label: str

    def __post_init__(self) -> None:
        check_name("variant", self.label, {COMPARISON})

    @property
    def name(self) -> str:
        return f"{self.label}/seed{self.settings.seed}"

    @property
    def folder(self) -> Path:
        return self.settings.study_dir / self.label / f"seed{self.settings.seed}"


def label_of(settings: StudySettings, overrides: Sequence[str]) -> str:
    """A run's label from its settings and the overrides that they were composed with.

    It names the components, and the adversarial loss, that an override sets to another value than the variant's at this
    frame size. The width is a size of the whole study, like the number of steps, and no part of it. A network of the
    user's has the name of its class.
    """
    values = {**json_ready(settings.model), "encoding": settings.encoding.name, "loss": settings.training.loss.name}
    own = {"encoding": "echogenicity", "loss": TrainingSettings.loss.name, **_own_values(settings)}
    changed = {name for override in parse_overrides(overrides) for name in _components(override)}
    variant = settings.variant
    if variant == CUSTOM:
        variant = str(settings.model.target).rpartition(".")[2]
        changed -= {"target"}
    named = [f"{name}-{values[name]}" for name in sorted(changed) if str(own.get(name)) != str(values[name])]
    return ".".join([variant, *(re.sub(r"[^A-Za-z0-9.+_-]", "_", name) for name in named)])


def _components(override: Override) -> Iterator[str]:
    """What an override sets: `model.depth=8`, `model={depth:8,noise:input}`, `encoding=...` or `training.loss=...`."""
    key, value = override.key_or_group, override.value()
    if key == "model" and isinstance(value, dict):
        yield from (str(name) for name in value if name != "width")
    elif key == "encoding" or (key.startswith("model.") and key != "model.width"):
        yield key.removeprefix("model.")
    elif key == "training.loss" or (key == "training" and isinstance(value, dict) and "loss" in value):
        yield "loss"


def _own_values(settings: StudySettings) -> dict[str, object]:
    """What the file of a variant sets of `model` and of the loss, with the levels that it has at this frame size."""
    frame = {"simulator": {"image_shape": list(settings.simulator.image_shape)}}
    own = OmegaConf.to_container(OmegaConf.create({**frame, "model": _values_of(settings.variant)}), resolve=True)
    assert isinstance(own, dict)
    return dict(own["model"])


def _values_of(variant: str) -> dict[str, object]:
    """The keys of `model` and `training` in a file of conf/variant; none for a variant from a folder of the user."""
    path = configuration_dir() / "variant" / f"{variant}.yaml"
    if not path.exists():
        return {}
    own = OmegaConf.to_container(OmegaConf.load(path))
    assert isinstance(own, dict)
    inherited = [_values_of(str(parent)) for parent in own.get("defaults", [])]
    return {k: v for values in (*inherited, own.get("model", {}), own.get("training", {})) for k, v in values.items()}
