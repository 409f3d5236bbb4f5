"""One job of a command line: a training that it asks for, by what decides its weights, and how it is to be scored."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ablate.dataset.encoding import Encoding
from ablate.setting import check_name, identity, plain
from ablate.settings.study import ConfigurationError, StudySettings
from ablate.storage import digest
from ablate.study.source_code import loaded_digest
from ablate.training.settings import TRAINING_VERSION, TrainingPrecision, TrainingSettings
from ablate.user_code import code_digest

if TYPE_CHECKING:
    from ablate.networks import GeneratorSpec
    from ablate.sources.data_set import DataSet
    from ablate.study.scores import ScoreKey
    from ablate.study.training import Training

_OF_THE_DATA = ("scene", "probe", "simulator", "dataset")


@dataclass(frozen=True)
class Job:
    """One cell of a sweep.

    What reads files is imported where it is asked for: a command line is checked without it.
    """

    settings: StudySettings
    label: str  # the variant and what else was changed beside it, such as `sa2h.depth-8`
    changed: tuple[tuple[str, Any], ...] = field(default=(), compare=False)  # dotted keys beside the variant, values
    words: tuple[str, ...] = field(default=(), compare=False)  # after `python -m ablate`, that stand for it alone
    source: str = field(default_factory=loaded_digest, compare=False)  # the package's code where it was composed

    def __post_init__(self) -> None:
        check_name("variant", self.label)

    @property
    def name(self) -> str:
        return f"{self.label}/seed{self.settings.seed}"

    @cached_property
    def identity(self) -> dict[str, Any]:
        """The settings that decide the weights, as JSON values.

        A network of the user's has the digest of its code. Where files decide, as of a scene folder, they are read:
        it is computed once.
        """
        from ablate.sources.source import source_of

        settings = self.settings
        encoding: dict[str, Any] = {"order": settings.encoding.name}
        if settings.encoding is Encoding.arbitrary:
            encoding["seed"] = settings.label_seed
        model = identity(settings.model)
        if settings.model.target:
            model["source"] = code_digest(settings.model.target)
        training = identity(settings.training)
        training["precision"] = precision_of(settings.training).name
        if not settings.training.has_discriminator:
            del training["discriminator_width"]
        crops = identity(settings.crops)
        if not settings.training.crop:  # whole frames
            del crops["fan_fraction"]
        return {
            "data": source_of(settings).identity(),
            "encoding": encoding,
            "model": model,
            "training": training,
            "training_version": TRAINING_VERSION,
            "crops": crops,
            "seed": settings.seed,
        }

    @cached_property
    def hash(self) -> str:
        """A digest of `identity`, the address of the training."""
        return digest(self.identity)

    @property
    def data(self) -> DataSet:
        """The pairs that it reads, as they lie on disk now."""
        from ablate.sources.data_set import DataSet

        name = f"{self.settings.scene_name}-{digest(self.identity['data'])}"
        return DataSet(self.settings.results / "data" / name)

    @property
    def training(self) -> Training:
        """Its folder as it is now: one that another label has made of the same training, or its own."""
        from ablate.study.training import training_at

        return training_at(self.settings.study_dir, self.label, self.settings.seed, self.hash)

    @property
    def folder(self) -> Path:
        return self.training.folder

    @property
    def wanted(self) -> tuple[ScoreKey, ...]:
        """The scores that it asks for, of its data set as it is known now."""
        from ablate.study.scores import wanted_scores

        pixels = self.data.known_pixels or self.training.pixels
        return wanted_scores(self.settings.metrics, self.settings.evaluation, pixels)

    @property
    def finished(self) -> bool:
        """Whether the training has reached its last step, and every score that is asked for is there."""
        training = self.training
        return training.hash == self.hash and training.is_trained and not training.lacking(self.wanted)


def refuse_lost_network(job: Job) -> None:
    """Refuse to score what is trained but has lost its checkpoint: training it anew would replace what is finished."""
    training = job.training
    if not training.is_trained or training.checkpoint.exists():
        return
    if lacking := ", ".join(key.metric for key in training.lacking(job.wanted)):
        raise ConfigurationError(
            f"{training.checkpoint} is missing, and {job.name} has no score of {lacking}: "
            f"put it back, name other metrics=, or remove {training.folder} to train it again"
        )


def claim(job: Job) -> Training:
    """Make the folder of a job's training, and say in it what it is, before anything else is written there."""
    from ablate.study.training import begin_folder

    about = {
        "hash": job.hash,
        "label": job.label,
        "seed": job.settings.seed,
        "changed": {key: plain(value) for key, value in job.changed},
        "identity": job.identity,
        "settings": plain(job.settings),
        "data": job.data.name,
    }
    return begin_folder(job.settings.study_dir, about)


def precision_of(training: TrainingSettings) -> TrainingPrecision:
    """The precision that a training has on this machine: `auto` depends on the device."""
    if training.precision is not TrainingPrecision.auto:
        return training.precision
    from ablate.training import chosen_device, chosen_precision  # loads PyTorch

    return chosen_precision(training.precision, chosen_device(training.device))


def trainings_of(jobs: Iterable[Job]) -> list[Job]:
    """The jobs of which each trains something else in its study: two of one training are one, the first."""
    first: dict[tuple[Path, str], Job] = {}
    for job in jobs:
        first.setdefault((job.settings.study_dir, job.hash), job)
    return list(first.values())


def differences(a: Any, b: Any, key: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Dotted keys in which two nested dicts differ, with the value of each; None where one has none."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for k in sorted(a.keys() | b.keys()):
            yield from differences(a.get(k), b.get(k), f"{key}.{k}".lstrip("."))
    elif a != b:
        yield key, a, b


def identity_key(key: str) -> str:
    """The key of `Job.identity` that a key of the command line decides, such as `data.dataset.frames`."""
    return f"data.{key}" if key.partition(".")[0] in _OF_THE_DATA else key


def parameters(settings: StudySettings, spec: GeneratorSpec, labels: int) -> dict[str, float]:
    """Count the parameters of the generator and of the discriminator, which is 0 for a job that trains without one.

    Networks read `labels` numbers for a tissue.
    """
    from ablate import networks

    discriminator = networks.count_discriminator(spec, settings.training.discriminator_width, labels)
    return {
        "parameters_generator": float(networks.count_generator(spec, labels)),
        "parameters_discriminator": float(discriminator if settings.training.has_discriminator else 0),
    }
