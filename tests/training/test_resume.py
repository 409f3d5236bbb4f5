"""A run stopped anywhere and continued equals the run that was not stopped, in every weight."""

import errno
import shutil
import signal
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from ablate.networks import GeneratorSpec
from ablate.training import (
    LAST,
    TRAINING_VERSION,
    Loader,
    load_generator,
    read_checkpoint,
    train,
)
from support.strangers import CUSTOM, RunsCommand, lay_trap
from support.tiny_training import SETTINGS, SPEC, loader


class Stopped(BaseException):
    """What the test's own signal handler raises, and what stands for SIGKILL."""


def loader_until(fatal_step: int, happens: Callable[[], object]) -> Loader:
    """A loader with which something happens before a step."""

    def load(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        for step, batch in zip(range(start, stop), loader(start, stop), strict=True):
            if step == fatal_step:
                happens()
            yield batch

    return load


def crash() -> None:
    raise OSError("disk gone")


@contextmanager
def handled_by(handler: Callable[..., object], number: int = signal.SIGTERM) -> Iterator[None]:
    """A handler of a signal that was there before the training."""
    previous = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, previous)


def assert_same(first: Any, second: Any) -> None:
    """Nested dicts and lists with equal tensors, to the bit."""
    assert type(first) is type(second)
    if isinstance(first, dict):
        assert first.keys() == second.keys()
        for key in first:
            assert_same(first[key], second[key])
    elif isinstance(first, list | tuple):
        for one, other in zip(first, second, strict=True):
            assert_same(one, other)
    elif isinstance(first, Tensor):
        assert torch.equal(first, second)
    else:
        assert first == second


def assert_same_state(first: Path, second: Path) -> None:
    one, other = (read_checkpoint(folder / LAST) for folder in (first, second))
    for key in ("state_dict", "optimizer_states", "steps_done"):
        assert_same(one[key], other[key])


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """`whole(precision)`: folder of a run that was not stopped."""

    @cache
    def trained(precision: str) -> Path:
        folder = tmp_path_factory.mktemp(precision)
        train(SPEC, replace(SETTINGS, precision=precision), loader, folder)
        return folder

    return trained


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize("fatal_step", [1, 3, 5, 7])
def test_a_crash_at_any_step(whole: Callable[[str], Path], tmp_path: Path, fatal_step: int, precision: str) -> None:
    settings = replace(SETTINGS, precision=precision)

    with pytest.raises(OSError, match="disk gone"):
        train(SPEC, settings, loader_until(fatal_step, crash), tmp_path)
    resumed = train(SPEC, settings, loader, tmp_path)
    assert resumed.resumed_at == (fatal_step - 1) // 3 * 3
    assert_same_state(whole(precision), tmp_path)


@pytest.mark.parametrize(
    "options",
    [{"loss": "none"}, {"reconstruction": "crps"}, {"schedule": "linear"}, {"loss": "none", "reconstruction": "crps"}],
)
def test_after_a_stop_with_other_losses_and_learning_rates(tmp_path: Path, options: dict[str, str]) -> None:
    settings = replace(SETTINGS, **options)

    train(SPEC, settings, loader, tmp_path / "whole")
    with pytest.raises(OSError, match="disk gone"):
        train(SPEC, settings, loader_until(6, crash), tmp_path / "stopped")
    # Lightning takes one batch more than it trains on.
    assert train(SPEC, settings, loader, tmp_path / "stopped").resumed_at in (3, 6)
    assert_same_state(tmp_path / "whole", tmp_path / "stopped")
    checkpoint = read_checkpoint(tmp_path / "whole" / LAST)
    has_discriminator = options.get("loss") != "none"
    assert len(checkpoint["optimizer_states"]) == 1 + has_discriminator
    assert any(key.startswith("discriminator.") for key in checkpoint["state_dict"]) == has_discriminator
    load_generator(tmp_path / "whole" / LAST)


