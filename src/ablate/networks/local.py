"""The paper's local generator: few levels, maps at every convolution, noise at every resolution."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import (
    JointConvolution,
    JointTransposedConvolution,
    OneChannelConvolution,
    ResizedConvolution,
    instance_norm,
)
from ablate.networks.spec import GeneratorSpec, Noise, Upsampling, inputs, maps_of_every_level, scaled

# Channels at full, half, quarter ... resolution; deeper levels stay at the last.
WIDTHS = (64, 128, 128, 256, 512)
LEAK = 0.2


class DownBlock(nn.Module):
    """A convolution 3x3 of stride 2 and one of stride 1; both also read the maps."""

    def __init__(self, channels_in: int, channels_out: int, maps: int) -> None:
        super().__init__()
        self.shrink = JointConvolution(channels_in + maps, channels_out, 3, stride=2, padding=1)
        self.refine = JointConvolution(channels_out + maps, channels_out, 3, padding=1)

    def forward(self, features: Tensor, fine_maps: Tensor | None, coarse_maps: Tensor | None) -> Tensor:
        """Halve (N, C, H, W); `fine_maps` has its resolution, `coarse_maps` half of it."""
        features = encoded(self.shrink(features, fine_maps))
        return encoded(self.refine(features, coarse_maps))


class UpBlock(nn.Module):
    """A convolution that enlarges, one of stride 1 (but for `transposed`), the skip connection, and noise."""

    def __init__(self, channels_in: int, channels_out: int, maps: int, spec: GeneratorSpec) -> None:
        super().__init__()
        self.grow: ResizedConvolution | JointTransposedConvolution
        if spec.upsampling is Upsampling.resize:
            self.grow = ResizedConvolution(channels_in + maps, channels_out)
        else:
            kernel, output_padding = (3, 1) if spec.upsampling is Upsampling.texture else (4, 0)
            self.grow = JointTransposedConvolution(channels_in + maps, channels_out, kernel, 2, 1, output_padding)
        has_two = spec.upsampling is not Upsampling.transposed
        self.refine = JointConvolution(channels_out + maps, channels_out, 3, padding=1) if has_two else None
        weight = torch.full((2 * channels_out, 1, 1), float(spec.noise_start))
        self.noise_weight = nn.Parameter(weight) if spec.noise is Noise.inject else None

    def forward(
        self, features: Tensor, skip: Tensor, coarse_maps: Tensor | None, fine_maps: Tensor | None, noise: Tensor | None
    ) -> Tensor:
        """Double the size of (N, C, H, W), append the channels of `skip`, and add `noise` (N, 1, 2H, 2W)."""
        maps = fine_maps if isinstance(self.grow, ResizedConvolution) else coarse_maps
        features = decoded(self.grow(features, maps))
        if self.refine is not None:
            features = decoded(self.refine(features, fine_maps))
        features = torch.cat((features, skip), dim=1)
        if self.noise_weight is None or noise is None:
            return features
        return torch.addcmul(features, noise.to(features.dtype), self.noise_weight.to(features.dtype))


class LocalNetwork(nn.Module):
    """Stem, `depth` down blocks, bottleneck, `depth` up blocks, output convolution."""

    def __init__(self, spec: GeneratorSpec) -> None:
        super().__init__()
        widths = [scaled(WIDTHS[min(level, len(WIDTHS) - 1)], spec.width) for level in range(spec.depth + 1)]
        maps = len(maps_of_every_level(spec))
        self.stem = nn.Conv2d(len(inputs(spec)), widths[0], 3, padding=1)
        self.down = nn.ModuleList(DownBlock(fine, coarse, maps) for fine, coarse in pairwise(widths))
        self.bottleneck = JointConvolution(widths[-1] + maps, widths[-1], 3, padding=1)
        coarse_to_fine = pairwise(reversed(widths))
        self.up = nn.ModuleList(UpBlock(2 * coarse, fine, maps, spec) for coarse, fine in coarse_to_fine)
        self.output = OneChannelConvolution(2 * widths[0] + maps, 3)

    def forward(self, stacked: Tensor, maps: Sequence[Tensor | None], noise: Sequence[Tensor | None]) -> Tensor:
        """Render the input channels, (N, inputs, H, W) with H and W multiples of 2^depth, to (N, 1, H, W) in [-1, 1].

        The convolutions of each level, except the stem, read its maps, depth + 1 of (N, K, H / 2^level, W / 2^level).
        Its noise, depth of (N, 1, H / 2^level, W / 2^level), is injected.
        """
        features = encoded(self.stem(stacked))
        skips = []
        for level, block in enumerate(self.down):
            skips.append(features)
            features = block(features, maps[level], maps[level + 1])
        bottom = encoded(self.bottleneck(features, maps[-1]))
        features = torch.cat((bottom, features), dim=1)
        for level, block in zip(reversed(range(len(skips))), self.up, strict=True):
            features = block(features, skips[level], maps[level + 1], maps[level], noise[level])
        return torch.tanh(self.output(features, maps[0]))


def encoded(features: Tensor) -> Tensor:
    """Apply leaky ReLU, then instance norm."""
    return instance_norm(F.leaky_relu(features, LEAK))


def decoded(features: Tensor) -> Tensor:
    """Apply ReLU, then instance norm."""
    return instance_norm(F.relu(features))
