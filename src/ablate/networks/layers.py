"""What the networks share: instance norm, first weights, joining of channels, a list of the layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F

INITIAL_SD = 0.02
Convolution = nn.Conv2d | nn.ConvTranspose2d


@dataclass(frozen=True)
class Stages:
    """The convolutions of a U-shaped network, each list in the order of computation.

    `down[i]` leads from level i (a grid of 2^i px) to level i + 1 and `up[i]` back again; the encoder's
    features of level i join after `up[i]`, and the bottleneck's output joins its input.
    """

    stem: Sequence[Convolution]
    down: Sequence[Sequence[Convolution]]
    bottleneck: Sequence[Convolution]
    up: Sequence[Sequence[Convolution]]
    head: Sequence[Convolution]


def instance_norm(features: Tensor) -> Tensor:
    """Normalise every channel of every sample over its pixels; no parameters.

    Parameters
    ----------
    features : (N, C, H, W) float
        A 1 x 1 map is returned as it is: its deviation is zero, and normalising would erase it.

    Notes
    -----
    Ulyanov et al., "Instance normalization", 2016, with torch's epsilon of 1e-5. Group normalisation with
    one group a channel is the same function; on a CPU torch computes it 2 to 10 times faster.
    """
    if features.shape[-1] * features.shape[-2] == 1:
        return features
    if features.device.type == "cpu":
        return F.group_norm(features, features.shape[1])
    return F.instance_norm(features)


class OneChannelConvolution(nn.Conv2d):
    """Convolution k x k to a single channel, stride 1, size kept: `nn.Conv2d`, computed sensibly on a CPU.

    Torch pads the one output channel to a block of 16. Here a matrix product gives the k^2 taps of every
    pixel, which are then shifted and summed (in float32 if they are bf16): a quarter of the time.
    """

    def __init__(self, in_channels: int, kernel: int) -> None:
        super().__init__(in_channels, 1, kernel, padding=kernel // 2)

    def forward(self, features: Tensor) -> Tensor:
        """Convolve (N, C, H, W) to (N, 1, H, W)."""
        if features.device.type != "cpu" or self.bias is None:
            return super().forward(features)
        (kernel, _), size = self.kernel_size, features.shape[-2:]
        taps = self.weight[0].flip(1, 2).flatten(1).t() @ features.flatten(2)
        taps = taps.float() if taps.dtype is torch.bfloat16 else taps
        return F.fold(taps, size, kernel, padding=kernel // 2) + self.bias[:, None, None]


def draw_initial_weights(network: nn.Module) -> None:
    """Draw every convolution's weights from N(0, 0.02^2) and set its bias to zero, as pix2pix does."""
    for layer in convolutions(network):
        nn.init.normal_(layer.weight, 0.0, INITIAL_SD)
        if layer.bias is not None:
            nn.init.zeros_(layer.bias)


def joined(features: Tensor, maps: Tensor | None) -> Tensor:
    """Append `maps` (N, K, H, W) to the channels of `features` (N, C, H, W), or nothing if None."""
    return features if maps is None else torch.cat((features, maps), dim=1)


def convolutions(network: nn.Module) -> list[Convolution]:
    """List the convolutions of a network in the order in which they were made."""
    return [module for module in network.modules() if isinstance(module, Convolution)]
