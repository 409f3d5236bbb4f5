"""Generators and discriminator in bf16 and float32 against float64, and with constant maps."""

from copy import deepcopy
from dataclasses import replace
from itertools import product

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F
from torch.optim import Adam

from ablate.jobs.compose import variant_model
from ablate.networks import Generator, GeneratorSpec, Noise, PatchDiscriminator, conditions, gaussian_field
from ablate.networks.layers import EPSILON, convolutions, instance_norm
from ablate.numerics.stability.checks import BFLOAT16, FLOAT32, FLOAT64, TF32, Checks, case
from ablate.settings.conf import variant_names
from ablate.training import PairGAN, TrainingSettings

WIDTH = 0.125  # rounding errors depend on the depth of a network more than on its width
SIDE = 256  # px; eight levels of stride 2 leave one pixel of it
SETTINGS = TrainingSettings(batch_size=2, device="cpu")


def maps_of(device: str, seed: int = 0, side: int = SIDE) -> dict[str, Tensor]:
    """Draw float32 maps of random blocks in a fan that fills half of the crop."""
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


def _precisions(network: nn.Module, device: str) -> list[tuple[str, str, float, str]]:
    """List the name and the type of each precision, and the bound on the error of all layers with its reason."""
    layers = convolutions(network)
    terms = max(layer.weight[0].numel() for layer in layers)
    why = f"{len(layers)} layers, each a sum of up to {terms} products, if all errors add up."
    tf32 = device.startswith("cuda") and torch.backends.cudnn.allow_tf32  # a GPU may round factors to TF32
    name, unit = ("tf32", 3 * TF32) if tf32 else ("float32", terms * FLOAT32)
    coarse = f"{len(layers)} layers that round input, weight and result."
    return [(name, "float32", len(layers) * unit, why), ("bfloat16", "bfloat16", len(layers) * (3 * BFLOAT16), coarse)]


def _compared(checks: Checks, spec: GeneratorSpec, maps: dict[str, Tensor]) -> None:
    """Compare the image with that of float64, and take a training step."""
    exact = Stepped(spec, SETTINGS, checks.device, "float64")
    right = exact.image(maps)
    size = float(np.sqrt((right**2).mean())) or 1.0
    precisions = _precisions(exact.generator, checks.device)
    for checks.dtype, kind, bound, why in precisions:
        module = Stepped(spec, SETTINGS, checks.device, kind)
        image, losses = module.image(maps), module.step(maps, 3)
        checks.finite(image, np.array(list(losses.values())), what="pixels and losses")
        checks.finite(*gradients_of(module), what="gradients")
        error = np.sqrt(((image - right) ** 2).mean()) / size
        checks.add("image against float64, of its root mean square", error, bound, why)


def _variant(checks: Checks, name: str) -> None:
    """Image, loss and gradients of a training step, at an eighth of the paper's width."""
    spec = replace(variant_model(name), width=WIDTH)
    spec = replace(spec, noise_start=0.1 if spec.noise is Noise.inject else 0.0)
    _compared(checks, spec, maps_of(checks.device))


for _name in variant_names():  # each file of conf/variant
    case(f"{_name} in bf16, float32 and float64", _name)(_variant)


@case("a constant image through instance norm")
def _constant_norm(checks: Checks) -> None:
    """Instance norm of constant maps: the deviation is 0, and so is the result."""
    units = {torch.float32: FLOAT32, torch.bfloat16: BFLOAT16, torch.float64: FLOAT64}
    for (kind, unit), value in product(units.items(), (0.0, 1.0, -1e4, 1e30)):
        checks.dtype, checks.label = str(kind).removeprefix("torch."), f"{value:g}"
        features = torch.full((1, 4, 64, 64), value, dtype=kind, device=checks.device, requires_grad=True)
        out = instance_norm(features)
        out.sum().backward()
        assert features.grad is not None
        checks.finite(in_double(out), in_double(features.grad))
        why = "The mean is rounded, the deviation is at least sqrt(epsilon), and no result exceeds 1."
        bound = min(1.0, 2 * abs(value) * unit / np.sqrt(EPSILON))
        checks.add("largest value", np.abs(in_double(out)).max(), bound, why)


