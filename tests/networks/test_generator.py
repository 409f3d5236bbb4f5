"""Any size in, the same size out; noise from seeds; nothing read that a variant does not use."""

from itertools import product

import numpy as np
import pytest
import torch
from scipy import stats
from torch import Tensor
from torch.nn import functional as F

from ablate.networks import (
    Generator,
    GeneratorSpec,
    PatchDiscriminator,
    discriminator_channels,
    gaussian_field,
    inputs,
)
from ablate.networks.generator import _GOLDEN, _mix, folded, unfolded
from ablate.networks.layers import area_means
from support.variants import LABELS, OUTSIDE, VARIANTS, random_maps


def make(labels: int = 1, **changes: object) -> Generator:
    torch.manual_seed(0)
    defaults: dict = {"depth": 3, "width": 0.1}
    return Generator(GeneratorSpec(**{**defaults, **changes}), labels).eval()


def maps(height: int = 24, width: int = 32, batch: int = 2, labels: int = 1) -> dict[str, Tensor]:
    return {**random_maps(labels, batch, height, width), "noise_seed": torch.arange(batch)}


LARGE = {(1024, 1023): {}, (1, 1024): {"depth": 8}, (999, 3): {"depth": 8}, (1023, 65): VARIANTS["concat"]}


@pytest.mark.parametrize(
    ("size", "labels", "changes"),
    [
        *(
            (size, LABELS[variant], VARIANTS[variant])
            for size, variant in product([(1, 1), (8, 8), (13, 30), (25, 33)], VARIANTS)
        ),
        *((size, 1, {"width": 0.02, **changes}) for size, changes in LARGE.items()),
    ],
)
def test_any_size_comes_back_in_range(size: tuple[int, int], labels: int, changes: dict) -> None:
    with torch.inference_mode():
        image = make(labels, **changes)(**maps(*size, labels=labels))
    assert image.shape == (2, 1, *size)
    assert image.isfinite().all()
    assert image.abs().max() <= 1


def test_at_depth_8_a_crop_of_256_ends_in_one_pixel_that_is_not_normalised() -> None:
    generator, given = make(depth=8), maps(256, 256, batch=1)
    seen: list[tuple[Tensor, Tensor]] = []
    generator.network.bottleneck.register_forward_hook(lambda _, args, output: seen.append((args[0], output)))
    grown: list[Tensor] = []
    generator.network.up[0].register_forward_pre_hook(lambda _, args: grown.append(args[0]))
    generator(**given)
    (features, raw), ((bottom, skipped),) = seen[0], grown
    assert raw.shape[-2:] == (1, 1)
    # Normalising one pixel would leave zero: the activation is passed on as it is.
    torch.testing.assert_close((bottom, skipped), (F.leaky_relu(raw, 0.2), features), rtol=0, atol=0)
    assert bottom.abs().min() > 0


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_parameter_is_used(variant: str) -> None:
    generator = make(LABELS[variant], **VARIANTS[variant])
    generator(**maps(labels=generator.labels)).square().mean().backward()
    unused = [name for name, p in generator.named_parameters() if p.grad is None or not p.grad.any()]
    # A bias before instance norm without a non-linearity between them cancels: pix2pix has them too.
    assert not [name for name in unused if generator.spec.family == "local" or not name.endswith("bias")]


@pytest.mark.parametrize("variant", VARIANTS)
def test_exactly_the_named_maps_are_read(variant: str) -> None:
    generator = make(LABELS[variant], **VARIANTS[variant])
    given = maps(labels=generator.labels)
    reference = generator(**given)
    for name in OUTSIDE:
        changed = generator(**{**given, name: given[name].flip(-1)})
        assert torch.equal(changed, reference) is (name not in inputs(generator.spec))


@pytest.mark.parametrize("variant", ["sa2h", "compensated", "lsa2h", "beam"])
def test_padding_is_a_larger_frame_with_nothing_beside_the_fan(variant: str) -> None:
    generator = make(LABELS[variant], **{**VARIANTS[variant], **({} if variant == "lsa2h" else {"noise_start": 0.5})})
    given = maps(21, 30, labels=generator.labels)
    padded = {name: F.pad(given[name], (0, 2, 0, 3), value=outside) for name, outside in OUTSIDE.items()}
    whole = generator(**padded, noise_seed=given["noise_seed"])
    assert torch.equal(generator(**given), whole[..., :21, :30])


