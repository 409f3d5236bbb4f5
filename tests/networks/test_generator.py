"""Any size in, the same size out; noise from seeds; nothing read that a variant does not use."""

import pytest
import torch
from torch import Tensor
from torch.nn import functional as F

from ablate.networks import Generator, GeneratorSpec, PatchDiscriminator, discriminator_channels, inputs
from ablate.networks.layers import OneChannelConvolution, instance_norm
from support.variants import VARIANTS


def make(seed: int = 0, **changes: object) -> Generator:
    torch.manual_seed(seed)
    defaults: dict = {"depth": 3, "width": 0.1}
    return Generator(GeneratorSpec(**{**defaults, **changes})).eval()


def maps(height: int = 24, width: int = 32, batch: int = 2, seed: int = 0) -> dict[str, Tensor]:
    random = torch.Generator().manual_seed(seed)
    shape = (batch, 1, height, width)
    return {
        "segmentation": torch.rand(shape, generator=random) * 2 - 1,
        "attenuation": torch.rand(shape, generator=random),
        "low": torch.rand(shape, generator=random) * 2 - 1,
        "compensated": torch.rand(shape, generator=random),
        "noise_seed": torch.arange(batch) + seed,
    }


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("size", [(1, 1), (8, 8), (13, 30), (25, 33)])
def test_any_size_comes_back_in_range(variant: str, size: tuple[int, int]) -> None:
    image = make(**VARIANTS[variant])(**maps(*size))
    assert image.shape == (2, 1, *size)
    assert image.isfinite().all()
    assert image.abs().max() <= 1


@pytest.mark.parametrize(
    ("size", "changes"),
    [((2048, 2047), {}), ((1, 2048), {"depth": 8}), ((1999, 3), {"depth": 8}), ((2047, 65), VARIANTS["concat"])],
)
def test_large_and_odd_sizes_come_back(size: tuple[int, int], changes: dict) -> None:
    given = maps(*size, batch=1)
    with torch.inference_mode():
        image = make(**{"width": 0.02, **changes})(**given)
    assert image.shape == (1, 1, *size)
    assert image.isfinite().all()


def test_at_depth_8_a_crop_of_256_ends_in_one_pixel_that_is_not_normalised() -> None:
    generator, given = make(depth=8), maps(256, 256, batch=1)
    seen: list[tuple[Tensor, Tensor]] = []
    generator.network.bottleneck.register_forward_hook(lambda _, args, output: seen.append((args[0], output)))
    grown: list[Tensor] = []
    generator.network.up[0].register_forward_pre_hook(lambda _, args: grown.append(args[0]))
    generator(**given)
    (features, raw), (joined,) = seen[0], grown
    assert raw.shape[-2:] == (1, 1)
    # Normalising one pixel would leave zero: the activation is passed on as it is.
    torch.testing.assert_close(joined, torch.cat((F.leaky_relu(raw, 0.2), features), 1), rtol=0, atol=0)
    assert joined.abs().min() > 0


@pytest.mark.parametrize("variant", VARIANTS)
def test_every_parameter_is_used(variant: str) -> None:
    generator = make(**VARIANTS[variant])
    generator(**maps()).square().mean().backward()
    unused = [name for name, p in generator.named_parameters() if p.grad is None or not p.grad.any()]
    # A bias before instance norm without a non-linearity between them cancels: pix2pix has them too.
    assert not [name for name in unused if generator.spec.family == "local" or not name.endswith("bias")]


@pytest.mark.parametrize("variant", VARIANTS)
def test_exactly_the_named_maps_are_read(variant: str) -> None:
    generator = make(**VARIANTS[variant])
    given = maps()
    reference = generator(**given)
    for name in ("segmentation", "attenuation", "compensated", "low"):
        changed = generator(**{**given, name: given[name].flip(-1)})
        assert torch.equal(changed, reference) is (name not in inputs(generator.spec))


@pytest.mark.parametrize("variant", ["sa2h", "compensated", "lsa2h"])
def test_padding_is_a_larger_frame_with_nothing_beside_the_fan(variant: str) -> None:
    generator = make(**VARIANTS[variant], **({} if variant == "lsa2h" else {"noise_start": 0.5}))
    given = maps(21, 30)
    padded = {
        name: F.pad(value, (0, 2, 0, 3), value=0.0 if name in ("attenuation", "compensated") else -1.0)
        for name, value in given.items()
        if name != "noise_seed"
    }
    whole = generator(**padded, noise_seed=given["noise_seed"])
    assert torch.equal(generator(**given), whole[..., :21, :30])


def test_the_compensated_map_takes_the_place_of_the_integral_one() -> None:
    """The same weights on the same numbers give the same image, whichever scale they are said to have."""
    for changes in ({"noise_start": 0.5}, VARIANTS["lsa2h"]):
        given = maps()
        swapped = {**given, "attenuation": given["compensated"], "compensated": given["attenuation"]}
        assert torch.equal(make(**changes)(**swapped), make(**changes, attenuation="compensated")(**given))


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
    from ablate.networks import gaussian_field

    generator, given = make(depth=2), maps()
    block = generator.network.up[1]
    with torch.no_grad():
        block.noise_weight.copy_(torch.linspace(-1, 1, block.noise_weight.numel())[:, None, None])
    seen: list[Tensor] = []
    generator.network.output.register_forward_pre_hook(lambda _, args: seen.append(args[0]))
    generator(**given)
    generator(**{**given, "noise_seed": None})
    difference = seen[0] - seen[1]
    expected = block.noise_weight * gaussian_field(given["noise_seed"], 0, 24, 32)
    torch.testing.assert_close(difference, expected, rtol=0, atol=1e-5)