def test_after_a_process_was_killed_while_a_checkpoint_took_the_place_of_another(
    whole: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_file = Path.replace

    def killed(path: Path, target: Path) -> Path:
        if target.exists():
            raise Stopped
        return replace_file(path, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", killed)
        patch.setattr(Path, "unlink", lambda *_, **__: None)  # what is killed does not tidy up
        with pytest.raises(Stopped):
            train(SPEC, SETTINGS, loader, tmp_path)
    assert len(list(tmp_path.iterdir())) == 2
    assert train(SPEC, SETTINGS, loader, tmp_path).resumed_at == 3
    assert_same_state(whole("fp32"), tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == [LAST]


def test_moments_laid_out_otherwise_are_the_same_moments(whole: Callable[[str], Path], tmp_path: Path) -> None:
    """Fused Adam reads weights and moments by their place in memory."""
    with pytest.raises(OSError, match="disk gone"):
        train(SPEC, SETTINGS, loader_until(5, crash), tmp_path / "resumed")
    checkpoint = read_checkpoint(tmp_path / "resumed" / LAST)
    for optimizer in checkpoint["optimizer_states"]:
        for state in optimizer["state"].values():
            for name in ("exp_avg", "exp_avg_sq"):
                if state[name].ndim == 4:
                    state[name] = state[name].contiguous(memory_format=torch.channels_last)
    torch.save(checkpoint, tmp_path / "resumed" / LAST)
    train(SPEC, SETTINGS, loader, tmp_path / "resumed")
    assert_same_state(whole("fp32"), tmp_path / "resumed")


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGUSR2])
def test_a_signal_saves_the_step_and_is_handed_on(whole: Callable[[str], Path], tmp_path: Path, number: int) -> None:
    def own_handler(*_: object) -> None:
        raise Stopped

    with handled_by(own_handler, number):
        with pytest.raises(Stopped):
            train(SPEC, SETTINGS, loader_until(4, lambda: signal.raise_signal(number)), tmp_path)
        assert signal.getsignal(number) is own_handler
    assert read_checkpoint(tmp_path / LAST)["steps_done"] in (4, 5)
    train(SPEC, SETTINGS, loader, tmp_path)
    assert_same_state(whole("fp32"), tmp_path)


@pytest.mark.parametrize("numbers", [(signal.SIGINT, signal.SIGTERM), (signal.SIGTERM, signal.SIGINT)])
def test_ctrl_c_and_then_a_parent_that_asks_again_save_the_step(tmp_path: Path, numbers: tuple[int, int]) -> None:
    """A terminal sends SIGINT to all processes; whoever started this one may send SIGTERM beside it, in any order."""

    def both() -> None:
        for number in numbers:
            signal.raise_signal(number)

    with handled_by(lambda *_: None), pytest.raises((KeyboardInterrupt, InterruptedError)):
        train(SPEC, SETTINGS, loader_until(4, both), tmp_path)
    assert read_checkpoint(tmp_path / LAST)["steps_done"] in (4, 5)


def test_a_signal_that_is_passed_over_stops_the_training_all_the_same(tmp_path: Path) -> None:
    """A cluster's launcher has such a handler; the evaluation of half a training must not follow."""
    stopping = loader_until(4, lambda: signal.raise_signal(signal.SIGTERM))
    with handled_by(lambda *_: None), pytest.raises(InterruptedError, match=f"SIGTERM after.* of {SETTINGS.steps}"):
        train(SPEC, SETTINGS, stopping, tmp_path)
    assert read_checkpoint(tmp_path / LAST)["steps_done"] in (4, 5)


def test_a_finished_run_is_not_trained_again_and_a_shorter_one_is_another_run(
    whole: Callable[[str], Path], tmp_path: Path
) -> None:
    def forbidden(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        raise AssertionError((start, stop))

    train(SPEC, SETTINGS, lambda start, stop: loader(start, stop + 3), tmp_path)  # what goes on is not trained with
    assert_same_state(tmp_path, whole("fp32"))
    train(SPEC, SETTINGS, forbidden, tmp_path)
    with pytest.raises(ValueError, match=rf"last.ckpt: of another run \(steps={SETTINGS.steps} there, 5 asked for"):
        train(SPEC, replace(SETTINGS, steps=5), loader, tmp_path)


def test_a_checkpoint_needs_no_folder_for_temporary_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "mkstemp", full)
    train(SPEC, replace(SETTINGS, steps=2), loader, tmp_path)
    assert read_checkpoint(tmp_path / LAST)["steps_done"] == 2


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="a device that is always full: Linux")
def test_a_full_disk_is_an_error_of_the_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PyTorch makes a RuntimeError of it where it opens the file itself, which looks like a fault of the program."""
    monkeypatch.setattr("ablate.training.checkpoint.written_whole", lambda _: nullcontext(Path("/dev/full")))
    with pytest.raises(OSError, match="No space left on device"):
        train(SPEC, replace(SETTINGS, steps=2), loader, tmp_path)


def test_the_generator_to_evaluate_is_the_average(tmp_path: Path) -> None:
    trained = train(SPEC, SETTINGS, loader, tmp_path)
    loaded = load_generator(trained.checkpoint)
    assert_same(loaded.state_dict(), trained.generator.state_dict())
    state = read_checkpoint(trained.checkpoint)["state_dict"]
    assert torch.equal(loaded.network.stem.weight, state["average.network.stem.weight"])
    assert not torch.equal(loaded.network.stem.weight, state["generator.network.stem.weight"])
    assert not loaded.training


def test_another_run_in_the_same_place_is_refused_with_the_difference(
    whole: Callable[[str], Path], tmp_path: Path
) -> None:
    shutil.copy(whole("fp32") / LAST, tmp_path)
    with pytest.raises(ValueError, match=r"last.ckpt: of another run \(l1_weight=100.0 there, 10.0 asked for\)"):
        train(SPEC, replace(SETTINGS, l1_weight=10.0), loader, tmp_path)
    with pytest.raises(ValueError, match="depth=2 there, 3 asked for"):
        train(replace(SPEC, depth=3), SETTINGS, loader, tmp_path)
    with pytest.raises(ValueError, match=r"of another run \(labels=1 there, 3 asked for\)"):
        train(SPEC, SETTINGS, loader, tmp_path, labels=3)


def test_incidental_settings_may_differ(whole: Callable[[str], Path], tmp_path: Path) -> None:
    with pytest.raises(OSError, match="disk gone"):
        train(SPEC, replace(SETTINGS, checkpoint_every=1), loader_until(4, crash), tmp_path)
    assert train(SPEC, replace(SETTINGS, validate_every=3, log_every=1), loader, tmp_path).resumed_at >= 1
    assert_same_state(whole("fp32"), tmp_path)


def test_a_checkpoint_says_how_many_channels_its_labels_have(tmp_path: Path) -> None:
    def encoded(start: int, stop: int) -> Iterator[dict[str, Tensor]]:
        for batch in loader(start, stop):
            yield batch | {"segmentation": batch["segmentation"].repeat(1, 3, 1, 1)}

    trained = train(SPEC, SETTINGS, encoded, tmp_path, labels=3)
    loaded = load_generator(trained.checkpoint)
    assert loaded.labels == 3
    assert_same(loaded.state_dict(), trained.generator.state_dict())


def test_a_checkpoint_of_another_version_is_refused(whole: Callable[[str], Path], tmp_path: Path) -> None:
    checkpoint = read_checkpoint(whole("fp32") / LAST)
    assert checkpoint.pop("training_version") == TRAINING_VERSION
    for version in ({}, {"training_version": 99}):
        torch.save({**checkpoint, **version}, tmp_path / LAST)
        with pytest.raises(ValueError, match=rf"this program has version {TRAINING_VERSION}; remove it to start again"):
            train(SPEC, SETTINGS, loader, tmp_path)


@pytest.mark.parametrize(("began", "goes_on"), [("bf16", "fp32"), ("fp32", "bf16")])
def test_a_run_keeps_the_precision_that_automatic_stood_for(
    whole: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, began: str, goes_on: str
) -> None:
    def machine(precision: str) -> None:
        for probe in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"):
            monkeypatch.setattr(torch.cpu, probe, lambda: precision == "bf16", raising=False)

    automatic = replace(SETTINGS, precision="auto")
    machine(began)
    with pytest.raises(OSError, match="disk gone"):
        train(SPEC, automatic, loader_until(5, crash), tmp_path)
    machine(goes_on)
    with pytest.raises(ValueError, match=rf"of another run \(precision={began} there, {goes_on} asked for\)"):
        train(SPEC, automatic, loader, tmp_path)
    train(SPEC, replace(SETTINGS, precision=began), loader, tmp_path)
    assert_same_state(whole(began), tmp_path)


@pytest.mark.parametrize("content", [b"", b"not a checkpoint"])
def test_a_broken_checkpoint_is_named(tmp_path: Path, content: bytes) -> None:
    (tmp_path / LAST).write_bytes(content)
    with pytest.raises(ValueError, match=r"last\.ckpt: not a readable checkpoint"):
        train(SPEC, SETTINGS, loader, tmp_path)
    torch.save({"weights": torch.zeros(1)}, tmp_path / LAST)
    with pytest.raises(ValueError, match="not a checkpoint of this project"):
        train(SPEC, SETTINGS, loader, tmp_path)


def test_a_hostile_checkpoint_is_refused_and_runs_nothing(tmp_path: Path) -> None:
    trace = tmp_path / "ran"
    torch.save({"steps_done": 1, "state_dict": RunsCommand(trace)}, tmp_path / LAST)
    for attempt in (lambda: train(SPEC, SETTINGS, loader, tmp_path), lambda: load_generator(tmp_path / LAST)):
        with pytest.raises(ValueError, match=r"last\.ckpt: not a readable checkpoint"):
            attempt()
    assert not trace.exists()


def test_a_class_that_only_the_checkpoint_names_is_not_imported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trap = lay_trap(tmp_path, monkeypatch)
    spec = GeneratorSpec(**CUSTOM, target=trap.network)
    trained = train(spec, replace(SETTINGS, steps=1), loader, tmp_path / "run")
    trap.set_again()
    for named in (None, "another.Net"):
        advice = rf"last\.ckpt: names code, .*; if you trust it, add custom='{trap.network}'"
        with pytest.raises(ValueError, match=advice) as caught:
            load_generator(trained.checkpoint, custom=named)
        assert "\n" not in str(caught.value)
    read_checkpoint(trained.checkpoint)
    assert not trap.has_sprung
    loaded = load_generator(trained.checkpoint, custom=trap.network)
    assert trap.has_sprung
    assert_same(loaded.state_dict(), trained.generator.state_dict())


def test_weights_of_another_variant_are_refused(whole: Callable[[str], Path], tmp_path: Path) -> None:
    checkpoint = read_checkpoint(whole("fp32") / LAST)
    checkpoint["hyper_parameters"]["spec"]["upsampling"] = "transposed"
    torch.save(checkpoint, tmp_path / "other.ckpt")
    with pytest.raises(ValueError, match=r"other\.ckpt: its weights are not of the network that it names") as caught:
        load_generator(tmp_path / "other.ckpt")
    assert "\n" not in str(caught.value)
    checkpoint["hyper_parameters"]["spec"]["upsampling"] = "bicubic"
    torch.save(checkpoint, tmp_path / "other.ckpt")
    with pytest.raises(ValueError, match="allowed are texture, transposed"):
        load_generator(tmp_path / "other.ckpt")


DRAWS = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.layers = nn.Sequential(nn.Conv2d(channels, 4, 3, padding=1), nn.Dropout2d(0.5), nn.Conv2d(4, 1, 1))
    def forward(self, maps):
        return torch.tanh(self.layers(maps))
"""


