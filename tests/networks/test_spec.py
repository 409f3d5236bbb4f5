"""The values behind a variant: what is accepted, and what is refused by name."""

import pytest

from ablate.networks import (
    GeneratorSpec,
    conditions,
    discriminator_channels,
    draws_noise,
    input_channels,
    inputs,
    judged,
)
from ablate.networks.spec import fed_channels
from support.variants import UNET


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"noise": "none", "noise_start": 0.3}, "nothing is injected"),
        ({"noise": "input", "extra_input": "noise"}, "one noise channel"),
        ({**UNET, "depth": 1}, "depth=1 with family=unet: allowed are 2 to 8"),
        ({**UNET, "concat": "every_level"}, "allowed is concat=input"),
        ({**UNET, "upsampling": "texture"}, "allowed is upsampling=transposed"),
        ({**UNET, "upsampling": "texture"}, "upsampling=texture with family=unet: allowed is upsampling=transposed"),
        ({**UNET, "noise": "inject"}, "noise=inject with family=unet"),
        ({**UNET, "family": "custom"}, "target=None with family=custom: allowed is the path of a class"),
        ({"noise": "body"}, "noise=body with space=image: .* allowed is space=beam"),
        ({"noise": "body", "space": "beam", "noise_start": 0.1}, "nothing is injected"),
        (
            {**UNET, "family": "custom", "target": "a.B", "fold": "rows"},
            "fold=rows with family=custom: .*is none",
        ),
        ({"target": "a.B"}, r"target=a\.B with family=local: allowed is null"),
    ],
)
def test_what_is_not_a_network_is_refused_by_name(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GeneratorSpec(**changes)


@pytest.mark.parametrize(
    ("changes", "channels", "stochastic"),
    [
        ({}, ("segmentation", "attenuation"), True),
        ({"attenuation": "none"}, ("segmentation",), True),
        ({"attenuation": "compensated"}, ("segmentation", "compensated"), True),
        ({"noise": "input"}, ("segmentation", "attenuation", "noise"), True),
        ({"noise": "none"}, ("segmentation", "attenuation"), False),
        ({"noise": "body", "space": "beam"}, ("segmentation", "attenuation", "grain"), False),
        ({**UNET, "extra_input": "low"}, ("segmentation", "attenuation", "low"), False),
        ({**UNET, "extra_input": "noise"}, ("segmentation", "attenuation", "noise"), True),
    ],
)
def test_inputs_name_the_channels(changes: dict, channels: tuple[str, ...], stochastic: bool) -> None:
    spec = GeneratorSpec(**changes)
    assert inputs(spec) == channels
    assert conditions(spec) == tuple(name for name in channels if name != "noise")
    assert draws_noise(spec) is stochastic


@pytest.mark.parametrize("concat", ["every_level", "input"])
def test_every_convolution_reads_the_grain_and_the_discriminator_does_not(concat: str) -> None:
    """As injected noise, it does not depend on whether the maps of the anatomy are fed at every level."""
    spec = GeneratorSpec(noise="body", space="beam", concat=concat, position="beam")
    anatomy = 3 + len(("attenuation", "depth", "lateral"))
    fed = fed_channels(spec, labels=3)
    assert (fed.start, fed.stop) == ((0 if concat == "every_level" else anatomy), anatomy + 4)
    assert input_channels(spec, labels=3) == anatomy + 4
    assert judged(spec) == ("segmentation", "attenuation", "depth", "lateral")
    assert discriminator_channels(spec, labels=3) == anatomy + 1
