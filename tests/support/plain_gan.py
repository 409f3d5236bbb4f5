"""The same networks as anybody would write them first, in the style of pix2pix's own code.

Plain modules of torch, fp32, maps joined by concatenation, noise from torch's generator. Tests compare the networks'
values with theirs, and `benchmarks/training.py` the speed.
"""

from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks import (
    Concat,
    GeneratorSpec,
    Grain,
    Noise,
    Upsampling,
    conditions,
    inputs,
)
from ablate.networks.spec import scaled


def channels_of(names: tuple[str, ...], labels: int) -> int:
    """Channels of these maps as the generator's convolutions read them."""
    return sum(labels if name == "segmentation" else 1 for name in names)


class PlainDownBlock(nn.Module):
    def __init__(self, channels_in: int, channels_out: int, maps: int) -> None:
        super().__init__()
        self.shrink = nn.Conv2d(channels_in + maps, channels_out, 3, stride=2, padding=1)
        self.refine = nn.Conv2d(channels_out + maps, channels_out, 3, padding=1)
        self.norm = nn.InstanceNorm2d(channels_out)

    def forward(self, features: Tensor, fine: list[Tensor], coarse: list[Tensor]) -> Tensor:
        features = self.norm(F.leaky_relu(self.shrink(torch.cat([features, *fine], 1)), 0.2))
        return self.norm(F.leaky_relu(self.refine(torch.cat([features, *coarse], 1)), 0.2))


class PlainUpBlock(nn.Module):
    def __init__(self, channels_in: int, channels_out: int, maps: int, spec: GeneratorSpec) -> None:
        super().__init__()
        if spec.upsampling is Upsampling.texture:
            self.grow = nn.ConvTranspose2d(channels_in + maps, channels_out, 3, stride=2, padding=1, output_padding=1)
            self.refine = nn.Conv2d(channels_out + maps, channels_out, 3, padding=1)
        else:
            self.grow = nn.ConvTranspose2d(channels_in + maps, channels_out, 4, stride=2, padding=1)
        self.norm = nn.InstanceNorm2d(channels_out)
        if spec.noise is Noise.inject:
            self.noise_weight = nn.Parameter(torch.full((2 * channels_out, 1, 1), float(spec.noise_start)))

    def forward(self, features: Tensor, skip: Tensor, coarse: list[Tensor], fine: list[Tensor]) -> Tensor:
        features = self.norm(F.relu(self.grow(torch.cat([features, *coarse], 1))))
        if hasattr(self, "refine"):
            features = self.norm(F.relu(self.refine(torch.cat([features, *fine], 1))))
        features = torch.cat([features, skip], 1)
        if hasattr(self, "noise_weight"):
            noise = torch.randn(len(features), 1, *features.shape[-2:], dtype=features.dtype, device=features.device)
            features = features + self.noise_weight * noise
        return features


class PlainLocal(nn.Module):
    """The local generator; its parameters are named as those of `LocalNetwork`."""

    def __init__(self, spec: GeneratorSpec, labels: int = 1) -> None:
        super().__init__()
        self.spec = spec
        self.labels = labels
        channels = (64, 128, 128, 256, *[512] * spec.depth)[: spec.depth + 1]
        widths = [scaled(count, spec.width) for count in channels]
        self.fed = 0
        if spec.concat is Concat.every_level:
            self.fed = channels_of(tuple(name for name in conditions(spec) if name != "low"), labels)
        self.stem = nn.Conv2d(channels_of(inputs(spec), labels), widths[0], 3, padding=1)
        self.norms = nn.ModuleList(nn.InstanceNorm2d(count) for count in (widths[0], widths[-1]))
        self.down = nn.ModuleList(PlainDownBlock(fine, coarse, self.fed) for fine, coarse in pairwise(widths))
        self.bottleneck = nn.Conv2d(widths[-1] + self.fed, widths[-1], 3, padding=1)
        ups = list(pairwise([widths[-1], *reversed(widths[:-1])]))
        self.up = nn.ModuleList(PlainUpBlock(2 * coarse, fine, self.fed, spec) for coarse, fine in ups)
        if spec.grain is Grain.refine:
            self.grain = nn.Conv2d(2 * widths[0] + self.fed, widths[0], 3, padding=1)
        last = widths[0] if spec.grain is Grain.refine else 2 * widths[0]
        self.output = nn.Conv2d(last + self.fed, 1, 3, padding=1)

    def forward(self, stacked: Tensor) -> Tensor:
        """Render the stacked conditions, (N, conditions, H, W); H and W are multiples of 2^depth."""
        maps = [self.resized(stacked, level) for level in range(self.spec.depth + 1)]
        features = self.norms[0](F.leaky_relu(self.stem(with_noise(stacked, self.spec)), 0.2))
        skips = []
        for level, block in enumerate(self.down):
            skips.append(features)
            features = block(features, maps[level], maps[level + 1])
        bottom = self.norms[1](F.leaky_relu(self.bottleneck(torch.cat([features, *maps[-1]], 1)), 0.2))
        features = torch.cat([bottom, features], 1)
        for level, block in zip(reversed(range(self.spec.depth)), self.up, strict=True):
            features = block(features, skips[level], maps[level + 1], maps[level])
        if self.spec.grain is Grain.refine:
            features = F.leaky_relu(self.grain(torch.cat([features, *maps[0]], 1)), 0.2)
        return torch.tanh(self.output(torch.cat([features, *maps[0]], 1)))

    def resized(self, stacked: Tensor, level: int) -> list[Tensor]:
        """The maps that every level reads, at 1 / 2^level of the resolution."""
        size = [length >> level for length in stacked.shape[-2:]]
        order = int(self.fed > 0 and self.labels == 1)
        maps = [F.interpolate(stacked[:, :1], size, mode="nearest")] if order else []
        if self.fed > order:
            maps.append(F.interpolate(stacked[:, order : self.fed], size, mode="area"))
        return maps


