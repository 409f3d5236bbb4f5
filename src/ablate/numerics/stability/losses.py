"""Training steps with extreme loss weights, saturated logits, constant targets, and crops outside the fan."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor
from torch.optim import Adam

from ablate.networks import GeneratorSpec
from ablate.networks.layers import convolutions
from ablate.numerics.stability.checks import BFLOAT16, FLOAT32, Case, Check, finite, labelled, refused
from ablate.numerics.stability.networks import gradients_of, in_double, maps_of
from ablate.training import AdversarialLoss, DivergenceError, PairGAN, TrainingSettings
from ablate.training.losses import DivergenceGuard

SPEC = GeneratorSpec(depth=2, width=0.1, noise_start=0.1)
ADVERSARIAL = (AdversarialLoss.nonsaturating, AdversarialLoss.minimax)
REPORTED = ("train/loss_d", "train/loss_g", "train/l1", "train/logit_real", "train/logit_fake")
STEPS = 8
SIDE = 64


class _Stepped(PairGAN):
    """The module's own training step, called directly, because a trainer knows no float64."""

    def __init__(self, settings: TrainingSettings, device: str, dtype: str) -> None:
        super().__init__(SPEC, settings)
        self.to(device, torch.float64 if dtype == "float64" else torch.float32)
        self._bf16 = dtype == "bfloat16"
        self._pair = self.configure_optimizers()

    def optimizers(self, use_pl_optimizer: bool = True) -> list[Adam]:  # type: ignore[override]  # noqa: ARG002
        return list(self._pair)

    def manual_backward(self, loss: Tensor, *_: object, **__: object) -> None:
        loss.backward()

    def step(self, maps: dict[str, Tensor], seed: int) -> dict[str, float]:
        """Train on one batch and return the losses."""
        kind = next(self.parameters()).dtype
        batch = {name: value.to(kind) for name, value in maps.items()}
        batch["noise_seed"] = torch.tensor([seed, seed + 1], device=maps["mask"].device)
        with torch.autocast(batch["mask"].device.type, torch.bfloat16, enabled=self._bf16):
            self.training_step(batch, 0)
        return self.drain()

    def weights(self) -> np.ndarray:
        return np.concatenate([in_double(p).ravel() for p in self.parameters()])


def _settings(**changes: object) -> TrainingSettings:
    return replace(TrainingSettings(crop=SIDE, batch_size=2, steps=STEPS, device="cpu"), **changes)  # type: ignore[arg-type]


def _steps(
    settings: TrainingSettings, device: str, maps: dict[str, Tensor] | None = None, alike: bool = False
) -> Iterator[Check]:
    """Take steps of Adam: check losses and gradients of the first, and how far weights have moved after the last.

    If real and generated images are alike, their gradients in the discriminator cancel and are not compared.
    """
    first, units = {}, {"float32": FLOAT32, "bfloat16": 3 * BFLOAT16}
    # Kingma and Ba 2015, section 2.1: a step is at most lr (1 - b1) / sqrt(1 - b2) when that is over lr.
    farthest = settings.learning_rate * max(1.0, (1 - settings.beta1) / np.sqrt(1 - settings.beta2)) * STEPS
    for dtype in ("float32", "float64", "bfloat16"):
        module = _Stepped(settings, device, dtype)
        before = module.weights()
        losses = [list(module.step(maps or maps_of(device, 0, SIDE), 0).values())]
        first[dtype] = np.array(losses[0]), np.concatenate([g.ravel() for g in gradients_of(module)])
        losses += [list(module.step(maps or maps_of(device, k, SIDE), k).values()) for k in range(1, STEPS)]
        yield finite(dtype, np.array(losses), what="losses")
        yield finite(dtype, *gradients_of(module), module.weights(), what="gradients and weights")
        why = "A step of Adam is at most lr (1 - b1) / sqrt(1 - b2) for any gradient (Kingma and Ba 2015)."
        yield Check(dtype, "farthest that a weight went", float(np.abs(module.weights() - before).max()), farthest, why)
    layers = convolutions(module)
    units["float32"] *= max(layer.weight[0].numel() for layer in layers)
    for dtype, unit in units.items():
        (losses_here, gradient), (losses_right, right) = first[dtype], first["float64"]
        apart = float((np.abs(losses_here - losses_right) / (np.abs(losses_right) + (losses_right == 0))).max())
        why = f"{len(layers)} layers of both networks, if all rounding errors add up."
        yield Check(dtype, "losses of the first step against float64, relative", apart, len(layers) * unit, why)
        if alike:
            continue
        apart = float(np.linalg.norm(gradient - right) / (np.linalg.norm(right) or 1.0))
        bound = 2 * len(layers) * unit
        why = "There are as many layers in the backward pass."
        yield Check(dtype, "gradient of the first step against float64, of its norm", apart, bound, why)


