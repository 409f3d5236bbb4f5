"""How a network is trained, as values; the defaults are the paper's."""

from dataclasses import dataclass
from enum import StrEnum

from ablate.setting import Checked, setting

#: Part of every run's identity: raise it when the same settings and pairs train another network.
TRAINING_VERSION = 3
SMALLEST_CROP = 32
SNAPSHOT_PARTS = 20
LAST = "last.ckpt"  # the checkpoint in the folder of a run
DEVICES = ("auto", "cpu", "cuda")


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
class TrainingSettings(Checked):
    """How a network is trained; a value that is not allowed is a ValueError that names it and what is."""

    steps: int = setting(
        150_000,
        "Batches in all. The paper gives no number; this is 100 passes over its 6000 images, the length of pix2pix's "
        "schedule before its decay.",
        least=1,
    )
    batch_size: int = setting(4, "Crops of a step.", least=1)
    crop: int = setting(512, "Side of the square crops; 0 takes whole frames.", least=0, most=2**14, unit="px")
    learning_rate: float = setting(2e-4, "Learning rate of Adam, for both networks.", above=0, most=1000)
    schedule: Schedule = setting(Schedule.constant, "How the learning rate falls.")
    beta1: float = setting(0.5, "Decay of Adam's average of gradients.", least=0, below=1)
    beta2: float = setting(0.999, "Decay of Adam's average of squared gradients.", least=0, below=1)
    l1_weight: float = setting(100.0, "Lambda: weight of `reconstruction` of images in [-1, 1].", least=0, most=1e12)
    reconstruction: Reconstruction = setting(
        Reconstruction.l1, "The error of a masked image: a mean over its pixels, black outside the fan, as printed."
    )
    loss: AdversarialLoss = setting(
        AdversarialLoss.nonsaturating,
        "What the generator minimises of the discriminator's answer; with `none` there is no discriminator, and "
        "`reconstruction` is all that is minimised.",
    )
    ema_decay: float = setting(
        0.0,
        "Decay of the running average of the generator's weights that is evaluated in its place; 0 for none, as in the "
        "paper.",
        least=0,
        below=1,
    )
    discriminator_width: float | None = setting(
        None, "Multiplier of the discriminator's channels; null takes the generator's.", above=0
    )
    precision: TrainingPrecision = setting(TrainingPrecision.auto, "Arithmetic of the convolutions.")
    device: str = setting(
        "auto", "Where networks are trained; `auto` is a GPU if there is one.", choices=DEVICES, incidental=True
    )
    threads: int = setting(
        0,
        "Threads of torch on a CPU; 0 leaves torch's choice. Parallel jobs want 1. With another number, sums are "
        "rounded in another order, and training makes such differences grow.",
        least=0,
        most=2**12,
        incidental=True,
    )
    snapshots: int = setting(
        1,
        "Sets of weights that are kept and scored, of which scores are means: those after the last 20ths of the steps. "
        "Of a GAN without a running average one set alone is as much luck as merit.",
        least=1,
        most=SNAPSHOT_PARTS,
    )
    seed: int = setting(0, "Seed of the initial weights. Crops and noise come from the seed of the batches.", least=0)
    checkpoint_every: int = setting(
        1000, "Steps between two checkpoints; 0 for one at the end alone.", least=0, incidental=True
    )
    validate_every: int = setting(5000, "Steps between two validations; 0 for none.", least=0, incidental=True)
    log_every: int = setting(50, "Steps between two points of a curve.", least=1, incidental=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if 0 < self.crop < SMALLEST_CROP:
            raise ValueError(f"crop={self.crop}: allowed are 0, for whole frames, and numbers from {SMALLEST_CROP}")
        if not (self.has_discriminator or self.l1_weight):
            raise ValueError(
                "l1_weight=0 with loss=none: allowed are numbers above 0, there is nothing else to minimise"
            )

    @property
    def has_discriminator(self) -> bool:
        """Whether a discriminator is made and trained."""
        return self.loss is not AdversarialLoss.none

    @property
    def snapshot_steps(self) -> tuple[int, ...]:
        """Steps after which weights are kept to be scored, besides those of the last step; increasing, without 0."""
        parts = range(SNAPSHOT_PARTS - self.snapshots + 1, SNAPSHOT_PARTS)
        steps = {round(self.steps * part / SNAPSHOT_PARTS) for part in parts}
        return tuple(sorted(steps - {0, self.steps}))

    def learning_rate_at(self, step: int) -> float:
        """Compute the learning rate of both networks at a step, the first of which is 0."""
        if self.schedule is Schedule.constant:
            return self.learning_rate
        return self.learning_rate * min(1.0, 2 * (self.steps - step) / self.steps)