def test_what_a_network_of_ones_own_draws_follows_the_seed_and_the_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "with_dropout.py").write_text(DRAWS)
    monkeypatch.syspath_prepend(tmp_path)
    spec = GeneratorSpec(**CUSTOM, target="with_dropout.Net")
    before = torch.get_rng_state()
    train(spec, SETTINGS, loader, tmp_path / "whole")
    assert torch.equal(torch.get_rng_state(), before)
    torch.rand(1)
    with pytest.raises(OSError, match="disk gone"):
        train(spec, SETTINGS, loader_until(5, crash), tmp_path / "stopped")
    train(spec, SETTINGS, loader, tmp_path / "stopped")
    assert_same_state(tmp_path / "whole", tmp_path / "stopped")
    train(spec, replace(SETTINGS, seed=1), loader, tmp_path / "other")
    with pytest.raises(AssertionError):
        assert_same_state(tmp_path / "whole", tmp_path / "other")


def test_curves_are_means_over_the_steps_before_a_stop_too(tmp_path: Path) -> None:
    settings = replace(SETTINGS, log_every=8)
    curves: list[dict[str, float]] = []

    def sink(values: Mapping[str, float], _: int) -> None:
        curves.append({name: value for name, value in values.items() if name.startswith("train/l")})

    train(SPEC, settings, loader, tmp_path / "whole", sink)
    with pytest.raises(OSError, match="disk gone"):
        train(SPEC, settings, loader_until(5, crash), tmp_path / "stopped", sink)
    train(SPEC, settings, loader, tmp_path / "stopped", sink)
    whole, resumed = (values for values in curves if "train/l1" in values)
    assert resumed == whole


