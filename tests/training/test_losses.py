"""Errors of images against plain loops, closed forms of the ranked probability score, and what draws learn from it."""

import math

import pytest
import torch
from torch import Tensor

from ablate.networks.gaussian_fields import gaussian_field
from ablate.training.losses import crps_of_two_draws, mean_in_fan, second_seeds

PIXELS = 400_000


def uniform(*shape: int, seed: int = 0) -> Tensor:
    return 2 * torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 1


def normal(seed: int) -> Tensor:
    return torch.randn(PIXELS, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def test_the_mean_in_the_fan_is_that_of_a_plain_loop_over_the_batch() -> None:
    values, mask = uniform(3, 1, 5, 7), (uniform(3, 1, 5, 7, seed=1) > 0.2).double()
    found = [
        float(values[n, 0, i, j]) for n in range(3) for i in range(5) for j in range(7) if float(mask[n, 0, i, j]) == 1
    ]
    assert 0 < len(found) < values.numel()
    assert float(mean_in_fan(values, mask)) == pytest.approx(sum(found) / len(found), rel=1e-12)


@pytest.mark.parametrize("outside", [0.0, 0.7])
def test_pixels_outside_the_fan_change_nothing(outside: float) -> None:
    """The mean over all pixels of a crop, which it was, would halve."""
    values, mask = uniform(2, 1, 4, 6), torch.ones(2, 1, 4, 6, dtype=torch.float64)
    wider = torch.cat((values, torch.full_like(values, outside)), dim=-1)
    found = mean_in_fan(wider, torch.cat((mask, 0 * mask), dim=-1))
    torch.testing.assert_close(found, mean_in_fan(values, mask), rtol=1e-12, atol=0)


def test_a_batch_without_a_fan_has_no_error_and_no_gradient() -> None:
    values = uniform(2, 1, 4, 4).requires_grad_()
    error = mean_in_fan(values, torch.zeros(2, 1, 4, 4))
    error.backward()
    assert float(error.detach()) == 0
    assert values.grad is not None
    assert not values.grad.any()


def test_two_draws_that_are_alike_are_scored_by_their_absolute_error() -> None:
    image, target = uniform(2, 1, 8, 8), uniform(2, 1, 8, 8, seed=1)
    torch.testing.assert_close(crps_of_two_draws(image, image, target), (image - target).abs(), rtol=0, atol=0)


@pytest.mark.parametrize(("mean", "sd", "target"), [(0.0, 1.0, 0.0), (0.3, 0.5, -0.4), (-1.0, 0.2, 0.5)])
def test_the_expectation_for_gaussian_draws_is_the_closed_form(mean: float, sd: float, target: float) -> None:
    """Gneiting and Raftery 2007, equation 21 for a normal distribution: their page 367."""
    z = (target - mean) / sd
    density, below = math.exp(-(z**2) / 2) / math.sqrt(2 * math.pi), 0.5 * (1 + math.erf(z / math.sqrt(2)))
    expected = sd * (z * (2 * below - 1) + 2 * density - 1 / math.sqrt(math.pi))
    scores = crps_of_two_draws(mean + sd * normal(1), mean + sd * normal(2), torch.full((PIXELS,), target))
    assert float(scores.mean()) == pytest.approx(expected, abs=5 * float(scores.std()) / math.sqrt(PIXELS))


@pytest.mark.parametrize(("spread", "sign"), [(0.05, -1), (0.3, -1), (0.5, 0), (0.8, 1)])
def test_the_gradient_leads_the_spread_to_that_of_the_target(spread: float, sign: int) -> None:
    """Targets have a standard deviation of 0.5. The mean absolute error would always lower the spread."""
    weight = torch.tensor(spread, dtype=torch.float64, requires_grad=True)
    first, second, target = weight * normal(1), weight * normal(2), 0.5 * normal(3)
    (slope,) = torch.autograd.grad(crps_of_two_draws(first, second, target).mean(), weight, retain_graph=True)
    (of_l1,) = torch.autograd.grad((first - target).abs().mean(), weight)
    noise = 5 / math.sqrt(PIXELS)
    assert float(of_l1) > noise
    assert float(slope) * sign > noise if sign else abs(float(slope)) < noise


def test_second_seeds_are_other_seeds_with_independent_fields() -> None:
    seeds = torch.randint(0, 2**62, (8,), generator=torch.Generator().manual_seed(0))
    seeds[:2] = torch.tensor([0, 2**62 - 1])
    others = second_seeds(seeds)
    assert torch.equal(others, second_seeds(seeds))
    assert (others >= 2**62).all()
    fields = torch.cat([gaussian_field(which, 0, 200, 200).flatten(1) for which in (seeds, others)])
    apart = torch.corrcoef(fields) - torch.eye(len(fields))
    assert float(apart.abs().max()) < 5 / math.sqrt(200 * 200)