class PlainUNet(nn.Module):
    """The U-Net of pix2pix without dropout and with norms after activations; parameters are named as in `UNetwork`."""

    def __init__(self, spec: GeneratorSpec, labels: int = 1) -> None:
        super().__init__()
        self.spec = spec
        widths = [scaled((64, 128, 256, 512)[min(level, 3)], spec.width) for level in range(spec.depth)]
        channels = [channels_of(inputs(spec), labels), *widths]
        self.down = nn.ModuleList(nn.Conv2d(a, b, 4, stride=2, padding=1) for a, b in pairwise(channels))
        out = [*reversed(widths[:-1]), 1]
        into = [widths[-1], *(2 * width for width in out[:-1])]
        self.up = nn.ModuleList(
            nn.ConvTranspose2d(a, b, 4, stride=2, padding=1) for a, b in zip(into, out, strict=True)
        )

    def forward(self, stacked: Tensor) -> Tensor:
        """Render the stacked conditions, (N, conditions, H, W); H and W are multiples of 2^depth."""
        features = with_noise(stacked, self.spec)
        encoded = []
        for layer in self.down:
            features = F.leaky_relu(layer(features), 0.2)
            if features.shape[-2:].numel() > 1:
                features = F.instance_norm(features)
            encoded.append(features)
        for index, layer in enumerate(self.up[:-1]):
            decoded = F.instance_norm(F.relu(layer(features)))
            features = torch.cat([encoded[-2 - index], decoded], 1)
        return torch.tanh(self.up[-1](features))


class PlainDiscriminator(nn.Module):
    """The 70 x 70 PatchGAN; its parameters are named as those of `PatchDiscriminator`."""

    def __init__(self, in_channels: int, width: float) -> None:
        super().__init__()
        widths = [scaled(channels, width) for channels in (64, 128, 256, 512)]
        self.first = nn.Conv2d(in_channels, widths[0], 4, stride=2, padding=1)
        strides = (2, 2, 1)
        self.inner = nn.ModuleList(
            nn.Conv2d(a, b, 4, stride=s, padding=1) for (a, b), s in zip(pairwise(widths), strides, strict=True)
        )
        self.norms = nn.ModuleList(nn.InstanceNorm2d(b) for b in widths[1:])
        self.last = nn.Conv2d(widths[3], 1, 4, padding=1)

    def forward(self, maps: Tensor, image: Tensor) -> Tensor:
        """Judge patches of (N, 1, H, W) under (N, C, H, W)."""
        features = F.leaky_relu(self.first(torch.cat([maps, image], 1)), 0.2)
        for layer, norm in zip(self.inner, self.norms, strict=True):
            features = F.leaky_relu(norm(layer(features)), 0.2)
        logits: Tensor = self.last(features)
        return logits


def with_noise(stacked: Tensor, spec: GeneratorSpec) -> Tensor:
    """Append a channel of noise for the variants that read one."""
    return torch.cat([stacked, torch.randn_like(stacked[:, :1])], 1) if "noise" in inputs(spec) else stacked
