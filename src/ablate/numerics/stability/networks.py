"""Generators, discriminator and training steps with extreme losses, in bf16 and float32 against float64."""

from dataclasses import replace
from itertools import product

import numpy as np
import torch
from torch import Tensor, nn
from torch.optim import Adam

from ablate.command.compose import variant_model
from ablate.networks import GeneratorSpec, Noise, conditions
from ablate.networks.layers import EPSILON, convolutions, instance_norm
from ablate.numerics.stability.checks import BFLOAT16, FLOAT32, FLOAT64, TF32, Checks, case
from ablate.settings.conf import variant_names
from ablate.training import AdversarialLoss, PairGAN, TrainingSettings

WIDTH = 0.125  # rounding errors depend on the depth of a network more than on its width
SETTINGS = TrainingSettings(batch_size=2, device="cpu")
SPEC = GeneratorSpec(depth=2, width=0.1, noise_start=0.1)
ADVERSARIAL = (AdversarialLoss.nonsaturating, AdversarialLoss.minimax)
STEPS = 8


def maps_of(device: str, seed: int = 0, levels: int = 6) -> dict[str, Tensor]:
    """Draw float32 maps of random blocks in a fan that fills half of the crop, of which `levels` leave a pixel."""
    side = 1 << max(levels, 6)
    random = torch.Generator().manual_seed(seed)
    blocks = torch.randint(0, 7, (2, 1, 8, 8), generator=random).float() / 3 - 1
    segmentation = blocks.repeat_interleave(side // 8, 2).repeat_interleave(side // 8, 3)
    mask = torch.zeros(2, 1, side, side)
    mask[..., side // 4 : 3 * side // 4] = 1
    speckle = torch.rand(mask.shape, generator=random)
    maps = {
        "segmentation": segmentation * mask + mask - 1,
        "attenuation": torch.linspace(1, 0, side)[:, None] * mask,
        "compensated": torch.linspace(0.2, 0.8, side)[:, None] * mask,
        "illumination": torch.linspace(0.9, 0.1, side)[:, None] * mask,
        "compound": torch.linspace(1, 0.3, side)[:, None] * mask,
        "interfaces": speckle * mask,
        "low": (speckle - 1) * mask + mask - 1,
        "target": speckle * mask - 1,
        "mask": mask,
    }
    return {name: value.to(device) for name, value in maps.items()}


def in_double(values: Tensor) -> np.ndarray:
    """Copy values to the processor as float64."""
    return values.detach().double().cpu().numpy()


def gradients_of(network: nn.Module) -> list[np.ndarray]:
    """Copy the gradients of all weights that have one."""
    return [in_double(p.grad) for p in network.parameters() if p.grad is not None]


class Stepped(PairGAN):
    """The module's own training step, called directly, because a trainer knows no float64."""

    def __init__(self, spec: GeneratorSpec, settings: TrainingSettings, device: str, dtype: str) -> None:
        super().__init__(spec, settings)
        self.to(device, torch.float64 if dtype == "float64" else torch.float32)
        self._precision = torch.autocast(torch.device(device).type, torch.bfloat16, enabled=dtype == "bfloat16")
        self._pair = self.configure_optimizers()

    def optimizers(self, use_pl_optimizer: bool = True) -> list[Adam]:  # type: ignore[override]  # noqa: ARG002
        return list(self._pair)

    def manual_backward(self, loss: Tensor, *_: object, **__: object) -> None:
        loss.backward()

    def step(self, maps: dict[str, Tensor], seed: int) -> dict[str, float]:
        """Train on one batch and return the losses."""
        with self._precision:
            self.training_step(self._batch(maps, seed), 0)
        return self.drain()

    def image(self, maps: dict[str, Tensor]) -> np.ndarray:
        """Compute the generator's image of a batch."""
        batch = self._batch(maps, 3)
        given = {name: batch[name] for name in (*conditions(self.spec), "noise_seed")}
        with torch.no_grad(), self._precision:
            return in_double(self.generator(**given))

    def _batch(self, maps: dict[str, Tensor], seed: int) -> dict[str, Tensor]:
        batch = {name: value.to(next(self.parameters()).dtype) for name, value in maps.items()}
        return batch | {"noise_seed": torch.tensor([seed, 2**62 + seed], device=maps["mask"].device)}

    def weights(self) -> np.ndarray:
        return np.concatenate([in_double(p).ravel() for p in self.parameters()])


def _compared(checks: Checks, spec: GeneratorSpec, maps: dict[str, Tensor]) -> None:
    """Compare the image with that of float64, and take a training step."""
    exact = Stepped(spec, SETTINGS, checks.device, "float64")
    right = exact.image(maps)
    size = float(np.sqrt((right**2).mean())) or 1.0
    layers = convolutions(exact.generator)
    terms = max(layer.weight[0].numel() for layer in layers)
    tf32 = checks.device.startswith("cuda") and torch.backends.cudnn.allow_tf32  # a GPU may round factors to TF32
    name, unit = ("tf32", 3 * TF32) if tf32 else ("float32", terms * FLOAT32)
    fine = f"{len(layers)} layers, each a sum of up to {terms} products, if all errors add up."
    coarse = f"{len(layers)} layers that round input, weight and result."
    precisions = (name, "float32", unit, fine), ("bfloat16", "bfloat16", 3 * BFLOAT16, coarse)
    for checks.dtype, kind, layer_error, why in precisions:
        module = Stepped(spec, SETTINGS, checks.device, kind)
        image = module.image(maps)
        losses = module.step(maps, 3)
        checks.finite(image, np.array(list(losses.values())), what="pixels and losses")
        checks.finite(*gradients_of(module), what="gradients")
        error = np.sqrt(((image - right) ** 2).mean()) / size
        checks.add("image against float64, of its root mean square", error, len(layers) * layer_error, why)


def _variant(checks: Checks, name: str) -> None:
    """Image, loss and gradients of a training step, at an eighth of the paper's width."""
    spec = variant_model(name)
    noise_start = 0.1 if spec.noise is Noise.inject else 0.0
    _compared(checks, replace(spec, width=WIDTH, noise_start=noise_start), maps_of(checks.device, levels=spec.depth))


for _name in variant_names():  # each file of conf/variant
    case(f"{_name} in bf16, float32 and float64", _name)(_variant)


@case("a constant image through instance norm")
def _constant_norm(checks: Checks) -> None:
    """Instance norm of constant maps, whose deviation is 0: the result is 0, and a map of one pixel stays as it is."""
    units = {torch.float32: FLOAT32, torch.bfloat16: BFLOAT16, torch.float64: FLOAT64}
    for (kind, unit), value in product(units.items(), (0.0, 1.0, -1e4, 1e30)):
        checks.dtype = str(kind).removeprefix("torch.")
        checks.label = f"{value:g}"
        features = torch.full((1, 4, 64, 64), value, dtype=kind, device=checks.device, requires_grad=True)
        out = instance_norm(features)
        out.sum().backward()
        assert features.grad is not None
        checks.finite(in_double(out), in_double(features.grad))
        why = "The mean is rounded, the deviation is at least sqrt(epsilon), and no result exceeds 1."
        bound = min(1.0, 2 * abs(value) * unit / np.sqrt(EPSILON))
        checks.add("largest value", np.abs(in_double(out)).max(), bound, why)
        changed = (instance_norm(features[..., :1, :1]) != features[..., :1, :1]).cpu().numpy()
        checks.none("maps of one pixel that changed", changed, "Normalising one would give 0.")


@case("constant maps through the generators")
def _constant_maps(checks: Checks) -> None:
    """Constant maps: one tissue everywhere, and no fan with shadow everywhere."""
    constants = ("all one tissue", 1.0, 1.0), ("all outside, in shadow", -1.0, 0.0)
    for (label, segmentation, attenuation), name in product(constants, ("sa2h", "lsa2h")):
        spec = replace(variant_model(name), width=WIDTH)
        maps = maps_of(checks.device, levels=spec.depth)
        maps["segmentation"].fill_(segmentation)
        maps["attenuation"].fill_(attenuation)
        checks.label = f"{label}, {name}"
        _compared(checks, spec, maps)


def _steps(
    checks: Checks, settings: TrainingSettings, maps: dict[str, Tensor] | None = None, alike: bool = False
) -> None:
    """Take steps of Adam: check losses and gradients of the first, and how far weights have moved after the last.

    If real and generated images are alike, their gradients in the discriminator cancel and are not compared.
    """
    first = {}
    # Kingma and Ba 2015, section 2.1: a step is at most lr (1 - b1) / sqrt(1 - b2) when that is over lr.
    farthest = settings.learning_rate * max(1.0, (1 - settings.beta1) / np.sqrt(1 - settings.beta2)) * STEPS
    for checks.dtype in ("float32", "float64", "bfloat16"):
        module = Stepped(SPEC, settings, checks.device, checks.dtype)
        before = module.weights()
        losses = []
        for k in range(STEPS):
            losses.append(list(module.step(maps or maps_of(checks.device, k), k).values()))
            if k == 0:
                first[checks.dtype] = np.array(losses[0]), np.concatenate([g.ravel() for g in gradients_of(module)])
        checks.finite(np.array(losses), what="losses")
        checks.finite(*gradients_of(module), module.weights(), what="gradients and weights")
        why = "A step of Adam is at most lr (1 - b1) / sqrt(1 - b2) for any gradient (Kingma and Ba 2015)."
        checks.add("farthest that a weight went", np.abs(module.weights() - before).max(), farthest, why)
    layers = convolutions(module)
    terms = max(layer.weight[0].numel() for layer in layers)
    right, right_gradient = first["float64"]
    for checks.dtype, unit in (("float32", terms * FLOAT32), ("bfloat16", 3 * BFLOAT16)):
        losses_here, gradient = first[checks.dtype]
        apart = (np.abs(losses_here - right) / (np.abs(right) + (right == 0))).max()
        why = f"{len(layers)} layers of both networks, if all rounding errors add up."
        checks.add("losses of the first step against float64, relative", apart, len(layers) * unit, why)
        if not alike:
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
    maps = maps_of(checks.device)
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


@case("saturated discriminator logits")
def _saturated(checks: Checks) -> None:
    """Logits of +-1e4 and +-1e30, made by the bias of the discriminator's last layer."""
    for logit in (1e4, -1e4, 1e30, -1e30):
        for loss in ADVERSARIAL:
            for checks.dtype, unit in (("float32", FLOAT32), ("float64", FLOAT32), ("bfloat16", BFLOAT16)):
                module = Stepped(SPEC, replace(SETTINGS, loss=loss, l1_weight=0.0), checks.device, checks.dtype)
                assert module.discriminator is not None
                torch.nn.init.constant_(module.discriminator.last.bias, logit)  # type: ignore[arg-type]
                losses = module.step(maps_of(checks.device), 0)
                right_g = max(-logit, 0.0) if loss is AdversarialLoss.nonsaturating else -max(logit, 0.0)
                checks.label = f"{loss.value}, logits {logit:g}"
                checks.finite(*gradients_of(module), module.weights(), what="gradients and weights")
                error = max(abs(losses["train/loss_d"] - abs(logit)), abs(losses["train/loss_g"] - right_g))
                bound = 4 * unit + 10 / abs(logit)
                why = "Far from 0, softplus is the larger of 0 and x; features add less than 10 to the bias."
                checks.add("losses against max(0, x), relative", error / abs(logit), bound, why)
