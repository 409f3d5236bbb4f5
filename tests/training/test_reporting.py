"""Metrics against images seen, validation, and failures that are noticed."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from ablate.networks import Generator, GeneratorSpec
from ablate.training import LAST, DivergenceError, Loader, TrainingSettings, read_checkpoint, train
from ablate.training.divergence import DivergenceGuard


def test_metrics_come_by_images_seen(
    spec: GeneratorSpec, settings: TrainingSettings, loader: Loader, tmp_path: Path
) -> None:
    calls: list[tuple[int, dict[str, float]]] = []
    train(spec, settings, loader, tmp_path, sink=lambda metrics, images: calls.append((images, metrics)))
    assert [images for images, _ in calls] == [4, 8, 12, 16]
    expected = ["images_per_second", "l1", "logit_fake", "logit_real", "loss_d", "loss_g", "noise_weight"]
    assert sorted(calls[0][1]) == [f"train/{name}" for name in expected]
    assert calls[0][1]["train/noise_weight"] == pytest.approx(0.1, abs=1e-3)


def test_lines_are_about_ten(
    spec: GeneratorSpec,
    settings: TrainingSettings,
    loader: Loader,
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    with caplog.at_level(logging.INFO):
        train(spec, replace(settings, steps=40, log_every=1), loader, tmp_path)
    assert len(caplog.messages) == 10
    assert caplog.messages[-1].startswith("step 40 of 40: ")


def test_validation_is_called_with_the_generator_to_evaluate_from_the_start(
    spec: GeneratorSpec, settings: TrainingSettings, loader: Loader, tmp_path: Path
) -> None:
    calls: list[tuple[int, dict[str, float]]] = []

    def validate(generator: Generator, images_seen: int) -> dict[str, float]:
        assert not torch.is_grad_enabled()
        return {"val/weight": float(generator.network.stem.weight.sum()), "val/seen": images_seen}

    train(
        spec,
        replace(settings, validate_every=4),
        loader,
        tmp_path,
        sink=lambda metrics, images: calls.append((images, metrics)),
        validation=validate,
    )
    validated = [(images, metrics) for images, metrics in calls if "val/weight" in metrics]
    assert [(images, metrics["val/seen"]) for images, metrics in validated] == [(0, 0), (8, 8), (16, 16)]
    average = read_checkpoint(tmp_path / LAST)["state_dict"]["average.network.stem.weight"]
    assert validated[-1][1]["val/weight"] == pytest.approx(float(average.sum()), abs=1e-6)


@pytest.mark.parametrize("bad_step", [4, 5])
def test_a_loss_that_is_not_finite_stops_and_keeps_the_last_good_checkpoint(
    spec: GeneratorSpec,
    settings: TrainingSettings,
    batch: Callable[[int], dict[str, Tensor]],
    tmp_path: Path,
    bad_step: int,
) -> None:
    def poisoned(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        for step in range(start, stop):
            made = batch(step)
            if step == bad_step:
                made["image"][0, 0, 0, 0] = math.inf
            yield made

    with pytest.raises(DivergenceError, match="step 6: "):
        train(spec, settings, poisoned, tmp_path)
    checkpoint = read_checkpoint(tmp_path / LAST)
    assert checkpoint["steps_done"] == 3
    assert all(value.isfinite().all() for value in checkpoint["state_dict"].values())


@pytest.mark.parametrize(("loss", "message"), [(0.0, "has won"), (2 * math.log(2), "is guessing")])
def test_a_dead_discriminator_is_noticed_once_it_stays_dead(loss: float, message: str) -> None:
    guard = DivergenceGuard(patience=3)
    guard.check({"train/loss_d": loss}, 1)
    guard.check({"train/loss_d": 0.7}, 2)
    guard.check({"train/loss_d": loss}, 3)
    guard.check({"train/loss_d": loss}, 4)
    with pytest.raises(DivergenceError, match=f"step 5: the discriminator {message}"):
        guard.check({"train/loss_d": loss}, 5)
