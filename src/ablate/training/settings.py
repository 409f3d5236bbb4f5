"""How a network is trained, as values; the defaults are the paper's."""

import math
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any

from ablate.validation import coerce_enums

#: Part of every run's identity: raise it when the same settings and pairs train another network.
TRAINING_VERSION = 1
SMALLEST_CROP = 32


class AdversarialLoss(StrEnum):
    """What the generator minimises: -log D(G), or log(1 - D(G)) as the paper prints it; `none`: without a D."""

    nonsaturating = "nonsaturating"
    minimax = "minimax"
    none = "none"


class Reconstruction(StrEnum):
    """The error of an image in the fan: mean absolute, or the ranked probability score (CRPS) of two draws of noise."""

    l1 = "l1"
    crps = "crps"


class Schedule(StrEnum):
    """The learning rates: constant, or falling linearly to 0 over the second half of the steps, as in pix2pix."""

    constant = "constant"
    linear = "linear"


class TrainingPrecision(StrEnum):
    """Arithmetic of the convolutions; `auto` is bf16 where the hardware has it, else fp32."""

    auto = "auto"
    fp32 = "fp32"
    bf16 = "bf16"


@dataclass(frozen=True)
class TrainingSettings:
    """How a network is trained.

    Attributes
    ----------
    steps : int
        Batches in all. The paper gives no number. The default is 100 passes over its 6000 images, the length of
        pix2pix's schedule before its decay.
    crop : int
        Side of the square crops, px.
    learning_rate, beta1, beta2 : float
        Of Adam, for both networks.
    l1_weight : float
        Lambda, the weight of `reconstruction`, an error of images in [-1, 1].
    loss : AdversarialLoss
        With `none` there is no discriminator, and `reconstruction` is all that is minimised.
    ema_decay : float
        Of the running average of the generator's weights that is evaluated in its place; 0 for none, as the paper.
    discriminator_width : float or None
        Multiplier of the discriminator's channels; None takes the generator's.
    device : str
        `auto` (a GPU if there is one), `cpu` or `cuda`.
    threads : int
        Of torch on a CPU; 0 leaves torch's choice. Parallel jobs want 1. With another number, sums are rounded in
        another order, and training makes such differences grow.
    seed : int
        Of the initial weights. Crops and noise come from the seed of the batches.
    checkpoint_every, validate_every, log_every : int
        Steps between two; 0 for never, but there is always a checkpoint at the end.

    Raises
    ------
    ValueError
        Where a value is none of those allowed.
    """

    steps: int = 150_000
    batch_size: int = 4
    crop: int = 512
    learning_rate: float = 2e-4
    schedule: Schedule = Schedule.constant
    beta1: float = 0.5
    beta2: float = 0.999
    l1_weight: float = 100.0
    reconstruction: Reconstruction = Reconstruction.l1
    loss: AdversarialLoss = AdversarialLoss.nonsaturating
    ema_decay: float = 0.0
    discriminator_width: float | None = None
    precision: TrainingPrecision = TrainingPrecision.auto
    device: str = "auto"
    threads: int = 0
    seed: int = 0
    checkpoint_every: int = 1000
    validate_every: int = 5000
    log_every: int = 50

    def __post_init__(self) -> None:
        coerce_enums(self)
        if self.device not in ("auto", "cpu", "cuda"):
            raise ValueError(f"device={self.device!r}: allowed are auto, cpu, cuda")
        least = {"steps": 1, "batch_size": 1, "crop": SMALLEST_CROP, "log_every": 1}
        for name, lower in (least | {"threads": 0, "checkpoint_every": 0, "validate_every": 0}).items():
            if getattr(self, name) < lower:
                raise ValueError(f"{name}={getattr(self, name)}: allowed are {lower} and more")
        for name, upper in {"crop": 2**14, "threads": 2**12}.items():
            if getattr(self, name) > upper:
                raise ValueError(f"{name}={getattr(self, name)}: allowed are {upper} and less")
        for name in ("beta1", "beta2", "ema_decay"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)}: allowed is [0, 1)")
        if not (math.isfinite(self.l1_weight) and self.l1_weight >= 0):
            raise ValueError(f"l1_weight={self.l1_weight}: allowed are finite numbers from 0")
        if not (self.has_discriminator or self.l1_weight):
            raise ValueError(
                "l1_weight=0 with loss=none: allowed are numbers above 0, there is nothing else to minimise"
            )
        if not (math.isfinite(self.learning_rate) and self.learning_rate > 0):
            raise ValueError(f"learning_rate={self.learning_rate}: allowed are finite numbers above 0")

    @property
    def has_discriminator(self) -> bool:
        """Whether a discriminator is made and trained."""
        return self.loss is not AdversarialLoss.none

    def learning_rate_at(self, step: int) -> float:
        """Compute the learning rate of both networks at a step, the first of which is 0."""
        if self.schedule is Schedule.constant:
            return self.learning_rate
        return self.learning_rate * min(1.0, 2 * (self.steps - step) / self.steps)


def as_builtins(value: Any) -> dict[str, Any]:
    """Turn a settings dataclass into builtin strings and numbers, which load without running code."""
    return {name: str(field) if isinstance(field, StrEnum) else field for name, field in asdict(value).items()}
