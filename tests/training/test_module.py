"""A step of the module against the same step written out in plain torch."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as bce

from ablate.networks import Attenuation, GeneratorSpec
from ablate.training import AdversarialLoss, Loader, PairGAN, TrainingSettings, train
from ablate.training.losses import second_seeds
from support.variants import UNET

ADVERSARIAL = [loss for loss in AdversarialLoss if loss is not AdversarialLoss.none]
PAPER = {"reconstruction": "l1", "schedule": "constant"}


@pytest.mark.parametrize(("level", "read"), [("integral", "attenuation"), ("compensated", "compensated")])
@pytest.mark.parametrize(
    ("loss", "options"),
    [
        *((loss, PAPER) for loss in AdversarialLoss),
        *(
            (loss, {**PAPER, "reconstruction": "crps"})
            for loss in (AdversarialLoss.nonsaturating, AdversarialLoss.none)
        ),
        (AdversarialLoss.nonsaturating, {**PAPER, "schedule": "linear"}),
    ],
)
def test_training_is_what_it_is_in_plain_torch(
    spec: GeneratorSpec,
    settings: TrainingSettings,
    loader: Loader,
    batch: Callable[[int], dict[str, Tensor]],
    tmp_path: Path,
    loss: AdversarialLoss,
    options: dict[str, str],
    level: str,
    read: str,
) -> None:
    spec, settings = replace(spec, attenuation=Attenuation(level)), replace(settings, loss=loss, steps=4, **options)
    generator = PairGAN(spec, settings).generator.double()  # in float32 the plain formulas round more than the module
    discriminator = PairGAN(spec, replace(settings, loss=AdversarialLoss.nonsaturating)).discriminator
    assert discriminator is not None
    discriminator.double()
    average = [parameter.detach().clone() for parameter in generator.parameters()]
    adam_g, adam_d = (
        torch.optim.Adam(network.parameters(), lr=2e-4, betas=(0.5, 0.999)) for network in (generator, discriminator)
    )
    for step in range(settings.steps):
        given = {k: v.double() if v.is_floating_point() else v for k, v in batch(step).items()}
        inside = given["mask"] > 0
        if options["schedule"] == "linear":
            for group in (*adam_g.param_groups, *adam_d.param_groups):
                group["lr"] = 2e-4 * (1, 1, 1, 0.5)[step]
        maps = torch.cat((given["segmentation"], given[read]), 1)

        def drawn(seed: Tensor, given: dict[str, Tensor] = given, inside: Tensor = inside) -> Tensor:
            rendered = generator(given["segmentation"], noise_seed=seed, **{read: given[read]})
            return torch.where(inside, rendered, -1.0)

        fake = drawn(given["noise_seed"])
        real_logits, fake_logits = discriminator(maps, given["target"]), discriminator(maps, fake.detach())
        loss_d = bce(real_logits, torch.ones_like(real_logits)) + bce(fake_logits, torch.zeros_like(fake_logits))
        adam_d.zero_grad()
        loss_d.backward()
        adam_d.step()
        logits = discriminator(maps, fake)
        if loss is AdversarialLoss.minimax:
            adversarial = (1 - logits.sigmoid()).log().mean()
        elif loss is AdversarialLoss.nonsaturating:
            adversarial = -logits.sigmoid().log().mean()
        else:
            adversarial = torch.zeros(())
        error = (fake - given["target"])[inside].abs().mean()
        if options["reconstruction"] == "crps":
            other = drawn(second_seeds(given["noise_seed"]))
            error = (error + (other - given["target"])[inside].abs().mean() - (fake - other)[inside].abs().mean()) / 2
        adam_g.zero_grad()
        (adversarial + 100 * error).backward()
        adam_g.step()
        decay = min(0.9, (1 + step) / (10 + step))
        for kept, parameter in zip(average, generator.parameters(), strict=True):
            kept.mul_(decay).add_(parameter.detach(), alpha=1 - decay)
    trained = train(spec, settings, loader, tmp_path)
    for expected, parameter in zip(average, trained.generator.parameters(), strict=True):
        torch.testing.assert_close(parameter.detach().double(), expected, rtol=1e-4, atol=2e-6)


def test_same_seed_same_start_and_the_global_generator_is_left_alone(
    spec: GeneratorSpec, settings: TrainingSettings
) -> None:
    before = torch.get_rng_state()
    first, second, other = (PairGAN(spec, replace(settings, seed=seed)) for seed in (1, 1, 2))
    assert torch.equal(before, torch.get_rng_state())
    weights = [module.generator.network.stem.weight for module in (first, second, other)]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_without_a_discriminator_the_generator_starts_the_same_and_nothing_else_is_made(
    spec: GeneratorSpec, settings: TrainingSettings
) -> None:
    with_one, without = PairGAN(spec, settings), PairGAN(spec, replace(settings, loss=AdversarialLoss.none))
    assert without.discriminator is None
    kept = {key: value for key, value in with_one.state_dict().items() if not key.startswith("discriminator.")}
    assert kept.keys() == without.state_dict().keys() < with_one.state_dict().keys()
    assert all(torch.equal(value, without.state_dict()[key]) for key, value in kept.items())
    assert len(without.configure_optimizers()) == 1


def test_the_error_falls(spec: GeneratorSpec, settings: TrainingSettings, loader: Loader, tmp_path: Path) -> None:
    seen: list[float] = []
    settings = replace(settings, steps=120, log_every=20, learning_rate=2e-3)
    train(spec, settings, loader, tmp_path, sink=lambda metrics, _: seen.append(metrics["train/l1"]))
    assert len(seen) == 6
    assert seen[-1] < 0.5 * seen[0]


@pytest.mark.parametrize(
    "changes",
    [
        {"noise": "input", "noise_start": 0.0},
        {"attenuation": "none"},
        {"extra_input": "low", "concat": "input", "upsampling": "transposed", "noise": "none", "noise_start": 0.0},
        {**UNET, "noise_start": 0.0},
        {"attenuation": "compensated"},
        {**UNET, "noise_start": 0.0, "attenuation": "compensated"},
    ],
)
def test_every_kind_of_variant_trains(
    spec: GeneratorSpec, settings: TrainingSettings, loader: Loader, tmp_path: Path, changes: dict
) -> None:
    settings = replace(settings, steps=2, ema_decay=0.0)
    trained = train(replace(spec, **changes), settings, loader, tmp_path)
    assert all(parameter.isfinite().all() for parameter in trained.generator.parameters())


@pytest.mark.parametrize("l1_weight", [0.0, 1e6])
@pytest.mark.parametrize("loss", ADVERSARIAL)
def test_extreme_weights_stay_finite(
    spec: GeneratorSpec, settings: TrainingSettings, loader: Loader, tmp_path: Path, l1_weight: float, loss: str
) -> None:
    settings = replace(settings, l1_weight=l1_weight, loss=AdversarialLoss(loss), steps=4)
    trained = train(spec, settings, loader, tmp_path)
    assert all(parameter.isfinite().all() for parameter in trained.generator.parameters())


@pytest.mark.parametrize("loss", ADVERSARIAL)
@pytest.mark.parametrize("logit", [1e4, -1e4])
def test_saturated_logits_have_finite_losses_and_gradients(
    spec: GeneratorSpec, settings: TrainingSettings, loss: AdversarialLoss, logit: float
) -> None:
    logits = torch.full((4,), logit, requires_grad=True)
    adversarial = PairGAN(spec, replace(settings, loss=loss))._adversarial(logits)
    adversarial.backward()
    assert adversarial.isfinite()
    assert logits.grad is not None
    assert logits.grad.isfinite().all()


def test_a_loader_that_ends_early_is_an_error(
    spec: GeneratorSpec, settings: TrainingSettings, loader: Loader, tmp_path: Path
) -> None:
    with pytest.raises(RuntimeError, match="loader: ended after step 7, needed are 8"):
        train(spec, settings, lambda start, stop: loader(start, stop - 1), tmp_path)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_a_gpu_trains_the_same_network(
    spec: GeneratorSpec, settings: TrainingSettings, loader: Loader, tmp_path: Path, precision: str
) -> None:
    settings = replace(settings, precision=precision, steps=2)
    on_cpu = train(spec, settings, loader, tmp_path / "cpu").generator
    on_gpu = train(spec, replace(settings, device="cuda"), loader, tmp_path / "gpu").generator
    for expected, parameter in zip(on_cpu.parameters(), on_gpu.parameters(), strict=True):
        # Adam's first steps are the signs of the gradients: 2e-4 each, and the smallest may differ in sign.
        torch.testing.assert_close(parameter.cpu(), expected, rtol=0, atol=1e-3)
