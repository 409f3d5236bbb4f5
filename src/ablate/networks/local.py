"""The paper's local generator: few levels, the maps fed to every convolution, noise at every resolution."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import (
    JointConvolution,
    JointTransposedConvolution,
    OneChannelConvolution,
    Stages,
    convolutions,
    instance_norm,
)
from ablate.networks.spec import Concat, GeneratorSpec, Noise, Upsampling, inputs, scaled

# Channels at full, half, quarter ... resolution; deeper levels stay at the last.
WIDTHS = (64, 128, 128, 256, 512)
LEAK = 0.2


class DownBlock(nn.Module):
    """Convolution 3x3 of stride 2, then one of stride 1, each read together with the maps."""

    def __init__(self, channels_in: int, channels_out: int, maps: int) -> None:
        super().__init__()
        self.shrink = JointConvolution(channels_in + maps, channels_out, 3, stride=2, padding=1)
        self.refine = JointConvolution(channels_out + maps, channels_out, 3, padding=1)

    def forward(self, features: Tensor, fine_maps: Tensor | None, coarse_maps: Tensor | None) -> Tensor:
        """Halve (N, C, H, W); `fine_maps` has its resolution, `coarse_maps` half of it."""
        features = encoded(self.shrink(features, fine_maps))
        return encoded(self.refine(features, coarse_maps))


class UpBlock(nn.Module):
    """Transposed convolution, a stride-1 one if texture-friendly, the skip connection, then noise."""

    def __init__(self, channels_in: int, channels_out: int, maps: int, spec: GeneratorSpec) -> None:
        super().__init__()
        self.refine: JointConvolution | None = None
        if spec.upsampling is Upsampling.texture:
            self.grow = JointTransposedConvolution(
                channels_in + maps, channels_out, 3, stride=2, padding=1, output_padding=1
            )
            self.refine = JointConvolution(channels_out + maps, channels_out, 3, padding=1)
        else:
            self.grow = JointTransposedConvolution(channels_in + maps, channels_out, 4, stride=2, padding=1)
        self.noise_weight: nn.Parameter | None = None
        if spec.noise is Noise.inject:
            start = torch.full((2 * channels_out, 1, 1), float(spec.noise_start))
            self.noise_weight = nn.Parameter(start)

    def forward(
        self,
        features: Tensor,
        skip: Tensor,
        coarse_maps: Tensor | None,
        fine_maps: Tensor | None,
        noise: Tensor | None,
    ) -> Tensor:
        """Double (N, C, H, W), append `skip` of as many channels, add `noise` (N, 1, 2H, 2W) by channel."""
        features = decoded(self.grow(features, coarse_maps))
        if self.refine is not None:
            features = decoded(self.refine(features, fine_maps))
        features = torch.cat((features, skip), dim=1)
        if self.noise_weight is None or noise is None:
            return features
        return torch.addcmul(features, noise.to(features.dtype), self.noise_weight.to(features.dtype))


class LocalNetwork(nn.Module):
    """Stem, `depth` down blocks, bottleneck, `depth` up blocks, output convolution.

    Parameters
    ----------
    spec : GeneratorSpec
        Of the local family.
    """

    def __init__(self, spec: GeneratorSpec) -> None:
        super().__init__()
        widths = [scaled(channels, spec.width) for channels in channels_by_level(spec.depth)]
        maps = 0
        if spec.concat is Concat.every_level:
            maps = sum(name in ("segmentation", "attenuation") for name in inputs(spec))
        self.stem = nn.Conv2d(len(inputs(spec)), widths[0], 3, padding=1)
        self.down = nn.ModuleList(DownBlock(fine, coarse, maps) for fine, coarse in pairwise(widths))
        self.bottleneck = JointConvolution(widths[-1] + maps, widths[-1], 3, padding=1)
        self.up = nn.ModuleList()
        channels = 2 * widths[-1]
        for width in reversed(widths[:-1]):
            self.up.append(UpBlock(channels, width, maps, spec))
            channels = 2 * width
        self.output = OneChannelConvolution(channels + maps, 3)

    def forward(self, stacked: Tensor, maps: Sequence[Tensor | None], noise: Sequence[Tensor | None]) -> Tensor:
        """Render.

        Parameters
        ----------
        stacked : (N, inputs, H, W) float in [-1, 1]
            The input channels; H and W are multiples of 2^depth.
        maps : depth + 1 of (N, K, H / 2^level, W / 2^level) or None
            What is fed to the convolutions of each level after the stem.
        noise : depth of (N, 1, H / 2^level, W / 2^level) or None
            Injected noise of each level.

        Returns
        -------
        (N, 1, H, W) float in [-1, 1]
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

    def stages(self) -> Stages:
        """List the convolutions."""
        return Stages(
            stem=[self.stem],
            down=[convolutions(block) for block in self.down],
            bottleneck=[self.bottleneck],
            up=[convolutions(block) for block in reversed(self.up)],
            head=[self.output],
        )


def channels_by_level(depth: int) -> list[int]:
    """Channels at full resolution and after each of `depth` down blocks, at width 1."""
    return [WIDTHS[min(level, len(WIDTHS) - 1)] for level in range(depth + 1)]


def encoded(features: Tensor) -> Tensor:
    """Apply leaky ReLU, then instance norm."""
    return instance_norm(F.leaky_relu(features, LEAK))


def decoded(features: Tensor) -> Tensor:
    """Apply ReLU, then instance norm."""
    return instance_norm(F.relu(features))