@case("a map of one pixel through instance norm")
def _one_pixel(checks: Checks) -> None:
    """Instance norm of a map of one pixel does not change it."""
    for checks.dtype in ("float32", "bfloat16"):
        features = torch.randn(2, 8, 1, 1, device=checks.device).to(getattr(torch, checks.dtype))
        changed = float((instance_norm(features) - features).abs().max())
        checks.add("change of a map of 1 x 1", changed, 0, "Its deviation is 0; normalising it would give 0.")


@case("constant maps through the generators")
def _constant_maps(checks: Checks) -> None:
    """Constant maps: one tissue everywhere, no fan, and shadow everywhere."""
    constants = ("all one tissue", 1.0, 1.0), ("all outside", -1.0, 0.0), ("all shadow", 0.0, 0.0)
    for (label, segmentation, attenuation), name in product(constants, ("sa2h", "lsa2h")):
        maps = maps_of(checks.device)
        maps["segmentation"].fill_(segmentation)
        maps["attenuation"].fill_(attenuation)
        checks.label = f"{label}, {name}"
        _compared(checks, replace(variant_model(name), width=WIDTH), maps)


@case("saturated discriminator logits")
def _discriminator(checks: Checks) -> None:
    """Weights that are a thousand times too large: logits of 1e9 and more."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = PatchDiscriminator(3, WIDTH).to(checks.device)
    with torch.no_grad():
        for layer in convolutions(network):
            layer.weight.mul_(1e3)
    maps = maps_of(checks.device)
    stacked = torch.cat((maps["segmentation"], maps["attenuation"]), dim=1)
    right = in_double(deepcopy(network).double()(stacked.double(), maps["target"].double()))
    precisions = _precisions(network, checks.device)
    for checks.dtype, kind, bound, why in precisions:
        network.zero_grad(set_to_none=True)
        with torch.autocast(torch.device(checks.device).type, torch.bfloat16, enabled=kind == "bfloat16"):
            logits = network(stacked, maps["target"])
        F.softplus(-logits.float()).mean().backward()
        checks.finite(in_double(logits), what="logits")
        checks.finite(*gradients_of(network), what="gradients")
        error = np.sqrt(((in_double(logits) - right) ** 2).mean() / (right**2).mean())
        checks.add("logits against float64, of their root mean square", error, bound, why)


@case("noise of seeds at the ends of int64")
def _fields(checks: Checks) -> None:
    """Noise of seeds at both ends of int64: finite, with mean 0 and deviation 1, and not correlated."""
    seeds = torch.tensor([-(2**63), -1, 0, 1, 2**63 - 1], device=checks.device)
    field = in_double(gaussian_field(seeds, 0, 256, 256).flatten(1))
    n, checks.dtype = field.shape[1], "float32"
    checks.finite(field)
    checks.add("mean", np.abs(field.mean(axis=1)).max(), 5 / np.sqrt(n), "Five standard errors.")
    error = np.abs(field.std(axis=1) - 1).max()
    checks.add("deviation against 1", error, 5 / np.sqrt(2 * n), "Five standard errors.")
    alike = np.abs(np.corrcoef(field) - np.eye(len(seeds))).max()
    checks.add("correlation of two seeds", alike, 5 / np.sqrt(n), "Five standard errors.")


@case("images of one pixel, one row and odd sizes")
def _odd_sizes(checks: Checks) -> None:
    """Images of one pixel, of one row, and of odd sizes."""
    generator = Generator(GeneratorSpec(width=WIDTH, noise_start=0.1)).to(checks.device)
    checks.dtype = "float32"
    for height, width in ((1, 1), (1, 17), (33, 47)):
        segmentation = torch.zeros(1, 1, height, width, device=checks.device)
        image = generator(segmentation, segmentation, noise_seed=torch.tensor([1], device=checks.device))
        checks.label = f"{height} x {width}"
        checks.finite(in_double(image), what="pixels")
        checks.none("size that is wrong", image.shape[-2:] != (height, width), "The padding is cropped.")
