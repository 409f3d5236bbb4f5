"""The U-Net of pix2pix (Isola et al., CVPR 2017), the network of LSA2H and NSA2H."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import JointTransposedConvolution, Stages, convolutions, instance_norm
from ablate.networks.spec import GeneratorSpec, inputs, scaled

# Channels after each down-sampling; deeper levels have as many as the last.
WIDTHS = (64, 128, 256, 512)
LEAK = 0.2


class UNetwork(nn.Module):
    """`depth` convolutions 4x4 of stride 2, as many transposed ones, and skip connections between them.

    With depth 8 this is the U-Net-256 of pix2pix, with the same order of convolution, instance norm and activation and
    a bias in every convolution. It has no dropout, because the paper mentions none and a rendering must be repeatable.
    """

    def __init__(self, spec: GeneratorSpec) -> None:
        super().__init__()
        widths = [scaled(WIDTHS[min(level, len(WIDTHS) - 1)], spec.width) for level in range(spec.depth)]
        self.down = nn.ModuleList(
            nn.Conv2d(channels, width, 4, stride=2, padding=1)
            for channels, width in zip((len(inputs(spec)), *widths), widths, strict=False)
        )
        self.up = nn.ModuleList()
        channels = widths[-1]
        for width in (*reversed(widths[:-1]), 1):
            self.up.append(JointTransposedConvolution(channels, width, 4, stride=2, padding=1))
            channels = 2 * width

    def forward(self, stacked: Tensor, _maps: Sequence[Tensor | None], _noise: Sequence[Tensor | None]) -> Tensor:
        """Render (N, inputs, H, W) in [-1, 1] to (N, 1, H, W); H and W are multiples of 2^depth."""
        features = self.down[0](stacked)
        skips = []
        for layer in self.down[1:-1]:
            skips.append(features)
            features = instance_norm(layer(F.leaky_relu(features, LEAK)))
        skips.append(features)
        features = self.down[-1](F.leaky_relu(features, LEAK))
        features = instance_norm(self.up[0](F.relu(features)))
        for layer in self.up[1:-1]:
            features = instance_norm(layer(F.relu(torch.cat((skips.pop(), features), dim=1))))
        return torch.tanh(self.up[-1](F.relu(torch.cat((skips.pop(), features), dim=1))))

    def stages(self) -> Stages:
        """List the convolutions."""
        down = [convolutions(layer) for layer in self.down]
        up = [convolutions(layer) for layer in reversed(self.up)]
        return Stages(stem=[], down=down, bottleneck=[], up=up, head=[])
