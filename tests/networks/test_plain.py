"""Every variant against the same network written plainly, in value and gradient, in double precision."""

import pytest
import torch

from ablate.networks import Family, Generator, GeneratorSpec, PatchDiscriminator, conditions, discriminator_channels
from support.plain_gan import PlainDiscriminator, PlainLocal, PlainUNet

UNET = {"family": "unet", "concat": "input", "upsampling": "transposed", "noise": "none"}
VARIANTS = {
    "sa2h": {},
    "att": {"attenuation": "none"},
    "compensated": {"attenuation": "compensated"},
    "concat": {"concat": "input"},
    "conv": {"upsampling": "transposed"},
    "resize": {"upsampling": "resize"},
    "resize without maps": {"upsampling": "resize", "concat": "input"},
    "depth": {"depth": 5},
    "low": {"extra_input": "low"},
    "unet": UNET,
    "lsa2h": {**UNET, "extra_input": "low"},
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_networks_are_those_written_plainly(variant: str) -> None:
    """Without noise, which the plain ones draw from torch's generator."""
    options: dict = {"width": 0.06, "depth": 3, "noise": "none", **VARIANTS[variant]}
    spec = GeneratorSpec(**options)
    torch.manual_seed(0)
    generator, judge = Generator(spec).double(), PatchDiscriminator(discriminator_channels(spec), spec.width).double()
    for parameter in (*generator.parameters(), *judge.parameters()):
        torch.nn.init.normal_(parameter, 0.0, 0.1)  # biases as well
    plain = (PlainUNet if spec.family is Family.unet else PlainLocal)(spec).double()
    plain.load_state_dict(generator.network.state_dict())
    plain_judge = PlainDiscriminator(discriminator_channels(spec), spec.width).double()
    plain_judge.load_state_dict(judge.state_dict())
    given = {name: torch.rand(2, 1, 64, 96, dtype=torch.float64) for name in conditions(spec)}
    stacked = torch.cat(list(given.values()), 1)
    ours, theirs = generator(**given), plain(stacked)
    torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9)
    logits, plain_logits = judge(stacked, ours), plain_judge(stacked, theirs)
    torch.testing.assert_close(logits, plain_logits, rtol=1e-8, atol=1e-8)
    logits.square().mean().backward()
    plain_logits.square().mean().backward()
    for network, other in ((generator.network, plain), (judge, plain_judge)):
        expected = {name: parameter.grad for name, parameter in other.named_parameters()}
        assert len(expected) == len(list(network.parameters()))
        for name, parameter in network.named_parameters():
            torch.testing.assert_close(parameter.grad, expected[name], rtol=1e-7, atol=1e-9)
