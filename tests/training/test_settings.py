"""The paper's values, what is refused, and which arithmetic `auto` means."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch

from ablate.networks import GeneratorSpec
from ablate.training import Schedule, TrainingPrecision, TrainingSettings, chosen_device, chosen_precision, train
from support.tiny_training import SETTINGS, loader


def test_the_learning_rate_falls_linearly_to_0_over_the_second_half() -> None:
    constant = TrainingSettings(steps=10)
    linear = replace(constant, schedule=Schedule.linear)
    assert [constant.learning_rate_at(step) for step in range(10)] == [2e-4] * 10
    expected = [1, 1, 1, 1, 1, 1, 0.8, 0.6, 0.4, 0.2, 0]
    assert [linear.learning_rate_at(step) for step in range(11)] == pytest.approx([2e-4 * share for share in expected])


def test_without_a_discriminator_there_must_be_another_loss() -> None:
    with pytest.raises(ValueError, match="l1_weight=0 with loss=none: allowed are numbers above 0"):
        TrainingSettings(loss="none", l1_weight=0.0)  # type: ignore[arg-type]


def test_a_crop_smaller_than_the_network_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="crop=32: allowed are 2\\^depth = 256 and more"):
        train(GeneratorSpec(depth=8), SETTINGS, loader, tmp_path)


@pytest.mark.parametrize(("has_bf16", "expected"), [(True, TrainingPrecision.bf16), (False, TrainingPrecision.fp32)])
def test_auto_is_bf16_where_the_cpu_has_it(
    has_bf16: bool, expected: TrainingPrecision, monkeypatch: pytest.MonkeyPatch
) -> None:
    for probe in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"):
        monkeypatch.setattr(torch.cpu, probe, lambda: has_bf16)
    assert chosen_precision(TrainingPrecision.auto, torch.device("cpu")) is expected
    assert chosen_precision(TrainingPrecision.fp32, torch.device("cpu")) is TrainingPrecision.fp32


def test_a_gpu_that_is_not_there_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert chosen_device("auto") == torch.device("cpu")
    with pytest.raises(RuntimeError, match="device=cuda: this machine has no usable GPU"):
        chosen_device("cuda")