def test_what_noise_adds_has_the_weights_standard_deviation() -> None:
    generator = make(depth=2)
    block = generator.network.up[1]
    channels = block.noise_weight.numel()
    weights = torch.linspace(-1, 1, channels)
    with torch.no_grad():
        block.noise_weight.copy_(weights[:, None, None])
    field = generator.draw_noise(torch.tensor([4]), 512, 512)["noise_0"]
    with torch.no_grad():
        coarse = torch.zeros(1, block.grow.in_channels - 2, 256, 256)
        pyramid = [torch.zeros(1, 2, size, size) for size in (256, 512)]
        skip = torch.zeros(1, channels // 2, 512, 512)
        added = block(coarse, skip, *pyramid, field) - block(coarse, skip, *pyramid, None)
    torch.testing.assert_close(added.std((0, 2, 3)), weights.abs(), rtol=4 / (2 * 512**2) ** 0.5, atol=1e-6)
    torch.testing.assert_close(added.mean((0, 2, 3)), torch.zeros(channels), rtol=0, atol=4 / 512)


def test_maps_are_fed_to_each_level_as_torch_resizes_them() -> None:
    generator, given = make(), maps(16, 24)
    seen: dict[int, Tensor] = {}
    for layer in (generator.network.bottleneck, generator.network.output):
        layer.register_forward_pre_hook(lambda _, args: seen.update({args[1].shape[-1]: args[1]}))
    generator(**given)
    size = (2, 3)
    assert torch.equal(seen[3][:, :1], F.interpolate(given["segmentation"], size, mode="nearest"))
    assert torch.equal(seen[3][:, 1:], F.interpolate(given["attenuation"], size, mode="bilinear"))
    assert torch.equal(seen[24], torch.cat((given["segmentation"], given["attenuation"]), 1))


@pytest.mark.parametrize("variant", VARIANTS)
def test_bf16_stays_in_bf16_and_close(variant: str) -> None:
    generator, given = make(**VARIANTS[variant]), maps()
    dtypes = set()
    for layer in generator.modules():
        if not list(layer.children()):
            layer.register_forward_pre_hook(lambda _, args: dtypes.add(args[0].dtype))
    reference = generator(**given)
    dtypes.clear()
    with torch.autocast("cpu", torch.bfloat16):
        image = generator(**given)
    assert dtypes == {torch.bfloat16}
    assert (image.float() - reference).abs().mean() < 0.05


def test_noise_magnitude_is_the_mean_weight() -> None:
    assert float(make(noise_start=-0.3).noise_magnitude()) == pytest.approx(0.3)  # type: ignore[arg-type]
    assert make(noise="none").noise_magnitude() is None


@pytest.mark.parametrize("shape", [(2, 3, 5, 7), (1, 1, 1, 2), (2, 2, 64, 1)])
def test_instance_norm_is_torchs(shape: tuple[int, ...]) -> None:
    features = torch.randn(shape) * 3 + 5
    torch.testing.assert_close(instance_norm(features), F.instance_norm(features), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("size", "error"), [(256, 2e-4), (512, 5e-6)])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
def test_sums_over_large_maps_are_not_rounded_off(size: int, error: float, layout: torch.memory_format) -> None:
    features = torch.rand(1, 16, size, size, generator=torch.Generator().manual_seed(0)).to(memory_format=layout)
    exact = F.instance_norm(features.double())
    assert (instance_norm(features) - exact).abs().max() < error


@pytest.mark.parametrize("size", [(9, 7), (1, 1), (1, 5)])
def test_the_output_convolution_is_torchs(size: tuple[int, int]) -> None:
    layer = OneChannelConvolution(5, 3).double()
    features = torch.randn(2, 5, *size, dtype=torch.float64, requires_grad=True)
    expected = F.conv2d(features, layer.weight, layer.bias, padding=1)
    torch.testing.assert_close(layer(features), expected, rtol=1e-12, atol=1e-12)
    wanted = (features, layer.weight, layer.bias)
    gradients = [torch.autograd.grad(y.square().sum(), wanted) for y in (layer(features), expected)]
    torch.testing.assert_close(*gradients, rtol=1e-10, atol=1e-10)


def test_initial_weights_are_pix2pixs() -> None:
    layer = make(width=1).network.stages().down[1][1]
    assert float(layer.weight.detach().std()) == pytest.approx(0.02, rel=0.02)
    assert not layer.bias.any()  # type: ignore[union-attr]


def test_discriminator_has_one_logit_a_patch_and_refuses_smaller_images() -> None:
    spec = GeneratorSpec(extra_input="low")  # type: ignore[arg-type]
    discriminator = PatchDiscriminator(discriminator_channels(spec), width=0.1)
    conditions = torch.zeros(1, 3, 256, 256)
    assert discriminator(conditions, conditions[:, :1]).shape == (1, 1, 30, 30)
    small = conditions[..., :32, :32]
    assert discriminator(small, small[:, :1]).shape == (1, 1, 2, 2)
    with pytest.raises(ValueError, match="image: 31 x 32 pixels, allowed are 32 x 32 and more"):
        discriminator(small[..., :31, :], small[:, :1, :31])
