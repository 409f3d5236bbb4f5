"""Sizes of a network that need no memory for it: parameters, and the input region that an output pixel depends on."""

import torch
from torch import nn

from ablate.networks.families import LocalNetwork, PatchDiscriminator, UNetwork, discriminator_channels
from ablate.networks.generator import Generator
from ablate.networks.layers import Convolution, convolutions
from ablate.networks.spec import GeneratorSpec, fed_channels

Interval = tuple[int, int]


def count_generator(spec: GeneratorSpec) -> int:
    """Count the generator's parameters."""
    with torch.device("cpu" if spec.target else "meta"):  # a user's class may read numbers as it is made
        return count_parameters(Generator(spec))


def count_discriminator(spec: GeneratorSpec, width: float | None = None) -> int:
    """Count the parameters of this generator's discriminator; `width` is the generator's unless given."""
    with torch.device("meta"):
        return count_parameters(PatchDiscriminator(discriminator_channels(spec), width or spec.width))


def count_parameters(network: nn.Module) -> int:
    """Count the elements of all parameters of a network."""
    return sum(parameter.numel() for parameter in network.parameters())


def receptive_field(spec: GeneratorSpec) -> int | None:
    """Compute the side of the generator's receptive field, px; None for a custom network, whose layers are not known.

    Intervals of pixels are followed from the output back to the input, through every skip connection and every resized
    map. The result depends by a few pixels on the position relative to the strides; the largest is returned. The
    statistics of instance norm, which are global, and the border of the image are not counted.
    """
    if spec.target:
        return None
    with torch.device("meta"):
        network = Generator(spec).network
    assert isinstance(network, LocalNetwork | UNetwork)
    period = 2**spec.depth
    fed = fed_channels(spec)
    has_means = fed > 1  # else the order of the labels alone, of which one pixel is taken
    extents = (_pixels_reached(network, period * 64 + phase, fed > 0, has_means) for phase in range(period))
    return max(last - first + 1 for first, last in extents)


def patch_size(discriminator: PatchDiscriminator) -> int:
    """Compute the side of the patch that one output of the discriminator depends on, px."""
    interval = (1 << 10, 1 << 10)
    for layer in reversed(convolutions(discriminator)):
        interval = _inputs_of(layer, interval)
    return interval[1] - interval[0] + 1


def _pixels_reached(network: LocalNetwork | UNetwork, pixel: int, feeds_maps: bool, has_means: bool) -> Interval:
    """Follow one output pixel back to the interval of input pixels it depends on."""
    reached: list[Interval] = []

    def through(block: nn.Module, interval: Interval, level: int) -> Interval:
        for layer in reversed(convolutions(block)):
            interval = _inputs_of(layer, interval)
            if layer.stride[0] == 2:
                level += 1 if isinstance(layer, nn.ConvTranspose2d) else -1
            if feeds_maps:  # a position of the map of this level was resized from these pixels
                step = 2**level
                reached.append((interval[0] * step, interval[1] * step + (step - 1) * has_means))
        return interval

    names = ("stem", "bottleneck", "grain", "output")  # the U-Net has none of them
    stem, bottleneck, grain, output = (getattr(network, name, None) or nn.Identity() for name in names)
    decoder = [through(grain, through(output, (pixel, pixel), 0), 0)]
    for level, block in enumerate(reversed(network.up)):
        decoder.append(through(block, decoder[level], level))
    encoder = _union(decoder[-1], through(bottleneck, decoder[-1], len(network.down)))
    for level, block in reversed(list(enumerate(network.down))):
        encoder = _union(decoder[level], through(block, encoder, level + 1))
    return _union(through(stem, encoder, 0), *reached)


def _inputs_of(layer: Convolution, outputs: Interval) -> Interval:
    """Find the input positions that a convolution reads for these output positions."""
    kernel, stride, padding = layer.kernel_size[0], layer.stride[0], int(layer.padding[0])
    if isinstance(layer, nn.ConvTranspose2d):
        # Output o takes input i where o = i * stride - padding + tap, for tap in 0 to kernel - 1.
        return -((kernel - 1 - padding - outputs[0]) // stride), (outputs[1] + padding) // stride
    return outputs[0] * stride - padding, outputs[1] * stride - padding + kernel - 1


def _union(*intervals: Interval) -> Interval:
    return min(first for first, _ in intervals), max(last for _, last in intervals)
