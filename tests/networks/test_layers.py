"""The layers written for speed against torch's own, in value and gradient."""

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import (
    JointConvolution,
    JointTransposedConvolution,
    instance_norm,
)


def gradients(result: Tensor, wanted: list[Tensor]) -> tuple[Tensor, ...]:
    weights = torch.linspace(-1, 2, result.numel(), dtype=result.dtype).view_as(result)
    return torch.autograd.grad((result * weights).sum(), wanted)


@pytest.mark.parametrize("shape", [(2, 3, 40, 30), (2, 5, 31, 31), (1, 1, 1, 2), (2, 2, 64, 1), (1, 16, 64, 48)])
@pytest.mark.parametrize("memory_format", [torch.channels_last, torch.contiguous_format])
def test_instance_norm_is_that_of_torch(shape: tuple[int, ...], memory_format: torch.memory_format) -> None:
    random = torch.Generator().manual_seed(0)
    features = torch.randn(shape, generator=random, dtype=torch.float64) * 3 + 5
    features = features.to(memory_format=memory_format).requires_grad_()
    torch.testing.assert_close(instance_norm(features), F.instance_norm(features), rtol=1e-9, atol=1e-9)
    ours, torchs = (gradients(norm(features), [features])[0] for norm in (instance_norm, F.instance_norm))
    torch.testing.assert_close(ours, torchs, rtol=1e-9, atol=1e-9)
    single = features.detach().float().requires_grad_()
    torch.testing.assert_close(gradients(instance_norm(single), [single])[0].double(), torchs, rtol=1e-3, atol=1e-4)


# A layer of `LAYERS` and what it computes in the plain way, each with its arguments beside the input channels.
LAYERS = {
    "joint": (JointConvolution, (6, 3, 1, 1), nn.Conv2d, (6, 3, 1, 1)),
    "joint, stride 2": (JointConvolution, (6, 3, 2, 1), nn.Conv2d, (6, 3, 2, 1)),
    "transposed 4x4": (JointTransposedConvolution, (6, 4, 2, 1), nn.ConvTranspose2d, (6, 4, 2, 1)),
    "transposed 3x3": (JointTransposedConvolution, (6, 3, 2, 1, 1), nn.ConvTranspose2d, (6, 3, 2, 1, 1)),
}


@pytest.mark.parametrize("maps", [0, 2])
@pytest.mark.parametrize("size", [(9, 7), (1, 1), (1, 6)])
@pytest.mark.parametrize("name", LAYERS)
def test_layers_are_torchs_on_the_concatenation(name: str, size: tuple[int, int], maps: int) -> None:
    torch.manual_seed(0)
    kind, own, plain, of_plain = LAYERS[name]
    layer, reference = kind(4 + maps, *own).double(), plain(4 + maps, *of_plain).double()
    reference.load_state_dict(layer.state_dict())
    features = torch.randn(2, 4, *size, dtype=torch.float64, requires_grad=True)
    beside = [torch.randn(2, maps, *size, dtype=torch.float64)] if maps else []
    expected, result = reference(torch.cat((features, *beside), 1)), layer(features, *beside)
    torch.testing.assert_close(result, expected, rtol=1e-12, atol=1e-12)
    ours = gradients(result, [features, *layer.parameters()])
    torchs = gradients(expected, [features, *reference.parameters()])
    torch.testing.assert_close(ours, torchs, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    ("mean", "deviation", "dtype", "bound"),
    [
        (0.5, 0.5, torch.float32, 1e-5),
        (1.0, 0.01, torch.float32, 1e-4),  # rounding of the input alone is 2^-24 of the mean, 6e-6 of the deviation
        (1.0, 0.1, torch.bfloat16, 0.02),  # the result is rounded to 2^-8 of up to 4 deviations
        (1.0, 0.01, torch.float64, 1e-10),
    ],
)
@pytest.mark.parametrize("shape", [(1, 2, 1000, 1386), (2, 8, 24, 24)])
@pytest.mark.parametrize("trained", [False, True])
def test_large_maps_keep_their_digits(
    shape: tuple[int, ...], mean: float, deviation: float, dtype: torch.dtype, bound: float, trained: bool
) -> None:
    random = torch.Generator().manual_seed(0)
    values = (mean + deviation * torch.randn(shape, generator=random)).to(dtype)
    features = values.contiguous(memory_format=torch.channels_last).requires_grad_(trained)
    exact = values.double()
    variance, centre = torch.var_mean(exact, (2, 3), correction=0, keepdim=True)
    expected = (exact - centre) / (variance + 1e-5).sqrt()
    torch.testing.assert_close(instance_norm(features).detach().double(), expected, rtol=0, atol=bound)
