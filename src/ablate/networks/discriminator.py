"""The conditional PatchGAN of pix2pix: each output scores one patch of 70 x 70 pixels."""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import draw_initial_weights, instance_norm, laid_out
from ablate.networks.spec import GeneratorSpec, conditions, scaled

LEAK = 0.2
SMALLEST = 32


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
        widths = [scaled(channels, width) for channels in (64, 128, 256, 512)]
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
        logits: Tensor = self.last(features)
        return logits


def discriminator_channels(spec: GeneratorSpec) -> int:
    """Count the input channels of this generator's discriminator: conditions and image."""
    return len(conditions(spec)) + 1
