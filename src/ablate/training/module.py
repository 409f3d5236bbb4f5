"""The conditional GAN as a LightningModule: one generated batch, a step of D, a step of G."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from typing import Any

import torch
from lightning.pytorch import LightningModule
from lightning.pytorch.core.optimizer import LightningOptimizer
from torch import Tensor
from torch.nn import functional as F
from torch.optim import Adam, Optimizer

from ablate.networks import (
    Generator,
    GeneratorSpec,
    PatchDiscriminator,
    conditions,
    discriminator_channels,
    draws_noise,
)
from ablate.training.losses import crps_of_two_draws, mean_in_fan, second_seeds
from ablate.training.settings import (
    TRAINING_VERSION,
    AdversarialLoss,
    Reconstruction,
    TrainingSettings,
    as_builtins,
)

# The running average follows faster at first: min(decay, (1 + t) / (10 + t)) at step t.
_EMA_LAG = 10


class PairGAN(LightningModule):
    """Generator, discriminator, their losses and optimisers; the arguments may be the mappings of a checkpoint.

    Attributes
    ----------
    discriminator : PatchDiscriminator or None
        None with `loss=none`.
    average : Generator or None
        Running average of the generator's weights, if `ema_decay` is above 0.
    steps_done : int
        Batches seen. Lightning's `global_step` counts the steps of both optimisers, so it is not used.
    """

    def __init__(self, spec: GeneratorSpec | Mapping[str, Any], settings: TrainingSettings | Mapping[str, Any]) -> None:
        super().__init__()
        self.spec = spec if isinstance(spec, GeneratorSpec) else GeneratorSpec(**spec)
        self.settings = settings if isinstance(settings, TrainingSettings) else TrainingSettings(**settings)
        self.save_hyperparameters({"spec": as_builtins(self.spec), "settings": as_builtins(self.settings)})
        self.automatic_optimization = False
        width = self.settings.discriminator_width
        with torch.random.fork_rng():
            torch.manual_seed(self.settings.seed)
            self.generator = Generator(self.spec)
            self.discriminator: PatchDiscriminator | None = None
            if self.settings.has_discriminator:
                self.discriminator = PatchDiscriminator(
                    discriminator_channels(self.spec), self.spec.width if width is None else width
                )
        has_average = self.settings.ema_decay > 0
        self.average = deepcopy(self.generator).requires_grad_(False) if has_average else None
        self.steps_done = 0
        self._sums: Tensor | None = None
        self._summed: tuple[str, ...] = ()
        self._steps_summed = 0
        self._optimizer_states: list[dict[str, Any]] | None = None

    @property
    def evaluated(self) -> Generator:
        """The generator to evaluate: the running average where there is one."""
        return self.generator if self.average is None else self.average

    def configure_optimizers(self) -> tuple[Adam, ...]:
        """Make one Adam a network, generator's first, with the states of a restored checkpoint."""
        chosen = self.settings
        optimizers = tuple(
            Adam(network.parameters(), chosen.learning_rate, (chosen.beta1, chosen.beta2), fused=True)
            for network in (self.generator, self.discriminator)
            if network is not None
        )
        for optimizer, state in zip(optimizers, self._optimizer_states or (), strict=False):
            optimizer.load_state_dict(state)
            _lay_out_like_weights(optimizer)
        self._optimizer_states = None
        return optimizers

    def training_step(self, batch: dict[str, Tensor], _: int) -> None:
        """Train both networks on one batch.

        Parameters
        ----------
        batch : dict of (N, 1, h, w) float
            The maps of `conditions(spec)`, `target` in [-1, 1] and `mask`; and `noise_seed`, (N,) int64.
        """
        optimizer_g, *others = self._optimizers_at_this_step()
        maps = {name: batch[name] for name in conditions(self.spec)}
        mask, image = batch["mask"].float(), batch["target"]
        rendered = self.generator(**maps, noise_seed=batch["noise_seed"])
        fake = _in_fan(rendered, mask)
        losses: dict[str, Tensor] = {}
        if self.discriminator is not None:
            stacked = torch.cat([maps[name].to(rendered.dtype) for name in maps], dim=1)
            losses |= self._train_discriminator(self.discriminator, others[0], stacked, image, fake.detach())
            self.discriminator.requires_grad_(False)
            losses["train/loss_g"] = self._adversarial(self.discriminator(stacked, fake).float())

        losses["train/l1"] = error = mean_in_fan((fake - image).abs(), mask)
        if self.settings.reconstruction is Reconstruction.crps and draws_noise(self.spec):
            second = _in_fan(self.generator(**maps, noise_seed=second_seeds(batch["noise_seed"])), mask)
            losses["train/crps"] = error = mean_in_fan(crps_of_two_draws(fake, second, image), mask)
        optimizer_g.zero_grad(set_to_none=True)
        self.manual_backward(losses.get("train/loss_g", 0) + self.settings.l1_weight * error)
        optimizer_g.step()
        if self.discriminator is not None:
            self.discriminator.requires_grad_(True)

        if self.average is not None:
            decay = min(self.settings.ema_decay, (1 + self.steps_done) / (_EMA_LAG + self.steps_done))
            with torch.no_grad():
                torch._foreach_lerp_(list(self.average.parameters()), list(self.generator.parameters()), 1 - decay)
        self.steps_done += 1
        values = torch.stack(list(losses.values())).detach()
        self._sums = values if self._sums is None else self._sums + values
        self._summed = tuple(losses)
        self._steps_summed += 1

    def drain(self) -> dict[str, float]:
        """Return the mean of every loss since the last call, by name; this waits for the device.

        `train/l1` and, of two draws, `train/crps`; with a discriminator also `train/loss_d`, `train/loss_g`,
        `train/logit_real` and `train/logit_fake`.
        """
        if self._sums is None:
            return {}
        means = (self._sums / self._steps_summed).tolist()
        self._sums, self._steps_summed = None, 0
        return dict(zip(self._summed, means, strict=True))

    def is_finite(self) -> bool:
        """Whether all weights are finite; this waits for the device."""
        norms = torch._foreach_norm([parameter.detach() for parameter in self.parameters()])
        return bool(torch.stack([norm.float() for norm in norms]).isfinite().all())

    def checkpoint(self) -> dict[str, Any]:
        """What a training is continued from: weights, optimisers, steps done, and what and which code made them."""
        return {
            "state_dict": self.state_dict(),
            "optimizer_states": [optimizer.state_dict() for optimizer in self._listed_optimizers()],
            "steps_done": self.steps_done,
            "hyper_parameters": dict(self.hparams),
            "training_version": TRAINING_VERSION,
        }

    def restore(self, checkpoint: Mapping[str, Any]) -> None:
        """Continue from a checkpoint: weights and step now, optimisers when they are made."""
        self.load_state_dict(checkpoint["state_dict"])
        self.steps_done = checkpoint["steps_done"]
        self._optimizer_states = checkpoint["optimizer_states"]

    def _listed_optimizers(self) -> Sequence[Optimizer | LightningOptimizer]:
        """The optimisers, the generator's first; Lightning gives a single one without a list around it."""
        optimizers = self.optimizers()
        return optimizers if isinstance(optimizers, Sequence) else [optimizers]

    def _optimizers_at_this_step(self) -> Sequence[Optimizer | LightningOptimizer]:
        """Set the learning rate of the step; the generator's optimiser is first."""
        optimizers = self._listed_optimizers()
        for optimizer in optimizers:
            for group in optimizer.param_groups:
                group["lr"] = self.settings.learning_rate_at(self.steps_done)
        return optimizers

    def _train_discriminator(
        self,
        discriminator: PatchDiscriminator,
        optimizer: Optimizer | LightningOptimizer,
        maps: Tensor,
        image: Tensor,
        fake: Tensor,
    ) -> dict[str, Tensor]:
        """Take a step of the discriminator on real and generated images; returns its losses."""
        logits_real = discriminator(maps, image).float()
        logits_fake = discriminator(maps, fake).float()
        loss = F.softplus(-logits_real).mean() + F.softplus(logits_fake).mean()
        optimizer.zero_grad(set_to_none=True)
        self.manual_backward(loss)
        optimizer.step()
        return {
            "train/loss_d": loss,
            "train/logit_real": logits_real.mean(),
            "train/logit_fake": logits_fake.mean(),
        }

    def _adversarial(self, logits_fake: Tensor) -> Tensor:
        """Compute the generator's adversarial loss: -log D, or log(1 - D), with D = sigmoid(logits)."""
        is_minimax = self.settings.loss is AdversarialLoss.minimax
        return -F.softplus(logits_fake).mean() if is_minimax else F.softplus(-logits_fake).mean()


def _in_fan(rendered: Tensor, mask: Tensor) -> Tensor:
    """Set what lies outside the fan to black, in float32."""
    return mask * (rendered.float() + 1) - 1


def _lay_out_like_weights(optimizer: Adam) -> None:
    """Give moments the memory format of their weights: fused Adam pairs them by place in memory, without a check."""
    for parameter, state in optimizer.state.items():
        for name, value in state.items():
            if value.shape == parameter.shape and value.stride() != parameter.stride():
                state[name] = torch.empty_like(parameter).copy_(value)