def _lambda(weight: float, device: str) -> Iterator[Check]:
    """Only the L1 loss, or only the adversarial loss, in both of its forms."""
    for loss in ADVERSARIAL:
        yield from labelled(loss.value, _steps(_settings(l1_weight=weight, loss=loss), device))


def _outside(device: str) -> Iterator[Check]:
    """A crop outside the fan: its images are black, and the generator's weights do not change."""
    maps = maps_of(device, side=SIDE)
    for name, value in (("mask", 0.0), ("target", -1.0), ("segmentation", -1.0), ("attenuation", 0.0)):
        maps[name].fill_(value)
    yield from _steps(_settings(), device, maps, alike=True)
    for dtype in ("float32", "float64", "bfloat16"):
        module = _Stepped(_settings(), device, dtype)
        before = [p.detach().clone() for p in module.generator.parameters()]
        losses = module.step(maps, 0)
        yield Check(dtype, "L1", losses["train/l1"], 0, "Both images are black outside the fan.")
        moved = max(float((p - q).abs().max()) for p, q in zip(module.generator.parameters(), before, strict=True))
        yield Check(dtype, "farthest that a weight of the generator went", moved, 0, "Masked pixels have no gradient.")


def _extreme_targets(device: str) -> Iterator[Check]:
    """Targets that are black or white everywhere in the fan."""
    for label, value in (("black", -1.0), ("white", 1.0)):
        maps = maps_of(device, side=SIDE)
        maps["target"] = maps["mask"] * (value + 1) - 1
        yield from labelled(label, _steps(_settings(), device, maps))


def _saturated(device: str) -> Iterator[Check]:
    """Logits of +-1e4 and +-1e30, made by the bias of the discriminator's last layer."""
    for logit in (1e4, -1e4, 1e30, -1e30):
        for loss in ADVERSARIAL:
            for dtype, unit in (("float32", FLOAT32), ("float64", FLOAT32), ("bfloat16", BFLOAT16)):
                module = _Stepped(_settings(loss=loss, l1_weight=0.0), device, dtype)
                with torch.no_grad():
                    assert module.discriminator is not None
                    assert module.discriminator.last.bias is not None
                    module.discriminator.last.bias.fill_(logit)
                losses = module.step(maps_of(device, side=SIDE), 0)
                right_g = max(-logit, 0.0) if loss is AdversarialLoss.nonsaturating else -max(logit, 0.0)
                label = f"{loss.value}, logits {logit:g}"
                yield finite(dtype, *gradients_of(module), module.weights(), what=f"{label}: gradients and weights")
                error = max(abs(losses["train/loss_d"] - abs(logit)), abs(losses["train/loss_g"] - right_g))
                bound = 4 * unit + 10 / abs(logit)
                why = "Far from 0, softplus is the larger of 0 and x; features add less than 10 to the bias."
                yield Check(dtype, f"{label}: losses against max(0, x), relative", error / abs(logit), bound, why)


def _divergence(device: str) -> Iterator[Check]:  # noqa: ARG001
    """Losses that are not finite, and a discriminator that is always right or only guesses, stop the training."""

    def reported(changed: dict[str, float], times: int) -> None:
        guard = DivergenceGuard(50)
        metrics = {**dict.fromkeys(REPORTED, 0.0), "train/loss_d": 1.0, **changed}
        try:
            for step in range(times):
                guard.check(metrics, step)
        except DivergenceError as error:
            raise ValueError(str(error)) from error

    yield refused(
        "float64",
        *(partial(reported, {"train/loss_g": value}, 1) for value in (np.nan, np.inf, -np.inf)),
        *(partial(reported, {"train/loss_d": value}, 50) for value in (0.0, 2 * np.log(2))),
    )


CASES = (
    Case("lambda 0", partial(_lambda, 0.0)),
    Case("lambda 1e6", partial(_lambda, 1e6)),
    Case("a crop entirely outside the fan", _outside),
    Case("targets all black and all white", _extreme_targets),
    Case("losses of saturated logits", _saturated),
    Case("a training that has diverged", _divergence),
)
