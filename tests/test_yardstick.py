"""The fixed work that benchmarks are compared by."""

from pathlib import Path
from types import ModuleType

import pytest
import torch

from support.scripts import script

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


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


SCRIPTS = {path.stem for path in BENCHMARKS.glob("*.py") if "__main__" in path.read_text()}
TIMED = SCRIPTS - {"chaos", "gpu"}  # faults are not timed; a GPU is measured against a plain loop and its matrix rate


@pytest.mark.parametrize("script", sorted(TIMED))
def test_every_benchmark_uses_it_and_finds_what_it_imports(script: str) -> None:
    text = (BENCHMARKS / f"{script}.py").read_text()
    assert "from yardstick import" in text
    if "from support" in text:  # which lies in tests/
        assert f"PYTHONPATH=tests $(BIN)/python benchmarks/{script}.py" in (BENCHMARKS.parent / "Makefile").read_text()
