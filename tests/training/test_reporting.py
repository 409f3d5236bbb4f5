"""Metrics against images seen, validation, and failures that are noticed."""

import io
import logging
import math
import re
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from ablate.networks import Generator, GeneratorSpec
from ablate.training import LAST, AdversarialLoss, DivergenceError, Reconstruction, read_checkpoint, train
from support.tiny_training import SETTINGS, SPEC, batch, loader


def test_metrics_come_by_images_seen(tmp_path: Path) -> None:
    calls: list[tuple[int, dict[str, float]]] = []
    train(SPEC, SETTINGS, loader, tmp_path, sink=lambda metrics, images: calls.append((images, metrics)))
    assert [images for images, _ in calls] == [4, 8, 12, 16]
    expected = ["images_per_second", "l1", "logit_fake", "logit_real", "loss_d", "loss_g", "noise_weight"]
    assert sorted(calls[0][1]) == [f"train/{name}" for name in expected]
    assert calls[0][1]["train/noise_weight"] == pytest.approx(0.1, abs=1e-3)


def test_lines_are_about_ten(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO):
        train(SPEC, replace(SETTINGS, steps=40, log_every=1), loader, tmp_path)
    assert len(caplog.messages) == 10
    assert caplog.messages[-1].startswith("step 40 of 40: ")
    weights = [float(line.rpartition("noise weight ")[2]) for line in caplog.messages]
    assert weights == pytest.approx([0.1] * 10, abs=0.01), "they start at 0.1 and take 40 small steps"


def test_without_a_discriminator_its_values_are_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    calls: list[dict[str, float]] = []
    settings = replace(SETTINGS, loss=AdversarialLoss.none, reconstruction=Reconstruction.crps)
    with caplog.at_level(logging.INFO):
        train(SPEC, settings, loader, tmp_path, sink=lambda metrics, _: calls.append(metrics))
    assert {f"train/{name}" for name in ("images_per_second", "l1", "crps", "noise_weight")} == calls[0].keys()
    assert re.fullmatch(
        r"step 8 of 8: [\d.]+ images/s, L1 [\d.]+, CRPS [\d.]+, noise weight [\d.]+", caplog.messages[-1]
    )


def test_images_a_second_are_those_of_training_alone(tmp_path: Path) -> None:
    rates: list[float] = []

    def sink(metrics: dict[str, float], _: int) -> None:
        rates.extend(value for name, value in metrics.items() if name == "train/images_per_second")

    def validate(*_: object) -> dict[str, float]:
        time.sleep(1.0)
        return {}

    train(SPEC, replace(SETTINGS, validate_every=4, log_every=4), loader, tmp_path, sink=sink, validation=validate)
    assert min(rates) > 2 * 4 / 1.0, "two images a step and four steps; a validation takes a second"


def test_validation_is_called_with_the_generator_to_evaluate_from_the_start(tmp_path: Path) -> None:
    calls: list[tuple[int, dict[str, float]]] = []

    def validate(generator: Generator, images_seen: int) -> dict[str, float]:
        assert not torch.is_grad_enabled()
        return {"val/weight": float(generator.network.stem.weight.sum()), "val/seen": images_seen}

    train(
        SPEC,
        replace(SETTINGS, validate_every=4),
        loader,
        tmp_path,
        sink=lambda metrics, images: calls.append((images, metrics)),
        validation=validate,
    )
    validated = [(images, metrics) for images, metrics in calls if "val/weight" in metrics]
    assert [(images, metrics["val/seen"]) for images, metrics in validated] == [(0, 0), (8, 8), (16, 16)]
    average = read_checkpoint(tmp_path / LAST)["state_dict"]["average.network.stem.weight"]
    assert validated[-1][1]["val/weight"] == pytest.approx(float(average.sum()), abs=1e-6)


NORMED = """
import torch
from torch import nn

class Normed(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.layers = nn.Sequential(nn.Conv2d(channels, 4, 3, padding=1), nn.BatchNorm2d(4), nn.Conv2d(4, 1, 1))
        self.fixed = nn.BatchNorm2d(1).eval()
    def forward(self, maps):
        return torch.tanh(self.fixed(self.layers(maps)))
"""


