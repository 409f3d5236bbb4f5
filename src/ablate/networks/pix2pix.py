"""The networks of pix2pix (Isola et al., CVPR 2017): the U-Net, which LSA2H and NSA2H are, and the PatchGAN."""

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import JointTransposedConvolution, draw_initial_weights, instance_norm, laid_out
from ablate.networks.spec import GeneratorSpec, conditions, inputs, scaled

# Channels after each down-sampling; deeper levels of the U-Net have as many as the last.
WIDTHS = (64, 128, 256, 512)
LEAK = 0.2
SMALLEST = 32


class UNetwork(nn.Module):
    """`depth` convolutions 4x4 of stride 2, as many transposed ones, and skip connections between them.

    With depth 8 this is the U-Net-256 of pix2pix, with the same order of convolution, instance norm and activation and
    a bias in every convolution. It has no dropout, because the paper mentions none and a rendering must be repeatable.
    """

    def __init__(self, spec: GeneratorSpec) -> None:
        super().__init__()
        widths = [scaled(WIDTHS[min(level, len(WIDTHS) - 1)], spec.width) for level in range(spec.depth)]
        shrink = pairwise((len(inputs(spec)), *widths))
        self.down = nn.ModuleList(nn.Conv2d(a, b, 4, stride=2, padding=1) for a, b in shrink)
        out = (*reversed(widths[:-1]), 1)
        grow = zip((widths[-1], *(2 * width for width in out)), out, strict=False)
        self.up = nn.ModuleList(JointTransposedConvolution(a, b, 4, stride=2, padding=1) for a, b in grow)

    def forward(self, stacked: Tensor, _maps: Sequence[Tensor | None], _noise: Sequence[Tensor | None]) -> Tensor:
        """Render (N, inputs, H, W) in [-1, 1] to (N, 1, H, W); H and W are multiples of 2^depth."""
        skips = [self.down[0](stacked)]
        for layer in self.down[1:-1]:
            skips.append(instance_norm(layer(F.leaky_relu(skips[-1], LEAK))))
        features = self.down[-1](F.leaky_relu(skips[-1], LEAK))
        features = instance_norm(self.up[0](F.relu(features)))
        for layer in self.up[1:-1]:
            features = instance_norm(layer(F.relu(torch.cat((skips.pop(), features), dim=1))))
        return torch.tanh(self.up[-1](F.relu(torch.cat((skips.pop(), features), dim=1))))


class PatchDiscriminator(nn.Module):
    """Three 4x4 convolutions of stride 2 and two of stride 1, each followed by instance norm and leaky ReLU.

    The first has no norm, and the last has neither.

    Parameters
    ----------
    in_channels : int
        Conditions and image together: `discriminator_channels(spec)`.
    width : float
        Multiplier of the channel counts 64, 128, 256, 512.

    Notes
    -----
    Isola et al., "Image-to-image translation with conditional adversarial networks", CVPR 2017.

    Examples
    --------
    >>> spec = GeneratorSpec()
    >>> discriminator = PatchDiscriminator(discriminator_channels(spec), width=0.1)
    >>> discriminator(torch.zeros(1, 2, 256, 256), torch.zeros(1, 1, 256, 256)).shape
    torch.Size([1, 1, 30, 30])
    """

    def __init__(self, in_channels: int, width: float = 1.0) -> None:
        super().__init__()
        widths = [scaled(channels, width) for channels in WIDTHS]
        self.first = nn.Conv2d(in_channels, widths[0], 4, stride=2, padding=1)
        self.inner = nn.ModuleList(
            nn.Conv2d(fine, coarse, 4, stride, padding=1)
            for (fine, coarse), stride in zip(pairwise(widths), (2, 2, 1), strict=True)
        )
        self.last = nn.Conv2d(widths[3], 1, 4, stride=1, padding=1)
        draw_initial_weights(self)

    def forward(self, maps: Tensor, image: Tensor) -> Tensor:
        """Score patches.

        Parameters
        ----------
        maps : (N, C, H, W) float
            The conditions.
        image : (N, 1, H, W) float
            Real or generated, black outside the fan.

        Returns
        -------
        (N, 1, H / 8 - 2, W / 8 - 2) float
            Logits, positive for real.

        Raises
        ------
        ValueError
            If the image is smaller than 32 x 32 pixels.
        """
        height, width = image.shape[-2:]
        if min(height, width) < SMALLEST:
            raise ValueError(f"image: {height} x {width} pixels, allowed are {SMALLEST} x {SMALLEST} and more")
        stacked = laid_out(torch.cat((maps, image.to(maps.dtype)), dim=1))
        features = F.leaky_relu(self.first(stacked), LEAK)
        for layer in self.inner:
            features = F.leaky_relu(instance_norm(layer(features)), LEAK)
        return cast(Tensor, self.last(features))


def discriminator_channels(spec: GeneratorSpec) -> int:
    """Count the input channels of this generator's discriminator: conditions and image."""
    return len(conditions(spec)) + 1