def test_folded_rows_are_channels_and_come_back() -> None:
    """Row r of channel c is row r // 2 of channel 2 c + r % 2."""
    image = torch.arange(2.0 * 3 * 8 * 5).reshape(2, 3, 8, 5)
    cells = folded(image, 2)
    assert cells.shape == (2, 6, 4, 5)
    for channel, row in ((0, 0), (1, 3), (2, 6)):
        torch.testing.assert_close(cells[:, 2 * channel + row % 2, row // 2], image[:, channel, row])
    torch.testing.assert_close(unfolded(folded(image[:, :1], 2), 2), image[:, :1])
    assert folded(image, 1) is image


@pytest.mark.parametrize("variant", ["beam", "beam-unet"])
def test_a_network_of_folded_rows_is_that_network_of_half_the_rows(variant: str) -> None:
    """It reads and gives each pair of rows as two channels of one: its layers are those of a frame of half the rows."""
    spec = {**VARIANTS[variant], "noise": "none", "noise_start": 0.0, "depth": 2}
    generator = make(LABELS[variant], **spec, fold="rows")
    given = maps(32, 24, labels=LABELS[variant])
    halves = {name: folded(values, 2) for name, values in given.items() if name in inputs(generator.spec)}
    stacked = torch.cat([halves[name] for name in inputs(generator.spec)], dim=1)
    pyramid = [stacked, area_means(stacked), area_means(area_means(stacked))]
    expected = generator.network(stacked, pyramid, [None, None])
    assert expected.shape == (len(stacked), 2, 16, 24)
    torch.testing.assert_close(generator(**given), unfolded(expected, 2))


def test_seeds_that_are_no_multiple_of_the_samples_are_refused() -> None:
    with pytest.raises(ValueError, match="noise_seed: 3 for 2 samples, allowed is a multiple"):
        make()(**{**maps(), "noise_seed": torch.arange(3)})


def test_a_missing_or_misshapen_map_is_refused_by_name() -> None:
    given = maps()
    with pytest.raises(ValueError, match="attenuation: missing, this generator reads segmentation, attenu"):
        make()(given["segmentation"])
    with pytest.raises(ValueError, match="attenuation: shape"):
        make()(given["segmentation"], given["attenuation"][..., :-1])
    with pytest.raises(ValueError, match="segmentation: shape"):
        make()(given["segmentation"][0], given["attenuation"][0])


@pytest.mark.parametrize("changes", [{"noise_start": 0.5}, {"noise": "input"}, VARIANTS["nsa2h"]])
def test_noise_is_the_seeds_and_nothing_elses(changes: dict) -> None:
    generator, given = make(**changes), maps(batch=3)
    together = generator(**given)
    assert torch.equal(together, generator(**given))
    other = generator(**{**given, "noise_seed": given["noise_seed"] + 3})
    assert not torch.equal(together, other)
    alone = generator(**{name: value[1:2] for name, value in given.items()})
    torch.testing.assert_close(together[1:2], alone, rtol=1e-5, atol=1e-6)
    quiet = generator(**{**given, "noise_seed": None})
    assert not torch.equal(together, quiet)


@pytest.mark.parametrize("changes", [{}, {"noise": "none"}, VARIANTS["lsa2h"]])
def test_without_noise_or_with_weight_zero_the_seed_is_nothing(changes: dict) -> None:
    generator, given = make(**changes), maps()
    assert torch.equal(generator(**given), generator(**{**given, "noise_seed": None}))


def test_injected_noise_is_the_weight_times_one_field_a_level() -> None:
    generator, given = make(depth=2), maps()
    block = generator.network.up[1]
    with torch.no_grad():
        block.noise_weight.copy_(torch.linspace(-1, 1, block.noise_weight.numel())[:, None, None])
    seen: list[Tensor] = []
    generator.network.output.register_forward_pre_hook(lambda _, args: seen.append(torch.cat(args[:2], dim=1)))
    generator(**given)
    generator(**{**given, "noise_seed": None})
    difference = seen[0] - seen[1]
    expected = block.noise_weight * gaussian_field(given["noise_seed"], 0, 24, 32)
    torch.testing.assert_close(difference, expected, rtol=0, atol=1e-5)


@pytest.mark.parametrize("variant", ["sa2h", "nsa2h"])
def test_several_draws_of_one_sample_are_its_renderings_one_by_one(variant: str) -> None:
    noisy = {"noise_start": 0.1} if variant == "sa2h" else {}
    generator = make(LABELS[variant], **VARIANTS[variant], **noisy)
    given, other, calls = maps(labels=generator.labels), torch.tensor([7, 8]), 0
    apart = torch.cat([generator(**{**given, "noise_seed": seeds}) for seeds in (given["noise_seed"], other)])
    first = generator.network.stem if variant == "sa2h" else generator.network.down[0]

    def count(*_: object) -> None:
        nonlocal calls
        calls += 1

    first.register_forward_hook(count)
    together = generator(**{**given, "noise_seed": torch.cat((given["noise_seed"], other))})
    torch.testing.assert_close(together, apart, rtol=0, atol=1e-5)
    assert calls == 1
    assert not torch.allclose(together[:2], together[2:])


@pytest.mark.parametrize("variant", VARIANTS)
def test_bf16_stays_in_bf16_and_close(variant: str) -> None:
    generator = make(LABELS[variant], **VARIANTS[variant])
    given, dtypes = maps(labels=generator.labels), set()
    for layer in generator.network.modules():
        if not list(layer.children()):
            layer.register_forward_pre_hook(lambda _, args: dtypes.add(args[0].dtype))
    reference = generator(**given)
    dtypes.clear()
    with torch.autocast("cpu", torch.bfloat16):
        image = generator(**given)
    assert dtypes == {torch.bfloat16}
    assert (image.float() - reference).abs().mean() < 0.05


def test_initial_weights_are_pix2pixs() -> None:
    layer = make(width=1).network.down[1].refine
    assert float(layer.weight.detach().std()) == pytest.approx(0.02, rel=0.02)
    assert not layer.bias.any()  # type: ignore[union-attr]


def test_discriminator_has_one_logit_a_patch_and_refuses_smaller_images() -> None:
    spec = GeneratorSpec(extra_input="low")  # type: ignore[arg-type]
    discriminator = PatchDiscriminator(discriminator_channels(spec), width=0.1)
    conditions = torch.zeros(1, 3, 256, 256)
    assert discriminator(conditions, conditions[:, :1]).shape == (1, 1, 30, 30)
    small = conditions[..., :32, :32]
    assert discriminator(small, small[:, :1]).shape == (1, 1, 2, 2)


def test_the_hash_is_splitmix64() -> None:
    # First outputs of the reference implementation (Vigna, splitmix64.c) for the state 1234567.
    state = torch.tensor([1234567]) + torch.arange(1, 4) * _GOLDEN
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423]
    assert [value % 2**64 for value in _mix(state).tolist()] == expected


def test_values_are_standard_normal() -> None:
    sample = gaussian_field(torch.arange(4), 0, 256, 256).flatten().double().numpy()
    assert (sample == gaussian_field(torch.arange(4, dtype=torch.int32), 0, 256, 256).flatten().numpy()).all()
    with pytest.raises(ValueError, match="whole numbers"):
        gaussian_field(torch.tensor([0.5]), 0, 8, 8)
    assert stats.kstest(sample, "norm").pvalue > 0.01
    assert abs(sample.mean()) < 4 / np.sqrt(sample.size)
    assert abs(sample.std() - 1) < 4 / np.sqrt(2 * sample.size)
    assert abs(stats.kurtosis(sample)) < 4 * np.sqrt(24 / sample.size)


def test_fields_are_white_and_independent_of_each_other() -> None:
    first, second = gaussian_field(torch.tensor([1, 2]), 0, 128, 128).squeeze(1).double()
    other_level = gaussian_field(torch.tensor([1]), 1, 128, 128)[0, 0].double()
    shifted = [first.roll(shift, (0, 1)) for shift in ((0, 1), (1, 0), (64, 0), (1, 1))]
    bound = 4.5 / 128
    for other in (second, other_level, *shifted):
        correlation = float((first * other).mean())
        assert abs(correlation) < bound


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a GPU")
def test_a_gpu_draws_the_same_field() -> None:
    seeds = torch.arange(3)
    on_gpu = gaussian_field(seeds.cuda(), 1, 64, 64).cpu()
    torch.testing.assert_close(on_gpu, gaussian_field(seeds, 1, 64, 64), rtol=1e-5, atol=1e-5)
