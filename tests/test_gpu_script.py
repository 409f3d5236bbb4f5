"""benchmarks/gpu.py on a CPU: it says that there is no GPU, and its checks pass where the device is the CPU itself."""

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "benchmarks"))
import gpu  # noqa: E402
from ablate.networks import GeneratorSpec  # noqa: E402
from ablate.training import TrainingPrecision, TrainingSettings  # noqa: E402
from ablate.ultrasound import SimulatorSettings  # noqa: E402

SMALL = SimulatorSettings(scanlines=24, axial_samples=256, rays=2, image_shape=(64, 89))


def test_without_a_gpu_one_line_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    monkeypatch.setattr("sys.argv", ["gpu.py"])
    assert gpu.main() == 0
    assert capsys.readouterr().out.startswith("No GPU: PyTorch")


def test_a_device_that_is_the_cpu_agrees_with_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "_WARM_UP", 0)
    monkeypatch.setattr(gpu, "_REPEATS", 1)
    monkeypatch.setattr(gpu, "APART_LEVELS", {TrainingPrecision.fp32: 1.0})  # most processors have no bf16
    training = TrainingSettings(steps=2, batch_size=2, crop=32)
    checks = [
        gpu.check_simulator("cpu", SMALL, 6000),
        gpu.check_training("cpu", GeneratorSpec(depth=2, width=0.05), training),
        *gpu.check_generator("cpu", 6000),
    ]
    for check in checks:
        assert check.difference == 0, check.row()
        assert min(check.cpu_ms, check.device_ms) > 0
        assert "| ok |" in check.row()


def test_a_difference_beyond_the_allowed_one_is_shown() -> None:
    assert "DIFFERS" in gpu.Check("frame", 0.5, 0.1, "of the pixels", 1.0, 1.0).row()
