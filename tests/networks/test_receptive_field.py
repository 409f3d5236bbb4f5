"""The receptive field of the layer list against the support of the gradient."""

import pytest
import torch
from torch import Tensor, nn

from ablate.networks import Generator, GeneratorSpec, PatchDiscriminator, conditions, patch_size, receptive_field
from support.variants import UNET


def columns_of(*gradients: Tensor) -> int:
    """How many columns, from the first to the last, have a gradient in one of (1, C, H, W)."""
    columns = torch.cat([gradient.abs().sum((0, 1, 2)).nonzero() for gradient in gradients])
    return int(columns.max() - columns.min()) + 1


@pytest.fixture(autouse=True)
def no_norm(monkeypatch: pytest.MonkeyPatch) -> None:
    """No statistics reach across the image."""
    monkeypatch.setattr("ablate.networks.families.instance_norm", lambda features: features)


def make_linear(network: nn.Module) -> None:
    """Positive weights: no contribution cancels."""
    for parameter in network.parameters():
        fan_in = parameter[0].numel() if parameter.ndim == 4 else 1
        nn.init.constant_(parameter, 1.0 / fan_in)


@pytest.mark.parametrize(
    "changes",
    [
        *({"depth": depth} for depth in (1, 2, 3, 4)),
        pytest.param({"depth": 8}, marks=pytest.mark.slow),
        {"depth": 2, "attenuation": "none"},
        {"depth": 2, "noise": "input"},
        {"depth": 2, "grain": "refine"},
        {"depth": 2, "grain": "refine", "position": "beam"},
        {"depth": 2, "labels": 3, "attenuation": "none"},
        {"depth": 2, "extra_input": "low"},
        {"depth": 3, "concat": "input"},
        {"depth": 3, "upsampling": "transposed"},
        *({**UNET, "depth": depth} for depth in (2, 4)),
        *({**UNET, "depth": 3, "extra_input": extra} for extra in ("low", "noise")),
    ],
)
def test_generator(changes: dict) -> None:
    """On a strip that is one pixel of the deepest level high, and wider than the field."""
    spec = GeneratorSpec(**changes, width=0.01)
    generator = Generator(spec).double()
    make_linear(generator)
    expected, period = receptive_field(spec), 2**spec.depth
    width = (expected // period + 3) * period
    extents = []
    for phase in range(period) if period <= 16 else (period // 2,):
        channels = {name: spec.labels if name == "segmentation" else 1 for name in conditions(spec)}
        maps = {
            name: torch.full((1, count, period, width), 1e-3, dtype=torch.float64, requires_grad=True)
            for name, count in channels.items()
        }
        generator(**maps)[0, 0, period // 2, width // 2 // period * period + phase].backward()
        extents.append(columns_of(*(value.grad for value in maps.values() if value.grad is not None)))
    assert max(extents) == expected


def test_discriminator_judges_patches_of_70() -> None:
    discriminator = PatchDiscriminator(2, width=0.01).double()
    make_linear(discriminator)
    image = torch.full((1, 1, 256, 256), 1e-3, dtype=torch.float64, requires_grad=True)
    discriminator(image.detach(), image)[0, 0, 15, 15].backward()
    assert image.grad is not None
    assert columns_of(image.grad) == patch_size(discriminator) == 70
