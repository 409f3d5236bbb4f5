"""The noise is normal, independent, and a function of (seed, level, pixel)."""

import numpy as np
import pytest
import torch
from scipy import stats

from ablate.networks import gaussian_field


def test_the_hash_is_splitmix64() -> None:
    # First outputs of the reference implementation (Vigna, splitmix64.c) for the state 1234567.
    from ablate.networks.gaussian_fields import _GOLDEN, _mix

    state = torch.tensor([1234567]) + torch.arange(1, 4) * _GOLDEN
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert [value % 2**64 for value in _mix(state).tolist()] == expected


def test_values_are_standard_normal() -> None:
    sample = gaussian_field(torch.arange(4), 0, 256, 256).flatten().double().numpy()
    assert stats.kstest(sample, "norm").pvalue > 0.01
    assert abs(sample.mean()) < 4 / np.sqrt(sample.size)
    assert abs(sample.std() - 1) < 4 / np.sqrt(2 * sample.size)
    assert abs(stats.kurtosis(sample)) < 4 * np.sqrt(24 / sample.size)


def test_fields_are_white_and_independent_of_each_other() -> None:
    first, second = gaussian_field(torch.tensor([1, 2]), 0, 128, 128).squeeze(1).double()
    other_level = gaussian_field(torch.tensor([1]), 1, 128, 128)[0, 0].double()
    shifted = [first.roll(shift, (0, 1)) for shift in ((0, 1), (1, 0), (64, 0), (1, 1))]
    bound = 4.5 / 128
    for other in (second, other_level, *shifted):
        correlation = float((first * other).mean())
        assert abs(correlation) < bound


def test_a_sample_does_not_depend_on_its_batch() -> None:
    together = gaussian_field(torch.tensor([7, 2**62, -3]), 2, 33, 17)
    assert together.shape == (3, 1, 33, 17)
    for index, seed in enumerate((7, 2**62, -3)):
        assert torch.equal(together[index : index + 1], gaussian_field(torch.tensor([seed]), 2, 33, 17))


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_draws_the_same_field() -> None:
    seeds = torch.arange(3)
    on_gpu = gaussian_field(seeds.cuda(), 1, 64, 64).cpu()
    torch.testing.assert_close(on_gpu, gaussian_field(seeds, 1, 64, 64), rtol=1e-5, atol=1e-5)
