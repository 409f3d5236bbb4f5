"""The receptive field of the layer list against the support of the gradient."""

import pytest
import torch
from torch import Tensor, nn

from ablate.networks import Generator, GeneratorSpec, PatchDiscriminator, conditions, patch_size, receptive_field
from support.variants import UNET


def measured_extent(gradient: Tensor) -> int:
    """Side of the smallest square that holds all of a (1, 1, H, W) gradient."""
    columns = gradient[0, 0].abs().sum(0).nonzero().flatten()
    rows = gradient[0, 0].abs().sum(1).nonzero().flatten()
    return int(max(columns[-1] - columns[0], rows[-1] - rows[0])) + 1


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
        {"depth": 2, "attenuation": "none"},
        {"depth": 2, "noise": "input"},
        {"depth": 2, "grain": "refine"},
        {"depth": 2, "grain": "refine", "upsampling": "resize", "position": "beam"},
        {"depth": 2, "labels": 3, "attenuation": "none"},
        {"depth": 2, "labels": 5, "embedding": 2, "attenuation": "none"},
        {"depth": 2, "extra_input": "low"},
        {"depth": 2, "upsampling": "resize"},
        {"depth": 3, "concat": "input"},
        {"depth": 3, "upsampling": "transposed"},
        {"depth": 3, "upsampling": "resize", "concat": "input"},
        *({**UNET, "depth": depth} for depth in (2, 4)),
        *({**UNET, "depth": 3, "extra_input": extra} for extra in ("low", "noise")),
    ],
)
def test_generator(changes: dict) -> None:
    spec = GeneratorSpec(**changes, width=0.01)
    generator = Generator(spec).double()
    make_linear(generator)
    expected = receptive_field(spec)
    period = 2**spec.depth
    size = (expected // period + 3) * period
    extents = []
    for phase in range(period):
        channels = {name: spec.labels if name == "segmentation" else 1 for name in conditions(spec)}
        maps = {
            name: torch.full((1, count, size, size), 1e-3, dtype=torch.float64, requires_grad=True)
            for name, count in channels.items()
        }
        pixel = size // 2 // period * period + phase
        generator(**maps)[0, 0, pixel, pixel].backward()
        extents.append(max(measured_extent(value.grad) for value in maps.values()))
    assert max(extents) == expected


def test_generator_of_eight_levels_on_a_strip() -> None:
    spec = GeneratorSpec(depth=8, width=0.01)
    generator = Generator(spec).double()
    make_linear(generator)
    expected, period = receptive_field(spec), 2**spec.depth
    assert expected == 2813
    width = (expected // period + 3) * period
    extents = []
    for phase in (0, period // 2):
        maps = torch.full((2, 1, 1, period, width), 1e-3, dtype=torch.float64, requires_grad=True)
        generator(*maps)[0, 0, period // 2, width // 2 // period * period + phase].backward()
        assert maps.grad is not None
        columns = maps.grad.abs().sum((0, 1, 2, 3)).nonzero()
        extents.append(int(columns.max() - columns.min()) + 1)
    assert max(extents) == expected


def test_discriminator_judges_patches_of_70() -> None:
    discriminator = PatchDiscriminator(2, width=0.01).double()
    make_linear(discriminator)
    image = torch.full((1, 1, 256, 256), 1e-3, dtype=torch.float64, requires_grad=True)
    discriminator(image.detach(), image)[0, 0, 15, 15].backward()
    assert image.grad is not None
    assert measured_extent(image.grad) == patch_size(discriminator) == 70
