"""The receptive field against the support of the gradient, which is measured here on one output at a time."""

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks import (
    Generator,
    GeneratorSpec,
    PatchDiscriminator,
    conditions,
    map_channels,
    patch_size,
    receptive_field,
)
from ablate.networks.families import LocalNetwork
from support.variants import LABELS, UNET, VARIANTS


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


def measured_field(spec: GeneratorSpec, labels: int, near: int) -> int:
    """The most columns that an output depends on, by its gradient; they are not many more than `near`.

    On a strip that is one pixel of the deepest level high, and wider than the field.
    """
    generator = Generator(spec, labels).double()
    make_linear(generator)
    period = 2**spec.depth
    width = (near // period + 3) * period
    extents = []
    for phase in range(period) if period <= 16 else (period // 2,):
        channels = {name: map_channels(name, labels) for name in conditions(spec)}
        maps = {
            name: torch.full((1, count, period, width), 1e-3, dtype=torch.float64, requires_grad=True)
            for name, count in channels.items()
        }
        generator(**maps)[0, 0, period // 2, width // 2 // period * period + phase].backward()
        extents.append(columns_of(*(value.grad for value in maps.values() if value.grad is not None)))
    assert max(extents) < width
    return max(extents)


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_variant(variant: str) -> None:
    spec = GeneratorSpec(**{"depth": 3, **VARIANTS[variant]}, width=0.01)
    expected = receptive_field(spec, LABELS[variant])
    assert expected is not None
    assert measured_field(spec, LABELS[variant], expected) == expected


@pytest.mark.parametrize(
    ("changes", "labels"),
    [
        *(({"depth": depth}, 1) for depth in (1, 2, 4)),
        pytest.param({"depth": 8}, 1, marks=pytest.mark.slow),
        ({"depth": 2, "grain": "refine"}, 1),
        ({"depth": 2, "attenuation": "none"}, 3),
        *(({**UNET, "depth": depth}, 1) for depth in (2, 4)),
    ],
)
def test_other_depths_and_labels(changes: dict, labels: int) -> None:
    spec = GeneratorSpec(**changes, width=0.01)
    expected = receptive_field(spec, labels)
    assert expected is not None
    assert measured_field(spec, labels, expected) == expected


class Whiskered(LocalNetwork):
    """With a made-up component: a wide convolution, dilated and gated, before the stem, in a layer of an odd name."""

    def __init__(self, spec: GeneratorSpec, labels: int = 1) -> None:
        super().__init__(spec, labels)
        channels = self.stem.in_channels
        self.whiskers = nn.Conv2d(channels, channels, 3, padding=4, dilation=4)
        self.gain = nn.Parameter(torch.ones(channels, 1, 1))

    def forward(self, stacked: Tensor, maps: list[Tensor | None], noise: list[Tensor | None]) -> Tensor:
        felt = self.gain * F.gelu(self.whiskers(stacked))
        return super().forward(stacked + felt * torch.sigmoid(felt), maps, noise)


def test_a_component_of_any_name_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = GeneratorSpec(depth=2, concat="input", width=0.01)  # type: ignore[arg-type]
    without = receptive_field(spec)
    monkeypatch.setattr("ablate.networks.generator.LocalNetwork", Whiskered)
    expected = receptive_field(spec)
    assert without is not None
    assert expected == without + 2 * 4
    assert measured_field(spec, 1, expected) == expected


class Bilinear(LocalNetwork):
    def forward(self, stacked: Tensor, maps: list[Tensor | None], noise: list[Tensor | None]) -> Tensor:
        halved = F.interpolate(stacked, scale_factor=0.5, mode="bilinear")
        return super().forward(F.interpolate(halved, scale_factor=2, mode="bilinear"), maps, noise)


class Softmax(LocalNetwork):
    def forward(self, stacked: Tensor, maps: list[Tensor | None], noise: list[Tensor | None]) -> Tensor:
        return super().forward(stacked.softmax(-1), maps, noise)


@pytest.mark.parametrize(("network", "operation"), [(Bilinear, "interpolate"), (Softmax, "softmax")])
def test_what_cannot_be_followed_is_named_and_not_wrong_in_silence(
    monkeypatch: pytest.MonkeyPatch, network: type[LocalNetwork], operation: str
) -> None:
    monkeypatch.setattr("ablate.networks.generator.LocalNetwork", network)
    with pytest.raises(ValueError, match=f"network with {operation} is unknown: it has no rule"):
        receptive_field(GeneratorSpec(depth=2))


def test_measuring_leaves_the_random_numbers_alone() -> None:
    torch.manual_seed(3)
    expected = torch.rand(1)
    torch.manual_seed(3)
    receptive_field(GeneratorSpec(depth=1))
    assert torch.equal(torch.rand(1), expected)


def test_discriminator_judges_patches_of_70() -> None:
    discriminator = PatchDiscriminator(2, width=0.01).double()
    make_linear(discriminator)
    image = torch.full((1, 1, 256, 256), 1e-3, dtype=torch.float64, requires_grad=True)
    discriminator(image.detach(), image)[0, 0, 15, 15].backward()
    assert image.grad is not None
    assert columns_of(image.grad) == patch_size(discriminator) == 70
