"""Layers that the networks share: convolutions, instance norm, initial weights, and a list of the layers."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

EPSILON = 1e-5
Convolution = nn.Conv2d | nn.ConvTranspose2d


class JointConvolution(nn.Conv2d):
    """Convolution of several tensors together: the sum of the convolutions of each.

    Nothing is copied into one tensor, and channel counts remain multiples of the processor's vectors.
    """

    def forward(self, *parts: Tensor | None) -> Tensor:
        """Convolve those of the (N, C, H, W) that are not None."""
        given = [part for part in parts if part is not None]
        weights = self.weight.split([part.shape[1] for part in given], dim=1)
        result = F.conv2d(given[-1], weights[-1], self.bias, self.stride, self.padding)
        for part, weight in zip(given[:-1], weights, strict=False):
            result = result + F.conv2d(part, weight, None, self.stride, self.padding)
        return result


class JointTransposedConvolution(nn.ConvTranspose2d):
    """The transposed `JointConvolution`."""

    def forward(self, *parts: Tensor | None) -> Tensor:  # type: ignore[override]
        """Convolve those of the (N, C, H, W) that are not None."""
        given = [part for part in parts if part is not None]
        if torch.compiler.is_exporting():  # which OpenVINO computes faster than the sum
            return super().forward(torch.cat(given, dim=1) if len(given) > 1 else given[0])
        weights = self.weight.split([part.shape[1] for part in given])
        steps = self.stride, self.padding, self.output_padding
        result = F.conv_transpose2d(given[-1], weights[-1], self.bias, *steps)  # type: ignore[arg-type]
        for part, weight in zip(given[:-1], weights, strict=False):
            result = result + F.conv_transpose2d(part, weight, None, *steps)  # type: ignore[arg-type]
        return result


def laid_out(maps: Tensor) -> Tensor:
    """Arrange (N, C, H, W) in the memory format that is fastest on its device; later layers keep it.

    On a CPU oneDNN's convolutions read channels-last maps directly. On a GPU instance norm returns maps channel by
    channel, torch's default, so another format would be undone after every convolution.
    """
    return maps.contiguous(memory_format=torch.channels_last) if maps.device.type == "cpu" else maps


def area_means(maps: Tensor) -> Tensor:
    """Halve (N, C, H, W), H and W even, by the mean of each 2 x 2 pixels."""
    if torch.compiler.is_exporting():  # OpenVINO pools few channels slowly
        return F.conv2d(maps, maps.new_full((maps.shape[1], 1, 2, 2), 0.25), stride=2, groups=maps.shape[1])
    return F.avg_pool2d(maps, 2)


def instance_norm(features: Tensor) -> Tensor:
    """Normalise every channel of (N, C, H, W) over its pixels (Ulyanov et al., "Instance normalization", 2016).

    A 1 x 1 map is returned unchanged, because its deviation is zero. On a CPU the mean is subtracted before the squares
    are summed: torch's own function takes both sums at once, and loses all digits of a channel that varies little about
    its mean. It also takes longer, because its gradient is slow for channels-last maps.
    """
    batch, channels, height, width = features.shape
    if height * width == 1:
        return features
    is_followed = type(features) is not Tensor  # as by `receptive_field`, which knows torch's own functions alone
    if features.device.type != "cpu" or torch.compiler.is_exporting() or is_followed:
        return F.instance_norm(features)
    pixels = features.permute(0, 2, 3, 1).reshape(batch, -1, channels)  # torch is fastest over the middle of three
    pixels = pixels.to(torch.promote_types(features.dtype, torch.float32))
    centred = pixels - pixels.mean(1, keepdim=True)
    inverse_sd = (centred.square().mean(1, keepdim=True) + EPSILON).rsqrt()
    result = (centred * inverse_sd).to(features.dtype)
    return result.reshape(batch, height, width, channels).permute(0, 3, 1, 2)


def draw_initial_weights(network: nn.Module) -> None:
    """Draw every convolution's weights from N(0, 0.02^2) and set its bias to zero, as pix2pix does."""
    for layer in convolutions(network):
        if layer.weight.is_meta:  # has a size and no values; torch would load its compiler to draw none
            continue
        nn.init.normal_(layer.weight, 0.0, 0.02)
        if layer.bias is not None:
            nn.init.zeros_(layer.bias)


def convolutions(network: nn.Module) -> list[Convolution]:
    """List the convolutions of a network in the order in which they were made."""
    return [module for module in network.modules() if isinstance(module, Convolution)]
