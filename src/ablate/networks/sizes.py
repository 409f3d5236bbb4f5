"""Sizes of a network that need no memory for it: its parameters."""

import torch
from torch import nn

from ablate.networks.families import PatchDiscriminator, discriminator_channels
from ablate.networks.generator import Generator
from ablate.networks.spec import GeneratorSpec


def count_generator(spec: GeneratorSpec, labels: int = 1) -> int:
    """Count the parameters of the generator that reads `labels` channels of segmentation."""
    with torch.device("cpu" if spec.target else "meta"):  # a user's class may read numbers as it is made
        return count_parameters(Generator(spec, labels))


def count_discriminator(spec: GeneratorSpec, width: float | None = None, labels: int = 1) -> int:
    """Count the parameters of this generator's discriminator; `width` is the generator's unless given."""
    channels = discriminator_channels(spec, labels)
    with torch.device("meta"):
        return count_parameters(PatchDiscriminator(channels, width or spec.width))


def count_parameters(network: nn.Module) -> int:
    """Count the elements of all parameters of a network."""
    return sum(parameter.numel() for parameter in network.parameters())
