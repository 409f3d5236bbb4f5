"""The parameter counts of the paper's Table II, to the parameter."""

import pytest

from ablate.networks import Generator, GeneratorSpec, count_discriminator, count_generator, count_parameters
from ablate.networks.layers import convolutions
from support.variants import UNET

# Both networks together; the paper prints them in millions, to one digit.
TABLE = {
    "sa2h": ({}, 14_450_964, 14.5),
    "sa2h-att": ({"attenuation": "none"}, 14_415_947, 14.4),
    "sa2h-compensated": ({"attenuation": "compensated"}, 14_450_964, 14.5),  # not of the paper: the cost of its SA2H
    "sa2h-concat": ({"concat": "input"}, 14_384_130, 14.4),
    "sa2h-conv": ({"upsampling": "transposed"}, 16_164_308, 16.2),
    "sa2h-noise": ({"noise": "input"}, 14_450_388, 14.5),
    "no noise": ({"noise": "none"}, 14_449_812, 14.4),  # nor this: without the 64 x 9 weights of its channel
    "lsa2h": ({**UNET, "depth": 8, "extra_input": "low"}, 57_171_266, 57.2),
    "nsa2h": ({**UNET, "depth": 8, "extra_input": "noise"}, 57_170_242, 57.2),
}


@pytest.mark.parametrize("variant", TABLE)
def test_both_networks_together_have_the_papers_count(variant: str) -> None:
    changes, total, millions = TABLE[variant]
    spec = GeneratorSpec(**changes)
    assert count_generator(spec) + count_discriminator(spec) == total
    assert round(total / 1e6, 1) == millions


def test_counting_on_the_meta_device_counts_the_real_network() -> None:
    spec = GeneratorSpec(width=0.1, depth=3)
    assert count_generator(spec) == count_parameters(Generator(spec))


def test_a_refined_grain_costs_its_convolution_and_every_map_alike() -> None:
    whole, read = count_generator(GeneratorSpec()), 2 * 64 + 2
    narrower_output = 64 * 9
    refined = count_generator(GeneratorSpec(grain="refine"))  # type: ignore[arg-type]
    assert refined == whole + (read * 9 + 1) * 64 - narrower_output
    one_map = whole - count_generator(GeneratorSpec(attenuation="none"))  # type: ignore[arg-type]
    for changes, maps in (({"interfaces": "echo"}, 1), ({"position": "beam"}, 2)):
        assert count_generator(GeneratorSpec(**changes)) == whole + maps * one_map  # type: ignore[arg-type]
    assert count_generator(GeneratorSpec(), labels=3) == whole + 2 * one_map


def test_a_discriminator_reads_every_channel_of_the_labels() -> None:
    taps_of_a_channel = 64 * 4 * 4
    assert (
        count_discriminator(GeneratorSpec(), labels=3) - count_discriminator(GeneratorSpec()) == 2 * taps_of_a_channel
    )


def test_the_narrowest_network_keeps_four_channels() -> None:
    generator = Generator(GeneratorSpec(width=1e-6))
    assert {layer.out_channels for layer in convolutions(generator.network.down)} == {4}


def test_the_discriminator_follows_the_generators_width_unless_told() -> None:
    narrow = GeneratorSpec(width=0.25)
    assert count_discriminator(narrow) == count_discriminator(GeneratorSpec(), width=0.25)
    assert count_discriminator(narrow, width=1.0) == 2_764_737
