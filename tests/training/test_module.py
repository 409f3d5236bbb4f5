"""A step of the module against the same step in plain torch; its errors against loops and closed forms."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.nn.functional import binary_cross_entropy_with_logits as bce

from ablate.networks import Attenuation, gaussian_field
from ablate.training import AdversarialLoss, PairGAN, train
from ablate.training.module import SECOND_DRAW, crps_of_two_draws
from support.tiny_training import SETTINGS, SPEC, batch, loader

PAPER = {"reconstruction": "l1", "schedule": "constant"}


@pytest.mark.parametrize(
    ("loss", "options", "read"),
    [
        *((loss, PAPER, "attenuation") for loss in AdversarialLoss),
        (AdversarialLoss.nonsaturating, {**PAPER, "reconstruction": "crps"}, "attenuation"),
        (AdversarialLoss.none, {**PAPER, "reconstruction": "crps"}, "compensated"),
        (AdversarialLoss.nonsaturating, {**PAPER, "schedule": "linear"}, "compensated"),
    ],
)
def test_training_is_what_it_is_in_plain_torch(
    tmp_path: Path, loss: AdversarialLoss, options: dict[str, str], read: str
) -> None:
    level = Attenuation.integral if read == "attenuation" else Attenuation.compensated
    spec, settings = replace(SPEC, attenuation=level), replace(SETTINGS, loss=loss, steps=4, **options)
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
        error = (fake - given["target"]).abs().mean()
        if options["reconstruction"] == "crps":
            other = drawn(given["noise_seed"] ^ SECOND_DRAW)
            error = (error + (other - given["target"]).abs().mean() - (fake - other).abs().mean()) / 2
        adam_g.zero_grad()
        (adversarial + 100 * error).backward()
        adam_g.step()
        decay = min(0.9, (1 + step) / (10 + step))
        for kept, parameter in zip(average, generator.parameters(), strict=True):
            kept.mul_(decay).add_(parameter.detach(), alpha=1 - decay)
    trained = train(spec, settings, loader, tmp_path)
    for expected, parameter in zip(average, trained.generator.parameters(), strict=True):
        torch.testing.assert_close(parameter.detach().double(), expected, rtol=1e-4, atol=2e-6)


def test_same_seed_same_start_and_the_global_generator_is_left_alone() -> None:
    before = torch.get_rng_state()
    first, second, other = (PairGAN(SPEC, replace(SETTINGS, seed=seed)) for seed in (1, 1, 2))
    assert torch.equal(before, torch.get_rng_state())
    weights = [module.generator.network.stem.weight for module in (first, second, other)]
    assert torch.equal(weights[0], weights[1])
    assert not torch.equal(weights[0], weights[2])


def test_without_a_discriminator_the_generator_starts_the_same_and_nothing_else_is_made() -> None:
    with_one, without = PairGAN(SPEC, SETTINGS), PairGAN(SPEC, replace(SETTINGS, loss=AdversarialLoss.none))
    assert without.discriminator is None
    kept = {key: value for key, value in with_one.state_dict().items() if not key.startswith("discriminator.")}
    assert kept.keys() == without.state_dict().keys() < with_one.state_dict().keys()
    assert all(torch.equal(value, without.state_dict()[key]) for key, value in kept.items())
    assert len(without.configure_optimizers()) == 1


def test_a_loader_that_ends_early_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="loader: ended after step 7, needed are 8"):
        train(SPEC, SETTINGS, lambda start, stop: loader(start, stop - 1), tmp_path)


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_a_gpu_trains_the_same_network(tmp_path: Path, precision: str) -> None:
    settings = replace(SETTINGS, precision=precision, steps=2)
    on_cpu = train(SPEC, settings, loader, tmp_path / "cpu").generator
    on_gpu = train(SPEC, replace(settings, device="cuda"), loader, tmp_path / "gpu").generator
    for expected, parameter in zip(on_cpu.parameters(), on_gpu.parameters(), strict=True):
        # Adam's first steps are the signs of the gradients: 2e-4 each, and the smallest may differ in sign.
        torch.testing.assert_close(parameter.cpu(), expected, rtol=0, atol=1e-3)


PIXELS = 400_000


def uniform(*shape: int, seed: int = 0) -> Tensor:
    return 2 * torch.rand(shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64) - 1


def normal(seed: int) -> Tensor:
    return torch.randn(PIXELS, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


@pytest.mark.parametrize(("mean", "sd", "target"), [(0.0, 1.0, 0.0), (0.3, 0.5, -0.4), (-1.0, 0.2, 0.5)])
def test_the_expectation_for_gaussian_draws_is_the_closed_form(mean: float, sd: float, target: float) -> None:
    """Gneiting and Raftery 2007, equation 21 for a normal distribution: their page 367."""
    z = (target - mean) / sd
    density, below = math.exp(-(z**2) / 2) / math.sqrt(2 * math.pi), 0.5 * (1 + math.erf(z / math.sqrt(2)))
    expected = sd * (z * (2 * below - 1) + 2 * density - 1 / math.sqrt(math.pi))
    scores = crps_of_two_draws(mean + sd * normal(1), mean + sd * normal(2), torch.full((PIXELS,), target))
    assert float(scores.mean()) == pytest.approx(expected, abs=5 * float(scores.std()) / math.sqrt(PIXELS))


@pytest.mark.parametrize(("spread", "sign"), [(0.05, -1), (0.3, -1), (0.5, 0), (0.8, 1)])
def test_the_gradient_leads_the_spread_to_that_of_the_target(spread: float, sign: int) -> None:
    """Targets have a standard deviation of 0.5. The mean absolute error would always lower the spread."""
    weight = torch.tensor(spread, dtype=torch.float64, requires_grad=True)
    first, second, target = weight * normal(1), weight * normal(2), 0.5 * normal(3)
    (slope,) = torch.autograd.grad(crps_of_two_draws(first, second, target).mean(), weight, retain_graph=True)
    (of_l1,) = torch.autograd.grad((first - target).abs().mean(), weight)
    noise = 5 / math.sqrt(PIXELS)
    assert float(of_l1) > noise
    assert float(slope) * sign > noise if sign else abs(float(slope)) < noise


def test_second_draws_have_other_seeds_with_independent_fields() -> None:
    seeds = torch.randint(0, 2**62, (8,), generator=torch.Generator().manual_seed(0))
    seeds[:2] = torch.tensor([0, 2**62 - 1])
    others = seeds ^ SECOND_DRAW
    assert (others >= 2**62).all()
    fields = torch.cat([gaussian_field(which, 0, 200, 200).flatten(1) for which in (seeds, others)])
    apart = torch.corrcoef(fields) - torch.eye(len(fields))
    assert float(apart.abs().max()) < 5 / math.sqrt(200 * 200)