@pytest.mark.filterwarnings("ignore:Found .* in eval mode")  # `fixed` is meant to be so
@pytest.mark.parametrize("ema_decay", [0.0, 0.9])
def test_validation_leaves_batch_norm_as_it_is_and_the_average_has_its_statistics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ema_decay: float
) -> None:
    (tmp_path / "with_batch_norm.py").write_text(NORMED)
    monkeypatch.syspath_prepend(tmp_path)
    plain = {"concat": "input", "upsampling": "transposed", "noise": "none"}
    spec = GeneratorSpec(family="custom", target="with_batch_norm.Normed", depth=2, **plain)

    def validate(generator: Generator, _: int) -> dict[str, float]:
        assert not generator.training
        other = batch(99)
        maps = {name: 1 + other[name] for name in ("segmentation", "attenuation")}
        return {"val/mean": float(generator(**maps, noise_seed=other["noise_seed"]).mean())}

    weights = []
    for every in (0, 1):
        settings = replace(SETTINGS, validate_every=every, ema_decay=ema_decay)
        train(spec, settings, loader, tmp_path / f"every{every}", validation=validate)
        weights.append(read_checkpoint(tmp_path / f"every{every}" / LAST)["state_dict"])
    without, validated = weights
    (means,) = (value for name, value in without.items() if name.startswith("gen") and name.endswith("1.running_mean"))
    assert means.abs().max() > 0
    for name, value in without.items():
        torch.testing.assert_close(validated[name], value, rtol=0, atol=0)
        if name.startswith("average") and "running" in name:
            torch.testing.assert_close(value, without[name.replace("average", "generator")], rtol=0, atol=0)


@pytest.mark.parametrize("bad_step", [4, 5])
def test_a_loss_that_is_not_finite_stops_and_keeps_the_last_good_checkpoint(tmp_path: Path, bad_step: int) -> None:
    def poisoned(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        for step in range(start, stop):
            made = batch(step)
            if step == bad_step:
                made["target"][0, 0, 0, 0] = math.inf
            yield made

    with pytest.raises(DivergenceError, match="step 6: "):
        train(SPEC, SETTINGS, poisoned, tmp_path)
    checkpoint = read_checkpoint(tmp_path / LAST)
    assert checkpoint["steps_done"] == 3
    assert all(value.isfinite().all() for value in checkpoint["state_dict"].values())


@pytest.mark.parametrize(("start", "rate", "warnings"), [(0.0, 2.5e-3, 1), (0.1, 2.5e-3, 0), (0.0, 2e-4, 0)])
def test_a_dying_noise_path_is_said_at_the_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, start: float, rate: float, warnings: int
) -> None:
    train(replace(SPEC, noise_start=start), replace(SETTINGS, learning_rate=rate), loader, tmp_path)
    lines = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert len(lines) == warnings
    assert all("noise is 0.0" in line and "model.noise_start" in line for line in lines)


def open_terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """What is written to a terminal in place of the standard error; no fixture, as pytest then captures it again."""

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    made = Terminal()
    monkeypatch.setattr("sys.stderr", made)
    monkeypatch.setenv("TQDM_MININTERVAL", "0")
    monkeypatch.setattr(logging, "raiseExceptions", False)  # of handlers of other tests, whose streams are closed
    return made


def test_what_is_said_of_an_error_does_not_stand_behind_the_line_of_progress(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = open_terminal(monkeypatch)

    def failing(*_: object) -> dict[str, float]:
        raise ValueError("a full disk")

    settings = replace(SETTINGS, validate_every=1)
    with pytest.raises(ValueError, match="a full disk") as raised:  # which keeps all that the error has passed
        train(SPEC, settings, loader, tmp_path, validation=failing)
    assert raised.tb is not None
    assert "steps" in terminal.getvalue()
    assert terminal.getvalue().endswith("\n")


def test_a_terminal_has_one_line_that_is_redrawn_with_the_time_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    terminal = open_terminal(monkeypatch)
    train(SPEC, replace(SETTINGS, steps=6, log_every=1), loader, tmp_path, title="sa2h/seed3")
    first, *redrawn, last = terminal.getvalue().split("\r")[1:]
    assert terminal.getvalue().count("\n") == 1, "of its end"
    assert all(line.startswith("sa2h/seed3: ") for line in (first, *redrawn, last))
    assert re.search(r" 50% of 6 steps, \d\d:\d\d left", "".join(redrawn))
    assert "100% of 6 steps, 00:00 left" in last


def test_lines_of_a_log_have_the_time_left_but_for_the_last(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    def slowly(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        for one in loader(start, stop):
            time.sleep(0.25)
            yield one

    with caplog.at_level(logging.INFO):
        train(SPEC, replace(SETTINGS, steps=8, log_every=2), slowly, tmp_path)
    left = [re.match(r"step \d of 8, 00:0(\d) left: ", line) for line in caplog.messages[:-1]]
    assert len(left) == 3
    assert 1 <= int(left[0][1]) <= 4, "six steps of a quarter of a second and more"
    assert caplog.messages[-1].startswith("step 8 of 8: ")
