"""What a step costs: one fake for both networks, one fused update a network, no wait for the device."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from ablate.dataset import Crops, CropSettings, PlacedFrames, StoredAs, create_pairs, fill_pairs
from ablate.networks import GeneratorSpec, Space, conditions
from ablate.training import AdversarialLoss, PairGAN, Reconstruction, TrainingPrecision, TrainingSettings
from ablate.training.inference import autocast
from ablate.ultrasound import ConvexProbe
from support.tiny_training import SETTINGS, SPEC, batch
from support.torch_operations import Operations
from support.variants import BEAM, BEAM_LABELS


def module(
    spec: GeneratorSpec, settings: TrainingSettings, monkeypatch: pytest.MonkeyPatch, labels: int = 1
) -> PairGAN:
    """A module with its optimisers, as it is within a Trainer."""
    made = PairGAN(spec, settings, labels).to(settings.device)
    optimizers = made.configure_optimizers()
    monkeypatch.setattr(made, "optimizers", lambda: optimizers)
    monkeypatch.setattr(made, "manual_backward", lambda loss: loss.backward())
    return made


# Reading a number, branching on one and indexing by a condition wait for the device.
WAITS = {"_local_scalar_dense", "is_nonzero", "nonzero", "masked_select", "equal", "allclose"}


@pytest.mark.parametrize("precision", [TrainingPrecision.fp32, TrainingPrecision.bf16])
def test_nothing_waits_for_the_device_and_losses_are_float32(
    monkeypatch: pytest.MonkeyPatch, precision: TrainingPrecision
) -> None:
    made = module(SPEC, SETTINGS, monkeypatch)
    with autocast(precision, torch.device("cpu")):
        made.training_step(batch(0), 0)
        with Operations() as calls:
            made.training_step(batch(1), 1)
    assert not WAITS & calls.counts.keys()
    assert calls.counts["_fused_adam_"] == 2
    assert calls.counts["softplus"] == 3
    assert calls.dtypes["softplus"] == {torch.float32}
    assert calls.dtypes["abs"] == {torch.float32}
    with Operations() as calls:
        metrics = made.drain()
    assert calls.counts["_local_scalar_dense"] <= len(metrics)
    assert made.drain() == {}


def test_a_waiting_step_would_be_noticed() -> None:
    with Operations() as calls:
        torch.ones(2).sum().item()
    assert WAITS & calls.counts.keys() == {"_local_scalar_dense"}


@pytest.mark.parametrize("loss", [AdversarialLoss.nonsaturating, AdversarialLoss.none])
@pytest.mark.parametrize(("noise", "passes"), [("inject", 2), ("input", 2), ("none", 1)])
def test_one_fake_serves_both_networks_and_another_draw_is_rendered_where_draws_can_differ(
    monkeypatch: pytest.MonkeyPatch, loss: AdversarialLoss, noise: str, passes: int
) -> None:
    spec = replace(SPEC, noise=noise, noise_start=0.1 if noise == "inject" else 0.0)  # type: ignore[arg-type]
    made = module(spec, replace(SETTINGS, loss=loss, reconstruction=Reconstruction.crps), monkeypatch)
    fakes: list[Tensor] = []
    judged: list[Tensor] = []
    made.generator.register_forward_hook(lambda _, __, result: fakes.extend(result.detach().split(SETTINGS.batch_size)))
    if made.discriminator is not None:
        made.discriminator.register_forward_pre_hook(lambda _, args: judged.append(args[1]))
    given = batch(0)
    made.training_step(given, 0)
    assert len(fakes) == passes
    if loss is AdversarialLoss.nonsaturating:
        real, of_discriminator, of_generator = judged
        assert torch.equal(real, given["target"])
        assert all(torch.equal(image, given["mask"] * (fakes[0] + 1) - 1) for image in (of_discriminator, of_generator))
        assert (of_discriminator.requires_grad, of_generator.requires_grad) == (False, True)
    means = made.drain()
    assert ("train/crps" in means) == (passes == 2)
    if passes == 2:
        assert not torch.equal(*fakes)
        assert means["train/crps"] < means["train/l1"] * 1.5


def test_a_step_on_a_whole_frame_in_beam_space(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a crop the batch is a frame as it was simulated, mirrored or not, and the error is that of all of it."""
    rng, shape = np.random.default_rng(0), (36, 33)
    fan = np.tril(np.ones((40, 50), bool))
    placed = PlacedFrames(np.zeros((1, 4, 4)), np.arange(1), np.zeros(1, int), fan)
    pairs = create_pairs(tmp_path, placed, StoredAs(1, ["a"], Space.beam, ConvexProbe(), shape), {})
    spec = GeneratorSpec(**{**BEAM, "depth": 2, "width": 0.05})  # type: ignore[arg-type]
    drawn = {name: rng.random((1, *shape), np.float32) for name in ("illumination", "interfaces")}
    drawn |= {name: rng.integers(0, 3, (1, *shape), np.uint8) for name in ("segmentation", "target")}
    list(fill_pairs(pairs, frozenset(drawn), lambda _, maps: {name: drawn[name] for name in maps}))
    values = rng.uniform(-1, 1, (3, 3)).astype(np.float32)
    settings = CropSettings(size=0, batch_size=1, flip=True, space=Space.beam)
    crops = Crops(pairs, np.arange(1), frozenset(conditions(spec)), values, settings)
    made = module(spec, replace(SETTINGS, crop=0, batch_size=1), monkeypatch, BEAM_LABELS)
    mirrored = set()
    for step in range(8):
        given = crops[step]
        mirror = not np.array_equal(given["segmentation"][0, 0], values[drawn["segmentation"][0], 0])
        mirrored.add(mirror)
        frames = {name: frame[0, :, ::-1] if mirror else frame[0] for name, frame in drawn.items()}
        np.testing.assert_array_equal(given["segmentation"][0], values[frames["segmentation"]].transpose(2, 0, 1))
        np.testing.assert_allclose(given["illumination"][0, 0], frames["illumination"], atol=0.51 / 255)
        for name, axis in (("depth", 0), ("lateral", 1)):  # down and to the right also in a mirror
            steps = np.diff(given[name][0, 0].numpy(), axis=axis)
            np.testing.assert_allclose(steps, 2 / (shape[0] if axis == 0 else shape[1] - 1), rtol=1e-4)
        with torch.no_grad():
            image = made.generator(**{n: given[n] for n in conditions(spec)}, noise_seed=given["noise_seed"]).numpy()
        made.training_step(given, step)
        expected = np.abs(image[0, 0] - (frames["target"] / 127.5 - 1)).mean()
        assert made.drain()["train/l1"] == pytest.approx(expected, rel=1e-5)
    assert mirrored == {False, True}


@contextmanager
def forbidden_to_wait() -> Iterator[None]:
    torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("precision", [TrainingPrecision.fp32, TrainingPrecision.bf16])
def test_nothing_waits_for_a_gpu(monkeypatch: pytest.MonkeyPatch, precision: TrainingPrecision) -> None:
    made = module(SPEC, replace(SETTINGS, device="cuda"), monkeypatch)
    batches = [{name: value.cuda() for name, value in batch(step).items()} for step in range(3)]
    with autocast(precision, torch.device("cuda")):
        made.training_step(batches[0], 0)
        with forbidden_to_wait():
            for step in (1, 2):
                made.training_step(batches[step], step)
