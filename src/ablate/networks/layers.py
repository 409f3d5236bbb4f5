"""Layers that the networks share: convolutions, instance norm, initial weights, and a list of the layers."""

from typing import Any, cast

import torch
from torch import Tensor, nn
from torch.nn import functional as F

EPSILON = 1e-5
# Pixels under which torch normalises channels-last maps one value at a time.
SMALL_MAP = 1024
Convolution = nn.Conv2d | nn.ConvTranspose2d


class JointConvolution(nn.Conv2d):
    """Convolution of features and maps together: the sum of the convolutions of both.

    Without a concatenation, nothing is copied, and channel counts remain multiples of the processor's vectors. An
    exported network contains the ordinary convolution.
    """

    def forward(self, features: Tensor, maps: Tensor | None = None) -> Tensor:
        """Convolve (N, C, H, W) and, if not None, (N, K, H, W)."""
        if maps is None or torch.compiler.is_exporting():
            return super().forward(joined(features, maps))
        of_features, of_maps = self.weight.split((features.shape[1], maps.shape[1]), dim=1)
        result = F.conv2d(features, of_features, None, self.stride, self.padding)
        return result + F.conv2d(maps, of_maps, self.bias, self.stride, self.padding)


class JointTransposedConvolution(nn.ConvTranspose2d):
    """The transposed `JointConvolution`. It adds the bias afterwards, where its gradient is faster on a CPU."""

    def forward(self, features: Tensor, maps: Tensor | None = None) -> Tensor:  # type: ignore[override]
        """Convolve (N, C, H, W) and, if not None, (N, K, H, W)."""
        if torch.compiler.is_exporting():
            return super().forward(joined(features, maps))
        if maps is None:
            result = self._transposed(features, self.weight)
        else:
            of_features, of_maps = self.weight.split((features.shape[1], maps.shape[1]))
            result = self._transposed(features, of_features) + self._transposed(maps, of_maps)
        return result if self.bias is None else result + self.bias.to(result.dtype)[:, None, None]

    def _transposed(self, features: Tensor, weight: Tensor) -> Tensor:
        return F.conv_transpose2d(features, weight, None, self.stride, self.padding, self.output_padding)  # type: ignore[arg-type]


class ResizedConvolution(nn.Conv2d):
    """Features enlarged twofold by nearest neighbour, then a convolution 3x3 that also reads maps of the large grid.

    Every output pixel gets all taps of the kernel, so no pattern of period 2 is left before training. Nearest neighbour
    gave the best images in Odena et al., "Deconvolution and checkerboard artifacts", Distill 2016. A pixel and its
    copies are read by neighbouring taps, so both steps together are one transposed convolution 4x4 of stride 2, whose
    taps are sums of taps: it takes 4 products where 9 would be needed. An exported network contains the two steps.
    """

    def __init__(self, in_channels: int, out_channels: int) -> None:
        super().__init__(in_channels, out_channels, 3, padding=1)

    def forward(self, features: Tensor, maps: Tensor | None = None) -> Tensor:
        """Enlarge and convolve (N, C, H, W) and, if not None, convolve (N, K, 2H, 2W)."""
        if torch.compiler.is_exporting():
            return super().forward(joined(F.interpolate(features, scale_factor=2, mode="nearest"), maps))
        own = features.shape[1]
        kernel = _sums_of_neighbours(_sums_of_neighbours(self.weight[:, :own].flip(2, 3), 2), 3)
        result = F.conv_transpose2d(features, kernel.transpose(0, 1), None, stride=2, padding=1)
        if maps is not None:
            return result + F.conv2d(maps, self.weight[:, own:], self.bias, padding=1)
        return result if self.bias is None else result + self.bias.to(result.dtype)[:, None, None]


def _sums_of_neighbours(taps: Tensor, dim: int) -> Tensor:
    """Convolve with (1, 1) along a dimension: n taps become n + 1."""
    count = taps.shape[dim]
    inner = taps.narrow(dim, 0, count - 1) + taps.narrow(dim, 1, count - 1)
    return torch.cat((taps.narrow(dim, 0, 1), inner, taps.narrow(dim, count - 1, 1)), dim)


