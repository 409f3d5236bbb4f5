"""One run that a command line asks for: its label, its place, and its identity, the settings that decide its result."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ablate.dataset.encoding import Encoding
from ablate.setting import check_name, identity
from ablate.settings.study import StudySettings
from ablate.storage import digest
from ablate.training.settings import TRAINING_VERSION, TrainingPrecision, TrainingSettings
from ablate.user_code import source_digest

if TYPE_CHECKING:
    from ablate.networks import GeneratorSpec
    from ablate.runs.data_set import DataSet
    from ablate.runs.run import Run

COMPARISON = "comparison"  # folder beside those of the variants
#: The keys of `Job.semantic` in which the runs of one study may differ besides what their labels say.
_OF_A_RUN = ("seed", "training.seed", "training.loss", "data.scene.anatomy_seed")
_NOT_OF_ALL = ("crops", "fan_fraction"), ("training", "discriminator_width")  # only of crops, only of a discriminator
_OF_THE_DATA = ("scene", "probe", "simulator", "dataset")


@dataclass(frozen=True)
class Job:
    """One cell of a sweep.

    What reads files is imported where it is asked for: a command line is checked without it.
    """

    settings: StudySettings
    label: str  # the variant and what else was changed beside it, such as `sa2h.depth-8`
    changed: tuple[tuple[str, Any], ...] = field(default=(), compare=False)  # dotted keys beside the variant, values

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
        """The settings that decide the trained network and its scores, as JSON values.

        A network of the user's has the digest of its code. Where files decide, as of a scene folder, they are read:
        it is computed once.
        """
        from ablate.runs.data_set import about_data

        s, target = self.settings, self.settings.model.target
        order = {"order": s.encoding.name}
        training, crops = identity(s.training), identity(s.crops)
        if not s.training.has_discriminator:
            del training["discriminator_width"]
        if not s.training.crop:  # whole frames
            del crops["fan_fraction"]
        return {
            "data": about_data(s),
            "encoding": order | ({"seed": s.label_seed} if s.encoding is Encoding.arbitrary else {}),
            "model": identity(s.model) | ({"source": source_digest(target)} if target else {}),
            "training": training | {"precision": precision_of(s.training).name},
            "training_version": TRAINING_VERSION,
            "evaluation": identity(s.evaluation),
            "crops": crops,
            "seed": s.seed,
        }

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


def precision_of(training: TrainingSettings) -> TrainingPrecision:
    """The precision that a training has on this machine: `auto` depends on the device."""
    if training.precision is not TrainingPrecision.auto:
        return training.precision
    from ablate.training import chosen_device, chosen_precision  # loads PyTorch

    return chosen_precision(training.precision, chosen_device(training.device))


def differences(a: Any, b: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Dotted keys in which two nested dicts differ, with the value of each; None where one has none."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for k in sorted(a.keys() | b.keys()):
            yield from differences(a.get(k), b.get(k), f"{key}.{k}".lstrip("."))
    elif a != b:
        yield key, a, b


def not_shared(
    a: Mapping[str, Any], b: Mapping[str, Any], labelled: Collection[str], presets: tuple[object, object]
) -> list[tuple[str, Any, Any]]:
    """What differs between two runs of one study, given by `Job.semantic`, and should not.

    The runs of a study share pairs, training, crops, evaluation and width. They may differ in what their labels tell
    apart: network, encoding, seed, adversarial loss, anatomy, and the configuration keys `labelled`. Runs of two
    `presets`, if labels tell them, may differ in everything.
    """
    if "preset" in labelled and presets[0] != presets[1]:
        return []
    told = (*_OF_A_RUN, "encoding", "model", *(semantic_key(key) for key in labelled))
    told += ("data",) if "probe" in labelled else ()
    told += tuple(f"{part}.{name}" for part, name in _NOT_OF_ALL if any(name not in of.get(part, {}) for of in (a, b)))
    width = () if "model.width" in labelled else ("model.width",)
    return [
        (key, there, here)
        for key, there, here in differences(a, b)
        if key in width or not f"{key}.".startswith(tuple(f"{one}." for one in told))
    ]


def semantic_key(key: str) -> str:
    """The key of `Job.semantic` that a key of the command line decides, such as `data.dataset.frames`."""
    return f"data.{key}" if key.partition(".")[0] in _OF_THE_DATA else key


def parameters(s: StudySettings, spec: GeneratorSpec, labels: int) -> dict[str, float]:
    """Count the parameters of the generator and of the discriminator, which is 0 for a job that trains without one."""
    from ablate import networks

    discriminator = networks.count_discriminator(spec, s.training.discriminator_width, labels)
    return {
        "parameters_generator": float(networks.count_generator(spec, labels)),
        "parameters_discriminator": float(discriminator if s.training.has_discriminator else 0),
    }
