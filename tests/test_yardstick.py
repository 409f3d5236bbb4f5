"""The fixed work that benchmarks are compared by."""

from types import ModuleType

import pytest
import torch

from support.scripts import script


@pytest.fixture
def yardstick() -> ModuleType:
    return script("benchmarks/yardstick.py")


def test_ratios_are_taken_round_by_round(yardstick: ModuleType) -> None:
    fixed = yardstick.Yardstick()
    fixed.convolutions, fixed.loops = [10.0, 20.0, 40.0], [1.0, 1.0, 2.0]
    assert fixed.ratios([20.0, 40.0, 80.0]) == (2.0, 40.0)
    with pytest.raises(ValueError, match="argument"):
        fixed.ratios([20.0])
    torch.set_num_threads(2)
    try:
        fixed.tick()
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(1)
    assert len(fixed.convolutions) == len(fixed.loops) == 4
    assert min(fixed.convolutions[-1], fixed.loops[-1]) > 0