class OneChannelConvolution(nn.Conv2d):
    """Convolution k x k to a single channel, stride 1, same size, faster on a CPU.

    Torch pads the single output channel to 16. Here a convolution 1x1 computes the k^2 taps of every pixel, which are
    then shifted and summed (bf16 in float32).
    """

    def __init__(self, in_channels: int, kernel: int) -> None:
        super().__init__(in_channels, 1, kernel, padding=kernel // 2)

    def forward(self, features: Tensor, maps: Tensor | None = None) -> Tensor:
        """Convolve (N, C, H, W) and, if not None, (N, K, H, W) to (N, 1, H, W)."""
        if features.device.type != "cpu" or torch.compiler.is_exporting():
            return super().forward(joined(features, maps))
        (kernel, _), size, own = self.kernel_size, features.shape[-2:], features.shape[1]
        taps_weight = self.weight[0].flip(1, 2).flatten(1).t()[:, :, None, None]
        taps = F.conv2d(features, taps_weight[:, :own])
        if maps is not None:
            taps = taps + F.conv2d(maps, taps_weight[:, own:])
        taps = taps.float() if taps.dtype is torch.bfloat16 else taps
        result = F.fold(taps.flatten(2), size, kernel, padding=kernel // 2)
        return result if self.bias is None else result + self.bias[:, None, None]


def laid_out(maps: Tensor) -> Tensor:
    """Arrange (N, C, H, W) in the memory format that is fastest on its device; later layers keep it.

    On a CPU oneDNN's convolutions read channels-last maps directly. On a GPU instance norm returns maps channel by
    channel, torch's default, so another format would be undone after every convolution.
    """
    return maps.contiguous(memory_format=torch.channels_last) if maps.device.type == "cpu" else maps


def joined(features: Tensor, maps: Tensor | None) -> Tensor:
    """Append the channels of `maps` (N, K, H, W), if not None, to those of `features` (N, C, H, W)."""
    return features if maps is None else torch.cat((features, maps), dim=1)


def instance_norm(features: Tensor) -> Tensor:
    """Normalise every channel of (N, C, H, W) over its pixels (Ulyanov et al., "Instance normalization", 2016).

    A 1 x 1 map is returned unchanged, because its deviation is zero. On a CPU torch's own function takes 2 to 10 times
    as long.
    """
    if features.shape[-1] * features.shape[-2] == 1:
        return features
    if features.device.type != "cpu" or torch.compiler.is_exporting():
        return F.instance_norm(features)
    if torch.is_grad_enabled() and features.requires_grad and not torch.compiler.is_compiling():
        return cast(Tensor, _InstanceNorm.apply(features))
    if torch.compiler.is_compiling():
        return F.group_norm(features, features.shape[1], eps=EPSILON)
    return _normalised(features)[0]


class _InstanceNorm(torch.autograd.Function):
    """Instance norm with a fast gradient for channels-last maps.

    The gradient of torch 2.13 takes 60 times as long as the forward pass. Here it comes from the output y and 1/sd:
    dx = (dy - mean(dy) - y mean(y dy)) / sd, with means over the pixels.
    """

    @staticmethod
    def forward(context: Any, features: Tensor) -> Tensor:
        result, inverse_sd = _normalised(features)
        result = result.contiguous(memory_format=torch.channels_last)
        context.save_for_backward(result, inverse_sd)
        return result

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(context: Any, gradient: Tensor) -> Tensor:
        result, inverse_sd = context.saved_tensors
        rows, normal = _rows(gradient), _rows(result)
        channels = result.shape[1]
        slope = _along(_mean(rows * normal, channels), rows)
        change = torch.addcmul(rows, normal, slope, value=-1)
        change.sub_(_along(_mean(rows, channels), rows)).mul_(_along(inverse_sd, rows))
        return _maps(change, channels)


def _normalised(features: Tensor) -> tuple[Tensor, Tensor]:
    """Compute instance norm on a CPU, and 1/sd, (N, C).

    The group norm of torch 2.13 sums the squares of channels-last maps one by one and subtracts the squared means. With
    10^6 pixels it loses all digits of a channel that varies little about its mean, and is 8 % wrong in bf16 if the
    channel varies by a tenth of it. Therefore the mean is subtracted first. Small maps are arranged channel by channel,
    where torch uses cascaded sums and is 20 times as fast.
    """
    batch, channels, height, width = features.shape
    if height * width < SMALL_MAP:
        sizes = batch, channels, height * width, channels
        result, _, inverse_sd = torch.native_group_norm(features.contiguous(), None, None, *sizes, EPSILON)
        return result, inverse_sd
    rows = _rows(features)
    centred = rows - _along(_mean(rows, channels), rows)
    inverse_sd = (_mean(centred.square(), channels) + EPSILON).rsqrt()
    return _maps(centred.mul_(_along(inverse_sd, rows)), channels), inverse_sd


def _rows(maps: Tensor) -> Tensor:
    """Arrange (N, C, H, W) as (N, H, W C), because torch is fastest with long rows."""
    return maps.contiguous(memory_format=torch.channels_last).permute(0, 2, 3, 1).flatten(2)


def _maps(rows: Tensor, channels: int) -> Tensor:
    """Undo `_rows`; the maps are channels-last."""
    return rows.unflatten(2, (-1, channels)).permute(0, 3, 1, 2)


def _mean(rows: Tensor, channels: int) -> Tensor:
    """Average (N, H, W C) over the pixels, (N, C): first over columns, then in at least float32."""
    sums = rows.sum(1).unflatten(1, (-1, channels))
    return sums.mean(1, dtype=torch.promote_types(rows.dtype, torch.float32)) / rows.shape[1]


def _along(values: Tensor, rows: Tensor) -> Tensor:
    """Repeat (N, C) along a row, (N, 1, W C)."""
    return values.reshape(len(rows), -1).to(rows.dtype).repeat(1, rows.shape[2] // values.shape[1])[:, None]


def pixel_norm(features: Tensor) -> Tensor:
    """Divide each pixel's features by their root mean square over the channels; no other pixel counts."""
    return F.rms_norm(features.permute(0, 2, 3, 1), features.shape[1:2], eps=EPSILON).permute(0, 3, 1, 2)


def draw_initial_weights(network: nn.Module) -> None:
    """Draw every convolution's weights from N(0, 0.02^2) and set its bias to zero, as pix2pix does."""
    for layer in convolutions(network):
        nn.init.normal_(layer.weight, 0.0, 0.02)
        if layer.bias is not None:
            nn.init.zeros_(layer.bias)


def convolutions(network: nn.Module) -> list[Convolution]:
    """List the convolutions of a network in the order in which they were made."""
    return [module for module in network.modules() if isinstance(module, Convolution)]
