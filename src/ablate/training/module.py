"""The conditional GAN as a LightningModule: one generated batch, a step of D, a step of G."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import numpy as np
import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.core.optimizer import LightningOptimizer
from torch import Tensor
from torch.nn import functional as F
from torch.optim import Adam, Optimizer

from ablate.networks import (
    Family,
    Generator,
    GeneratorSpec,
    PatchDiscriminator,
    conditions,
    discriminator_channels,
    draws_noise,
    judged,
)
from ablate.setting import plain
from ablate.training.settings import TRAINING_VERSION, AdversarialLoss, Reconstruction, TrainingSettings
from ablate.user_code import code_digest

# The seeds of a batch lie below 2^62 (`Crops`), so with this bit no second draw repeats a first one.
SECOND_DRAW = 1 << 62
# The running average follows faster at first: min(decay, (1 + t) / (10 + t)) at step t.
_EMA_LAG = 10


class PairGAN(LightningModule):
    """Generator, discriminator, their losses and optimisers.

    Parameters
    ----------
    spec : GeneratorSpec
        Components of the generator; the discriminator is conditioned on the maps of `judged`.
    settings : TrainingSettings
        Losses, learning rates, and the seed of the initial weights.
    labels : int
        Channels of the segmentation.

    Attributes
    ----------
    discriminator : PatchDiscriminator or None
        None with `loss=none`.
    average : Generator or None
        Running average of the generator's weights, if `ema_decay` is above 0.
    steps_done : int
        Batches seen. Lightning's `global_step` counts the steps of both optimisers, so it is not used.
    """

    def __init__(self, spec: GeneratorSpec, settings: TrainingSettings, labels: int = 1) -> None:
        super().__init__()
        self.spec = spec
        self.settings = settings
        self.labels = labels
        self.automatic_optimization = False
        self.discriminator: PatchDiscriminator | None = None
        self.average: Generator | None = None
        with torch.random.fork_rng():
            torch.manual_seed(settings.seed)
            self.generator = Generator(spec, labels)
            if settings.has_discriminator:
                width = settings.discriminator_width or spec.width
                self.discriminator = PatchDiscriminator(discriminator_channels(spec, labels), width)
        if settings.ema_decay > 0:
            self.average = deepcopy(self.generator).requires_grad_(False)
        self.steps_done = 0
        self._sums: dict[str, Tensor | float] = {}
        self._steps_summed = 0
        self._optimizer_states: list[dict[str, Any]] | None = None

    @property
    def evaluated(self) -> Generator:
        """The generator to evaluate: the running average where there is one."""
        return self.generator if self.average is None else self.average

    def configure_optimizers(self) -> tuple[Adam, ...]:
        """Make one Adam a network, generator's first, with the states of a restored checkpoint."""
        betas = (self.settings.beta1, self.settings.beta2)
        optimizers = tuple(
            Adam(network.parameters(), self.settings.learning_rate, betas, fused=True)
            for network in (self.generator, self.discriminator)
            if network is not None
        )
        for optimizer, state in zip(optimizers, self._optimizer_states or (), strict=False):
            optimizer.load_state_dict(state)
            # In the memory format of the weights: fused Adam pairs them by place in memory, without a check.
            for parameter, moments in optimizer.state.items():
                for name, value in moments.items():
                    if value.shape == parameter.shape and value.stride() != parameter.stride():
                        moments[name] = torch.empty_like(parameter).copy_(value)
        self._optimizer_states = None
        return optimizers

    def training_step(self, batch: dict[str, Tensor], _: int) -> None:
        """Train both networks on one batch, whose maps are (N, 1, h, w), but for the channels of the segmentation.

        They are those of `conditions(spec)`, `target` in [-1, 1] and `mask`; and there is `noise_seed`, (N,) int64.
        """
        optimizer_g, *optimizers_d = self._listed_optimizers()
        for optimizer in (optimizer_g, *optimizers_d):
            for group in optimizer.param_groups:
                group["lr"] = self.settings.learning_rate_at(self.steps_done)
        maps = {name: batch[name] for name in conditions(self.spec)}
        mask = batch["mask"].float()
        image = batch["target"]
        rendered = self._render(maps, batch["noise_seed"])
        draws = rendered.split(len(image))
        fake, *second = [mask * (draw.float() + 1) - 1 for draw in draws]  # black outside the fan
        losses: dict[str, Tensor] = {}
        if self.discriminator is not None:
            stacked = torch.cat([maps[name].to(rendered.dtype) for name in judged(self.spec)], dim=1)
            losses |= self._train_discriminator(self.discriminator, optimizers_d[0], stacked, image, fake.detach())
            self.discriminator.requires_grad_(False)
            losses["train/loss_g"] = self._adversarial_loss(self.discriminator(stacked, fake).float())
        losses["train/l1"] = error = (fake - image).abs().mean()
        if second:
            losses["train/crps"] = error = crps_of_two_draws(fake, second[0], image).mean()
        optimizer_g.zero_grad()
        self.manual_backward(losses.get("train/loss_g", 0) + self.settings.l1_weight * error)
        optimizer_g.step()
        if self.discriminator is not None:
            self.discriminator.requires_grad_(True)
        if self.average is not None:
            self._follow(self.average)
        self.steps_done += 1
        self._sums = {name: self._sums.get(name, 0) + value.detach() for name, value in losses.items()}
        self._steps_summed += 1

    def _render(self, maps: Mapping[str, Tensor], seeds: Tensor) -> Tensor:
        """Render a batch, of which CRPS takes a second draw; returns (N, 1, h, w), or both draws, one after the other.

        What a network of the user's draws by itself follows the seed of the training and the step.
        """
        if self.settings.reconstruction is Reconstruction.crps and draws_noise(self.spec):
            seeds = torch.cat((seeds, seeds ^ SECOND_DRAW))
        is_custom = self.spec.family is Family.custom
        with torch.random.fork_rng(enabled=is_custom):
            if is_custom:
                random = np.random.default_rng([self.settings.seed, self.steps_done])
                torch.manual_seed(int(random.integers(2**62)))
            image: Tensor = self.generator(**maps, noise_seed=seeds)
            return image

    def _train_discriminator(
        self,
        discriminator: PatchDiscriminator,
        optimizer: Optimizer | LightningOptimizer,
        maps: Tensor,
        image: Tensor,
        fake: Tensor,
    ) -> dict[str, Tensor]:
        """Take a step of the discriminator; returns its loss and the mean logits."""
        real_logits = discriminator(maps, image).float()
        fake_logits = discriminator(maps, fake).float()
        loss = F.softplus(-real_logits).mean() + F.softplus(fake_logits).mean()
        optimizer.zero_grad()
        self.manual_backward(loss)
        optimizer.step()
        return {
            "train/loss_d": loss,
            "train/logit_real": real_logits.mean(),
            "train/logit_fake": fake_logits.mean(),
        }

    def _adversarial_loss(self, logits: Tensor) -> Tensor:
        """What the generator minimises: -log D, or log(1 - D), with D = sigmoid(logits)."""
        if self.settings.loss is AdversarialLoss.minimax:
            return -F.softplus(logits).mean()
        return F.softplus(-logits).mean()

    def _follow(self, average: Generator) -> None:
        """Move the running average towards the generator."""
        decay = min(self.settings.ema_decay, (1 + self.steps_done) / (_EMA_LAG + self.steps_done))
        with torch.no_grad():
            torch._foreach_lerp_(list(average.parameters()), list(self.generator.parameters()), 1 - decay)
            for averaged, newest in zip(average.buffers(), self.generator.buffers(), strict=True):
                averaged.copy_(newest)  # as `AveragedModel` of torch does: statistics of batch norm

    def drain(self) -> dict[str, float]:
        """Return the mean of every loss since the last call, by name; this waits for the device.

        `train/l1` and, of two draws, `train/crps`; with a discriminator also `train/loss_d`, `train/loss_g`,
        `train/logit_real` and `train/logit_fake`.
        """
        means = {name: float(total / self._steps_summed) for name, total in self._sums.items()}
        self._sums = {}
        self._steps_summed = 0
        return means

    def checkpoint(self) -> dict[str, Any]:
        """What a training is continued from: weights, optimisers, steps done, and what and which code made them."""
        return {
            "state_dict": self.state_dict(),
            "optimizer_states": [optimizer.state_dict() for optimizer in self._listed_optimizers()],
            "steps_done": self.steps_done,
            "summed": ({name: float(total) for name, total in self._sums.items()}, self._steps_summed),
            "hyper_parameters": {
                "spec": plain(self.spec),
                "labels": self.labels,
                "settings": plain(self.settings),
            },
            "target_source": None if self.spec.target is None else code_digest(self.spec.target),
            "training_version": TRAINING_VERSION,
        }

    def restore(self, checkpoint: Mapping[str, Any]) -> None:
        """Continue from a checkpoint: weights and step now, optimisers when they are made."""
        self.load_state_dict(checkpoint["state_dict"])
        self.steps_done = checkpoint["steps_done"]
        self._optimizer_states = checkpoint["optimizer_states"]
        self._sums, self._steps_summed = checkpoint.get("summed", ({}, 0))

    def _listed_optimizers(self) -> Sequence[Optimizer | LightningOptimizer]:
        """The optimisers, the generator's first; Lightning gives a single one without a list around it."""
        optimizers = self.optimizers()
        return optimizers if isinstance(optimizers, Sequence) else [optimizers]


def crps_of_two_draws(first: Tensor, second: Tensor, target: Tensor) -> Tensor:
    """Estimate the continuous ranked probability score of each pixel from two draws, in the unit of the images.

    (|x1 - y| + |x2 - y|) / 2 - |x1 - x2| / 2 is the fair (unbiased) estimate for an ensemble of two. Its expectation is
    smallest where the draws have the distribution of the target, so draws gain by their spread. For draws that are
    alike it is the absolute error.

    Notes
    -----
    Gneiting and Raftery, "Strictly proper scoring rules, prediction, and estimation", JASA 2007, equation 21; Ferro,
    "Fair scores for ensemble forecasts", QJRMS 2014. Bendel, Ahmad and Schniter, "A regularized conditional GAN for
    posterior sampling in image recovery problems", NeurIPS 2023, train a conditional GAN with two draws.
    """
    return ((first - target).abs() + (second - target).abs() - (first - second).abs()) / 2
