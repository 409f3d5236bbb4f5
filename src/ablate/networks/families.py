"""The networks of the families: the paper's local one, and those of pix2pix (Isola et al., CVPR 2017).

The local network has few levels, maps at every convolution and noise at every resolution. Of pix2pix come the U-Net,
which LSA2H and NSA2H are, and the PatchGAN.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.layers import (
    JointConvolution,
    JointTransposedConvolution,
    draw_initial_weights,
    instance_norm,
    laid_out,
)
from ablate.networks.spec import (
    GeneratorSpec,
    Grain,
    Noise,
    Upsampling,
    fed_channels,
    input_channels,
    judged,
    map_channels,
    rows_of_a_cell,
    scaled,
)

# Channels at full, half, quarter ... resolution; deeper levels stay at the last.
LOCAL_WIDTHS = (64, 128, 128, 256, 512)
# Channels after each down-sampling; deeper levels of the U-Net have as many as the last.
UNET_WIDTHS = (64, 128, 256, 512)
LEAK = 0.2


class DownBlock(nn.Module):
    """A convolution 3x3 of stride 2 and one of stride 1; both also read the maps."""

    def __init__(self, channels_in: int, channels_out: int, maps: int) -> None:
        super().__init__()
        self.shrink = JointConvolution(channels_in + maps, channels_out, 3, stride=2, padding=1)
        self.refine = JointConvolution(channels_out + maps, channels_out, 3, padding=1)

    def forward(self, features: Tensor, fine_maps: Tensor | None, coarse_maps: Tensor | None) -> Tensor:
        """Halve (N, C, H, W); `fine_maps` has its resolution, `coarse_maps` half of it."""
        features = instance_norm(F.leaky_relu(self.shrink(features, fine_maps), LEAK))
        return instance_norm(F.leaky_relu(self.refine(features, coarse_maps), LEAK))


class UpBlock(nn.Module):
    """A convolution that enlarges, one of stride 1 (but for `transposed`), the skip connection, and noise."""

    def __init__(self, channels_in: int, channels_out: int, maps: int, spec: GeneratorSpec) -> None:
        super().__init__()
        self.refine: JointConvolution | None
        if spec.upsampling is Upsampling.texture:
            self.grow = JointTransposedConvolution(
                channels_in + maps, channels_out, 3, stride=2, padding=1, output_padding=1
            )
            self.refine = JointConvolution(channels_out + maps, channels_out, 3, padding=1)
        else:
            self.grow = JointTransposedConvolution(channels_in + maps, channels_out, 4, stride=2, padding=1)
            self.refine = None
        weight = torch.full((2 * channels_out, 1, 1), float(spec.noise_start))
        self.noise_weight = nn.Parameter(weight) if spec.noise is Noise.inject else None

    def forward(
        self,
        features: Sequence[Tensor],
        skip: Tensor,
        coarse_maps: Tensor | None,
        fine_maps: Tensor | None,
        noise: Tensor | None,
    ) -> tuple[Tensor, Tensor]:
        """Double the size of the features, add noise to them and to the skip connection, and return both.

        Parameters
        ----------
        features : sequence of (N, C, H, W)
            Read together; their channels add up to `channels_in`.
        skip : (N, channels_out, 2H, 2W)
            Features of the encoder at the resolution of the result.
        coarse_maps : (N, K, H, W), optional
            Maps that the enlarging convolution reads.
        fine_maps : (N, K, 2H, 2W), optional
            Maps that the convolution of stride 1 reads.
        noise : (N, 1, 2H, 2W), optional
            Standard normal; None adds nothing.

        Returns
        -------
        two of (N, channels_out, 2H, 2W)
            The enlarged features and the skip connection.
        """
        grown = instance_norm(F.relu(self.grow(*features, coarse_maps)))
        if self.refine is not None:
            grown = instance_norm(F.relu(self.refine(grown, fine_maps)))
        if self.noise_weight is None or noise is None:
            return grown, skip
        noise = noise.to(grown.dtype)
        grown_weight, skip_weight = self.noise_weight.to(grown.dtype).chunk(2)
        return torch.addcmul(grown, noise, grown_weight), torch.addcmul(skip, noise, skip_weight)


class LocalNetwork(nn.Module):
    """Stem, `depth` down blocks, bottleneck, `depth` up blocks, output convolution."""

    def __init__(self, spec: GeneratorSpec, labels: int = 1) -> None:
        super().__init__()
        channels = (LOCAL_WIDTHS + LOCAL_WIDTHS[-1:] * spec.depth)[: spec.depth + 1]
        widths = [scaled(count, spec.width) for count in channels]
        fed = fed_channels(spec, labels)
        maps = fed.stop - fed.start
        self.stem = nn.Conv2d(input_channels(spec, labels), widths[0], 3, padding=1)
        self.down = nn.ModuleList(DownBlock(fine, coarse, maps) for fine, coarse in pairwise(widths))
        self.bottleneck = JointConvolution(widths[-1] + maps, widths[-1], 3, padding=1)
        coarse_to_fine = pairwise(reversed(widths))
        self.up = nn.ModuleList(UpBlock(2 * coarse, fine, maps, spec) for coarse, fine in coarse_to_fine)
        self.grain: JointConvolution | None = None
        last_features = 2 * widths[0]
        if spec.grain is Grain.refine:
            self.grain = JointConvolution(2 * widths[0] + maps, widths[0], 3, padding=1)
            last_features = widths[0]
        self.output = JointConvolution(last_features + maps, rows_of_a_cell(spec), 3, padding=1)

    def forward(self, stacked: Tensor, maps: Sequence[Tensor | None], noise: Sequence[Tensor | None]) -> Tensor:
        """Render the input channels, (N, inputs, H, W) with H and W multiples of 2^depth, to (k N, 1, H, W) in [-1, 1].

        The output has two channels where rows are folded.

        The convolutions of each level, except the stem, read its maps, depth + 1 of (N, K, H / 2^level, W / 2^level).
        Its noise, depth of (k N, 1, H / 2^level, W / 2^level), is injected; what comes before the noise is computed
        once for all k.
        """
        features = instance_norm(F.leaky_relu(self.stem(stacked), LEAK))
        skips = []
        for level, block in enumerate(self.down):
            skips.append(features)
            features = block(features, maps[level], maps[level + 1])
        bottom = instance_norm(F.leaky_relu(self.bottleneck(features, maps[-1]), LEAK))
        if noise[0] is None or len(noise[0]) == len(stacked):
            return self._decode((bottom, features), skips, maps, noise)
        draws = zip(*(field.split(len(stacked)) for field in noise if field is not None), strict=True)
        return torch.cat([self._decode((bottom, features), skips, maps, fields) for fields in draws])

    def _decode(
        self,
        features: tuple[Tensor, Tensor],
        skips: Sequence[Tensor],
        maps: Sequence[Tensor | None],
        noise: Sequence[Tensor | None],
    ) -> Tensor:
        for level, block in zip(reversed(range(len(skips))), self.up, strict=True):
            features = block(features, skips[level], maps[level + 1], maps[level], noise[level])
        if self.grain is None:
            return torch.tanh(self.output(*features, maps[0]))
        refined = F.leaky_relu(self.grain(*features, maps[0]), LEAK)
        return torch.tanh(self.output(refined, maps[0]))


class UNetwork(nn.Module):
    """`depth` convolutions 4x4 of stride 2, as many transposed ones, and skip connections between them.

    With depth 8 this is the U-Net-256 of pix2pix, with a bias in every convolution, and with instance norm after each
    activation, as the paper says of all its networks; pix2pix has it before. It has no dropout, because the paper
    mentions none and a rendering must be repeatable.
    """

    def __init__(self, spec: GeneratorSpec, labels: int = 1) -> None:
        super().__init__()
        channels = (UNET_WIDTHS + UNET_WIDTHS[-1:] * spec.depth)[: spec.depth]
        widths = [scaled(count, spec.width) for count in channels]
        shrink = pairwise((input_channels(spec, labels), *widths))
        self.down = nn.ModuleList(
            nn.Conv2d(channels_in, channels_out, 4, stride=2, padding=1) for channels_in, channels_out in shrink
        )
        grown = (*reversed(widths[:-1]), rows_of_a_cell(spec))
        read = (widths[-1], *(2 * width for width in grown[:-1]))  # each but the first with its skip connection
        self.up = nn.ModuleList(
            JointTransposedConvolution(channels_in, channels_out, 4, stride=2, padding=1)
            for channels_in, channels_out in zip(read, grown, strict=True)
        )

    def forward(self, stacked: Tensor, _maps: Sequence[Tensor | None], _noise: Sequence[Tensor | None]) -> Tensor:
        """Render (N, inputs, H, W) to (N, 1, H, W) in [-1, 1], of folded rows two channels.

        H and W are multiples of 2^depth.
        """
        skips = []
        features = stacked
        for layer in self.down:
            features = instance_norm(F.leaky_relu(layer(features), LEAK))
            skips.append(features)
        features = skips.pop()
        for layer in self.up[:-1]:
            features = torch.cat((skips.pop(), instance_norm(F.relu(layer(features)))), dim=1)
        return torch.tanh(self.up[-1](features))


class PatchDiscriminator(nn.Module):
    """Three 4x4 convolutions of stride 2 and two of stride 1, each followed by instance norm and leaky ReLU.

    The first has no norm, and the last has neither.

    Parameters
    ----------
    in_channels : int
        Conditions and image together: `discriminator_channels(spec, labels)`.
    width : float
        Multiplier of the channel counts 64, 128, 256, 512.

    Notes
    -----
    Isola et al., "Image-to-image translation with conditional adversarial networks", CVPR 2017.
    """

    def __init__(self, in_channels: int, width: float = 1.0) -> None:
        super().__init__()
        widths = [scaled(channels, width) for channels in UNET_WIDTHS]
        self.first = nn.Conv2d(in_channels, widths[0], 4, stride=2, padding=1)
        self.inner = nn.ModuleList(
            nn.Conv2d(fine, coarse, 4, stride, padding=1)
            for (fine, coarse), stride in zip(pairwise(widths), (2, 2, 1), strict=True)
        )
        self.last = nn.Conv2d(widths[3], 1, 4, stride=1, padding=1)
        draw_initial_weights(self)

    def forward(self, maps: Tensor, image: Tensor) -> Tensor:
        """Score patches: logits, (N, 1, H / 8 - 2, W / 8 - 2), positive for real.

        `maps`, (N, C, H, W), are the conditions. `image`, (N, 1, H, W), is real or generated, black outside the fan,
        and has at least 32 x 32 pixels.
        """
        stacked = laid_out(torch.cat((maps, image.to(maps.dtype)), dim=1))
        features = F.leaky_relu(self.first(stacked), LEAK)
        for layer in self.inner:
            features = F.leaky_relu(instance_norm(layer(features)), LEAK)
        return cast(Tensor, self.last(features))


def discriminator_channels(spec: GeneratorSpec, labels: int = 1) -> int:
    """Count the input channels of this generator's discriminator: its conditions, and the image."""
    return sum(map_channels(name, labels) for name in judged(spec)) + 1
