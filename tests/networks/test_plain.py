"""Every variant against the same network written plainly, in value and gradient, in double precision."""

import pytest
import torch

from ablate.networks import Family, Generator, GeneratorSpec, PatchDiscriminator, conditions, discriminator_channels
from support.plain_gan import PlainDiscriminator, PlainLocal, PlainUNet
from support.variants import LABELS, UNET, VARIANTS, random_maps

# Without noise, which the plain networks draw from torch's generator; folded rows have an oracle in test_generator.py.
_LEFT_OUT = ("noise", "nsa2h", "body", "folded")
NOISELESS = {name: changes for name, changes in VARIANTS.items() if not any(word in name for word in _LEFT_OUT)}
NOISELESS |= {"unet": UNET, "depth": {"depth": 5}}


QUIET = {"noise": "none", "noise_start": 0.0}


@pytest.mark.parametrize("variant", NOISELESS)
def test_networks_are_those_written_plainly(variant: str) -> None:
    spec = GeneratorSpec(**{"width": 0.06, "depth": 3, **NOISELESS[variant], **QUIET})  # type: ignore[arg-type]
    labels = LABELS.get(variant, 1)
    torch.manual_seed(0)
    generator = Generator(spec, labels).double()
    judge = PatchDiscriminator(discriminator_channels(spec, labels), spec.width).double()
    for parameter in (*generator.parameters(), *judge.parameters()):
        torch.nn.init.normal_(parameter, 0.0, 0.1)  # biases as well
    plain = (PlainUNet if spec.family is Family.unet else PlainLocal)(spec, labels).double()
    plain.load_state_dict({name.removeprefix("network."): value for name, value in generator.state_dict().items()})
    plain_judge = PlainDiscriminator(discriminator_channels(spec, labels), spec.width).double()
    plain_judge.load_state_dict(judge.state_dict())
    given = {name: random_maps(labels, 2, 64, 96)[name].double() for name in conditions(spec)}
    stacked = torch.cat(list(given.values()), 1)
    ours, theirs = generator(**given), plain(stacked)
    torch.testing.assert_close(ours, theirs, rtol=1e-9, atol=1e-9)
    logits, plain_logits = judge(stacked, ours), plain_judge(stacked, theirs)
    torch.testing.assert_close(logits, plain_logits, rtol=1e-8, atol=1e-8)
    logits.square().mean().backward()
    plain_logits.square().mean().backward()
    for network, other in ((generator, plain), (judge, plain_judge)):
        expected = {name: parameter.grad for name, parameter in other.named_parameters()}
        assert len(expected) == len(list(network.parameters()))
        for name, parameter in network.named_parameters():
            torch.testing.assert_close(parameter.grad, expected[name.removeprefix("network.")], rtol=1e-7, atol=1e-9)
