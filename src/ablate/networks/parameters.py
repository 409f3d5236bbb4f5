"""Count parameters without allocating any."""

from __future__ import annotations

import torch
from torch import nn

from ablate.networks.discriminator import PatchDiscriminator, discriminator_channels
from ablate.networks.generator import Generator
from ablate.networks.spec import GeneratorSpec


def count_generator(spec: GeneratorSpec) -> int:
    """Count the generator's parameters."""
    with torch.device("meta"):
        return count_parameters(Generator(spec))


def count_discriminator(spec: GeneratorSpec, width: float | None = None) -> int:
    """Count the parameters of this generator's discriminator; `width` is the generator's unless given."""
    with torch.device("meta"):
        network = PatchDiscriminator(discriminator_channels(spec), spec.width if width is None else width)
    return count_parameters(network)


def count_parameters(network: nn.Module) -> int:
    """Count the elements of all parameters of a network."""
    return sum(parameter.numel() for parameter in network.parameters())