def test_threads_of_a_training_are_its_own(tmp_path: Path) -> None:
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        train(SPEC, replace(SETTINGS, steps=1, threads=1), loader, tmp_path)
        assert torch.get_num_threads() == 2
    finally:
        torch.set_num_threads(before)


def test_snapshots_are_the_weights_of_shorter_trainings_also_after_a_stop(tmp_path: Path) -> None:
    settings = replace(SETTINGS, steps=20, snapshots=4, schedule="constant", checkpoint_every=3)
    with pytest.raises(OSError, match="disk gone"):
        train(SPEC, settings, loader_until(19, crash), tmp_path / "stopped")
    kept = train(SPEC, settings, loader, tmp_path / "stopped").snapshots
    assert settings.snapshot_steps == (17, 18, 19)
    for steps, snapshot in zip(settings.snapshot_steps, kept, strict=True):
        shorter = train(SPEC, replace(settings, steps=steps, snapshots=1), loader, tmp_path / str(steps)).generator
        assert_same(snapshot.state_dict(), shorter.state_dict())


@pytest.mark.parametrize("content", [None, b"torn"])
def test_a_snapshot_that_cannot_be_read_is_named(tmp_path: Path, content: bytes | None) -> None:
    settings = replace(SETTINGS, steps=20, snapshots=2)
    train(SPEC, settings, loader, tmp_path)
    path = tmp_path / "step-19.pt"
    path.unlink()
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ValueError, match=r"step-19\.pt: not the weights of this network"):
        train(SPEC, settings, loader, tmp_path)
