"""Instance norm against its definition in double precision, of channels that hardly vary and of whole frames."""

import pytest
import torch

from ablate.networks.layers import instance_norm


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
