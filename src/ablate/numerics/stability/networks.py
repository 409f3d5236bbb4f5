"""Generators and discriminator in bf16 and float32 against float64, and with constant maps."""

from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.jobs.variants import variant_model, variant_names
from ablate.networks import (
    Generator,
    GeneratorSpec,
    Noise,
    PatchDiscriminator,
    conditions,
    discriminator_channels,
    gaussian_field,
)
from ablate.networks.layers import EPSILON, convolutions, instance_norm
from ablate.numerics.stability.checks import BFLOAT16, FLOAT32, FLOAT64, TF32, Case, Check, finite, labelled, none
from ablate.training.losses import mean_in_fan

WIDTH = 0.125  # rounding errors depend on the depth of a network more than on its width
SIDE = 256  # px; eight levels of stride 2 leave one pixel of it


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


class _Chain(nn.Module):
    """Generator, fan, discriminator and both losses: all that a training step differentiates."""

    def __init__(self, spec: GeneratorSpec, device: str) -> None:
        super().__init__()
        with torch.random.fork_rng():
            torch.manual_seed(0)
            self.generator = Generator(spec).to(device)
            self.discriminator = PatchDiscriminator(discriminator_channels(spec), spec.width).to(device)

    def forward(self, maps: dict[str, Tensor], noise_seed: Tensor) -> tuple[Tensor, Tensor]:
        """Compute image and loss."""
        given = {name: maps[name] for name in conditions(self.generator.spec)}
        image = self.generator(**given, noise_seed=noise_seed)
        fake = maps["mask"] * (image + 1) - 1
        logits = self.discriminator(torch.cat(list(given.values()), dim=1).to(image.dtype), fake)
        error = mean_in_fan((fake.float() - maps["target"].float()).abs(), maps["mask"].float())
        return image, F.softplus(-logits.float()).mean() + 100 * error


def _run(chain: _Chain, maps: dict[str, Tensor], bf16: bool = False) -> tuple[np.ndarray, float, list[np.ndarray]]:
    """Compute image, loss and the gradients of all weights."""
    device = maps["mask"].device
    seed = torch.tensor([3, 2**62], device=device)
    with torch.autocast(device.type, torch.bfloat16, enabled=bf16):
        image, loss = chain(maps, seed)
    loss.backward()
    return in_double(image), float(loss), gradients_of(chain)


def in_double(values: Tensor) -> np.ndarray:
    """Copy values to the processor as float64."""
    return values.detach().double().cpu().numpy()


def gradients_of(network: nn.Module) -> list[np.ndarray]:
    """Copy the gradients of all weights that have one."""
    return [in_double(p.grad) for p in network.parameters() if p.grad is not None]


def _errors_of_layers(network: nn.Module, device: str) -> Iterator[tuple[str, bool, float, str]]:
    """By precision: its name, whether it is bf16, and the error of all layers together with its reason."""
    layers = convolutions(network)
    terms = max(layer.weight[0].numel() for layer in layers)
    why = f"{len(layers)} layers, each a sum of up to {terms} products, if all errors add up."
    if device.startswith("cuda") and torch.backends.cudnn.allow_tf32:  # a GPU may round factors to TF32
        yield "tf32", False, len(layers) * 3 * TF32, why
    else:
        yield "float32", False, len(layers) * (terms * FLOAT32), why
    yield "bfloat16", True, len(layers) * (3 * BFLOAT16), f"{len(layers)} layers that round input, weight and result."


def _variant(name: str, device: str) -> Iterator[Check]:
    """Image, loss and gradients of a training step, at an eighth of the paper's width."""
    spec = replace(variant_model(name), width=WIDTH)
    spec = replace(spec, noise_start=0.1 if spec.noise is Noise.inject else 0.0)
    yield from _precisions(spec, maps_of(device), device)


def _precisions(spec: GeneratorSpec, maps: dict[str, Tensor], device: str) -> Iterator[Check]:
    chain = _Chain(spec, device)
    exact = deepcopy(chain).double()
    right, _, _ = _run(exact, {name: value.double() for name, value in maps.items()})
    size = float(np.sqrt((right**2).mean())) or 1.0
    for dtype, bf16, bound, why in _errors_of_layers(chain.generator, device):
        chain.zero_grad(set_to_none=True)
        image, loss, gradients = _run(chain, maps, bf16)
        yield finite(dtype, image, np.array(loss), what="pixels and loss")
        yield finite(dtype, *gradients, what="gradients")
        error = float(np.sqrt(((image - right) ** 2).mean())) / size
        yield Check(dtype, "image against float64, of its root mean square", error, bound, why)


