"""Training steps with extreme loss weights, saturated logits, constant targets, and crops outside the fan."""

from dataclasses import replace
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ablate.networks import GeneratorSpec
from ablate.networks.layers import convolutions
from ablate.numerics.stability.checks import BFLOAT16, FLOAT32, Checks, case
from ablate.numerics.stability.networks import SETTINGS, Stepped, gradients_of, maps_of
from ablate.training import AdversarialLoss, DivergenceError, TrainingSettings
from ablate.training.reporting import DivergenceGuard

SPEC = GeneratorSpec(depth=2, width=0.1, noise_start=0.1)
ADVERSARIAL = (AdversarialLoss.nonsaturating, AdversarialLoss.minimax)
REPORTED = ("train/loss_d", "train/loss_g", "train/l1", "train/logit_real", "train/logit_fake")
STEPS = 8
SIDE = 64


def _steps(
    checks: Checks, settings: TrainingSettings, maps: dict[str, Tensor] | None = None, alike: bool = False
) -> None:
    """Take steps of Adam: check losses and gradients of the first, and how far weights have moved after the last.

    If real and generated images are alike, their gradients in the discriminator cancel and are not compared.
    """
    first, units = {}, {"float32": FLOAT32, "bfloat16": 3 * BFLOAT16}
    # Kingma and Ba 2015, section 2.1: a step is at most lr (1 - b1) / sqrt(1 - b2) when that is over lr.
    farthest = settings.learning_rate * max(1.0, (1 - settings.beta1) / np.sqrt(1 - settings.beta2)) * STEPS
    for checks.dtype in ("float32", "float64", "bfloat16"):
        module = Stepped(SPEC, settings, checks.device, checks.dtype)
        before, losses = module.weights(), []
        for k in range(STEPS):
            losses.append(list(module.step(maps or maps_of(checks.device, k, SIDE), k).values()))
            if k == 0:
                first[checks.dtype] = np.array(losses[0]), np.concatenate([g.ravel() for g in gradients_of(module)])
        checks.finite(np.array(losses), what="losses")
        checks.finite(*gradients_of(module), module.weights(), what="gradients and weights")
        why = "A step of Adam is at most lr (1 - b1) / sqrt(1 - b2) for any gradient (Kingma and Ba 2015)."
        checks.add("farthest that a weight went", np.abs(module.weights() - before).max(), farthest, why)
    layers = convolutions(module)
    units["float32"] *= max(layer.weight[0].numel() for layer in layers)
    right, right_gradient = first["float64"]
    for checks.dtype, unit in units.items():
        losses_here, gradient = first[checks.dtype]
        apart = (np.abs(losses_here - right) / (np.abs(right) + (right == 0))).max()
        why = f"{len(layers)} layers of both networks, if all rounding errors add up."
        checks.add("losses of the first step against float64, relative", apart, len(layers) * unit, why)
        if alike:
            continue
        apart = float(np.linalg.norm(gradient - right_gradient)) / (float(np.linalg.norm(right_gradient)) or 1.0)
        why = "There are as many layers in the backward pass."
        checks.add("gradient of the first step against float64, of its norm", apart, 2 * len(layers) * unit, why)


@case("lambda 1e6", 1e6)
@case("lambda 0", 0.0)
def _lambda(checks: Checks, weight: float) -> None:
    """Only the L1 loss, or only the adversarial loss, in both of its forms."""
    for loss in ADVERSARIAL:
        checks.label = loss.value
        _steps(checks, replace(SETTINGS, l1_weight=weight, loss=loss))


@case("a crop entirely outside the fan")
def _outside(checks: Checks) -> None:
    """A crop outside the fan: its images are black, and the generator's weights do not change."""
    maps = maps_of(checks.device, side=SIDE)
    for name, value in (("mask", 0.0), ("target", -1.0), ("segmentation", -1.0), ("attenuation", 0.0)):
        maps[name].fill_(value)
    _steps(checks, SETTINGS, maps, alike=True)
    for checks.dtype in ("float32", "float64", "bfloat16"):
        module = Stepped(SPEC, SETTINGS, checks.device, checks.dtype)
        before = [p.detach().clone() for p in module.generator.parameters()]
        losses = module.step(maps, 0)
        checks.add("L1", losses["train/l1"], 0, "Both images are black outside the fan.")
        moved = max(float((p - q).abs().max()) for p, q in zip(module.generator.parameters(), before, strict=True))
        checks.add("farthest that a weight of the generator went", moved, 0, "Masked pixels have no gradient.")


@case("targets all black and all white")
def _extreme_targets(checks: Checks) -> None:
    """Targets that are black or white everywhere in the fan."""
    for checks.label, value in (("black", -1.0), ("white", 1.0)):
        maps = maps_of(checks.device, side=SIDE)
        maps["target"] = maps["mask"] * (value + 1) - 1
        _steps(checks, SETTINGS, maps)


@case("losses of saturated logits")
def _saturated(checks: Checks) -> None:
    """Logits of +-1e4 and +-1e30, made by the bias of the discriminator's last layer."""
    for logit in (1e4, -1e4, 1e30, -1e30):
        for loss in ADVERSARIAL:
            for checks.dtype, unit in (("float32", FLOAT32), ("float64", FLOAT32), ("bfloat16", BFLOAT16)):
                module = Stepped(SPEC, replace(SETTINGS, loss=loss, l1_weight=0.0), checks.device, checks.dtype)
                assert module.discriminator is not None
                torch.nn.init.constant_(module.discriminator.last.bias, logit)  # type: ignore[arg-type]
                losses = module.step(maps_of(checks.device, side=SIDE), 0)
                right_g = max(-logit, 0.0) if loss is AdversarialLoss.nonsaturating else -max(logit, 0.0)
                checks.label = f"{loss.value}, logits {logit:g}"
                checks.finite(*gradients_of(module), module.weights(), what="gradients and weights")
                error = max(abs(losses["train/loss_d"] - abs(logit)), abs(losses["train/loss_g"] - right_g))
                bound = 4 * unit + 10 / abs(logit)
                why = "Far from 0, softplus is the larger of 0 and x; features add less than 10 to the bias."
                checks.add("losses against max(0, x), relative", error / abs(logit), bound, why)


@case("a training that has diverged")
def _divergence(checks: Checks) -> None:
    """Losses that are not finite, and a discriminator that is always right or only guesses, stop the training."""

    def reported(changed: dict[str, float], times: int) -> None:
        guard = DivergenceGuard(50)
        metrics = {**dict.fromkeys(REPORTED, 0.0), "train/loss_d": 1.0, **changed}
        try:
            for step in range(times):
                guard.check(metrics, step)
        except DivergenceError as error:
            raise ValueError(str(error)) from error

    checks.refused(
        *(partial(reported, {"train/loss_g": value}, 1) for value in (np.nan, np.inf, -np.inf)),
        *(partial(reported, {"train/loss_d": value}, 50) for value in (0.0, 2 * np.log(2))),
    )
