"""The conditional PatchGAN of pix2pix: each output judges one 70 x 70 patch."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import draw_initial_weights, instance_norm, laid_out
from ablate.networks.spec import GeneratorSpec, conditions, scaled

LEAK = 0.2
SMALLEST_IMAGE = 32


class PatchDiscriminator(nn.Module):
    """Three strided 4x4 convolutions and two of stride 1, in the order convolution, norm, leaky ReLU.

    Parameters
    ----------
    in_channels : int
        Conditions and image together: `discriminator_channels(spec)`.
    width : float
        Multiplier of the channel counts 64, 128, 256, 512.

    Notes
    -----
    Isola et al., "Image-to-image translation with conditional adversarial networks", CVPR 2017.
    """

    def __init__(self, in_channels: int, width: float = 1.0) -> None:
        super().__init__()
        widths = [scaled(channels, width) for channels in (64, 128, 256, 512)]
        self.first = nn.Conv2d(in_channels, widths[0], 4, stride=2, padding=1)
        self.inner = nn.ModuleList(
            (
                nn.Conv2d(widths[0], widths[1], 4, stride=2, padding=1),
                nn.Conv2d(widths[1], widths[2], 4, stride=2, padding=1),
                nn.Conv2d(widths[2], widths[3], 4, stride=1, padding=1),
            )
        )
        self.last = nn.Conv2d(widths[3], 1, 4, stride=1, padding=1)
        draw_initial_weights(self)

    def forward(self, maps: Tensor, image: Tensor) -> Tensor:
        """Judge patches.

        Parameters
        ----------
        maps : (N, C, H, W) float
            The conditions.
        image : (N, 1, H, W) float
            True or generated, black outside the fan; at least 32 x 32 pixels.

        Returns
        -------
        (N, 1, H / 8 - 2, W / 8 - 2) float
            Logits, positive for true.

        Raises
        ------
        ValueError
            Where the image is too small to hold a patch's centre.
        """
        if min(image.shape[-2:]) < SMALLEST_IMAGE:
            raise ValueError(
                f"image: {image.shape[-2]} x {image.shape[-1]} pixels, "
                f"allowed are {SMALLEST_IMAGE} x {SMALLEST_IMAGE} and more"
            )
        stacked = laid_out(torch.cat((maps, image.to(maps.dtype)), dim=1))
        features = F.leaky_relu(self.first(stacked), LEAK)
        for layer in self.inner:
            features = F.leaky_relu(instance_norm(layer(features)), LEAK)
        logits: Tensor = self.last(features)
        return logits


def discriminator_channels(spec: GeneratorSpec) -> int:
    """Count the channels that the discriminator of this generator reads: conditions and image."""
    return len(conditions(spec)) + 1