def _constant_norm(device: str) -> Iterator[Check]:
    """Instance norm of constant maps: the deviation is 0, and so is the result."""
    units = {torch.float32: FLOAT32, torch.bfloat16: BFLOAT16, torch.float64: FLOAT64}
    for (kind, unit), value in product(units.items(), (0.0, 1.0, -1e4, 1e30)):
        dtype = str(kind).removeprefix("torch.")
        features = torch.full((1, 4, 64, 64), value, dtype=kind, device=device, requires_grad=True)
        out = instance_norm(features)
        out.sum().backward()
        assert features.grad is not None
        yield finite(dtype, in_double(out), in_double(features.grad), what=f"{value:g}: values")
        error = float(np.abs(in_double(out)).max())
        why = "The mean is rounded, the deviation is at least sqrt(epsilon), and no result exceeds 1."
        yield Check(dtype, f"{value:g}: largest value", error, min(1.0, 2 * abs(value) * unit / np.sqrt(EPSILON)), why)


def _one_pixel(device: str) -> Iterator[Check]:
    """Instance norm of a map of one pixel does not change it."""
    for dtype, kind in (("float32", torch.float32), ("bfloat16", torch.bfloat16)):
        features = torch.randn(2, 8, 1, 1, device=device).to(kind)
        changed = float((instance_norm(features) - features).abs().max())
        yield Check(dtype, "change of a map of 1 x 1", changed, 0, "Its deviation is 0; normalising it would give 0.")


def _constant_maps(device: str) -> Iterator[Check]:
    """Constant maps: one tissue everywhere, no fan, and shadow everywhere."""
    constants = ("all one tissue", 1.0, 1.0), ("all outside", -1.0, 0.0), ("all shadow", 0.0, 0.0)
    for label, segmentation, attenuation in constants:
        maps = maps_of(device)
        maps["segmentation"].fill_(segmentation)
        maps["attenuation"].fill_(attenuation)
        for name in ("sa2h", "lsa2h"):
            spec = replace(variant_model(name), width=WIDTH)
            yield from labelled(f"{label}, {name}", _precisions(spec, maps, device))


def _discriminator(device: str) -> Iterator[Check]:
    """Weights that are a thousand times too large: logits of 1e9 and more."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        network = PatchDiscriminator(3, WIDTH).to(device)
    with torch.no_grad():
        for layer in convolutions(network):
            layer.weight.mul_(1e3)
    maps = maps_of(device)
    stacked = torch.cat((maps["segmentation"], maps["attenuation"]), dim=1)
    exact = deepcopy(network).double()
    right = exact(stacked.double(), maps["target"].double()).detach()
    for dtype, bf16, bound, why in _errors_of_layers(network, device):
        network.zero_grad(set_to_none=True)
        with torch.autocast(torch.device(device).type, torch.bfloat16, enabled=bf16):
            logits = network(stacked, maps["target"])
        F.softplus(-logits.float()).mean().backward()
        yield finite(dtype, in_double(logits), what="logits")
        yield finite(dtype, *gradients_of(network), what="gradients")
        error = float((logits.detach().double() - right).square().mean().sqrt() / right.square().mean().sqrt())
        yield Check(dtype, "logits against float64, of their root mean square", error, bound, why)


def _fields(device: str) -> Iterator[Check]:
    """Noise of seeds at both ends of int64: finite, with mean 0 and deviation 1, and not correlated."""
    seeds = torch.tensor([-(2**63), -1, 0, 1, 2**63 - 1], device=device)
    field = gaussian_field(seeds, 0, 256, 256).double().flatten(1).cpu().numpy()
    n = field.shape[1]
    yield finite("float32", field)
    yield Check("float32", "mean", float(np.abs(field.mean(axis=1)).max()), 5 / np.sqrt(n), "Five standard errors.")
    error = float(np.abs(field.std(axis=1) - 1).max())
    yield Check("float32", "deviation against 1", error, 5 / np.sqrt(2 * n), "Five standard errors.")
    alike = float(np.abs(np.corrcoef(field) - np.eye(len(seeds))).max())
    yield Check("float32", "correlation of two seeds", alike, 5 / np.sqrt(n), "Five standard errors.")


def _odd_sizes(device: str) -> Iterator[Check]:
    """Images of one pixel, of one row, and of odd sizes."""
    generator = Generator(GeneratorSpec(width=WIDTH, noise_start=0.1)).to(device)
    for height, width in ((1, 1), (1, 17), (33, 47)):
        segmentation = torch.zeros(1, 1, height, width, device=device)
        image = generator(segmentation, segmentation, noise_seed=torch.tensor([1], device=device)).detach()
        yield finite("float32", image.cpu().numpy(), what=f"{height} x {width}: pixels")
        wrong = image.shape[-2:] != (height, width)
        yield none("float32", f"{height} x {width}: size that is wrong", wrong, "The padding is cropped.")


def cases() -> tuple[Case, ...]:
    """List a case for each file of conf/variant, and the cases of parts of the networks."""
    return (
        *(Case(f"{name} in bf16, float32 and float64", partial(_variant, name)) for name in variant_names()),
        Case("a constant image through instance norm", _constant_norm),
        Case("a map of one pixel through instance norm", _one_pixel),
        Case("constant maps through the generators", _constant_maps),
        Case("saturated discriminator logits", _discriminator),
        Case("noise of seeds at the ends of int64", _fields),
        Case("images of one pixel, one row and odd sizes", _odd_sizes),
    )
