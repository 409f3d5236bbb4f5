"""A generator from its specification: any image size in, padded, rendered and cropped back."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.gaussian_fields import gaussian_field
from ablate.networks.layers import draw_initial_weights, laid_out
from ablate.networks.local import LocalNetwork
from ablate.networks.spec import Concat, Family, GeneratorSpec, Noise, conditions, inputs
from ablate.networks.unet import UNetwork

# What lies outside the fan, and is padded with.
OUTSIDE = {"segmentation": -1.0, "attenuation": 0.0, "low": -1.0}
_CHANNEL = "noise"
# The noise channel is a field of its own, apart from those injected at levels 0 to depth - 1.
_CHANNEL_FIELD = 64


class Generator(nn.Module):
    """Segmentation (and what else the specification names) to a B-mode image.

    It holds no parameter and draws, resizes and reads nothing that its variant does not use.

    Parameters
    ----------
    spec : GeneratorSpec
        The components.

    Attributes
    ----------
    spec : GeneratorSpec
    network : LocalNetwork or UNetwork
    """

    def __init__(self, spec: GeneratorSpec) -> None:
        super().__init__()
        self.spec = spec
        self.network: LocalNetwork | UNetwork
        self.network = LocalNetwork(spec) if spec.family is Family.local else UNetwork(spec)
        draw_initial_weights(self)

    def forward(
        self,
        segmentation: Tensor,
        attenuation: Tensor | None = None,
        low: Tensor | None = None,
        noise_seed: Tensor | None = None,
    ) -> Tensor:
        """Render images.

        Parameters
        ----------
        segmentation : (N, 1, H, W) float in [-1, 1]
            Encoded labels, -1 outside the fan.
        attenuation : (N, 1, H, W) float in [0, 1], optional
            Integral attenuation map, 0 outside the fan. Not read unless the variant does.
        low : (N, 1, H, W) float in [-1, 1], optional
            Low-quality image. Not read unless the variant does.
        noise_seed : (N,) int64, optional
            One seed a sample for all its noise; None switches noise off (fields of zero).

        Returns
        -------
        (N, 1, H, W) float in [-1, 1]
            Not masked: the caller knows the fan.

        Raises
        ------
        ValueError
            Where a map that the variant reads is missing or has another shape.
        """
        given = {"segmentation": segmentation, "attenuation": attenuation, "low": low}
        if noise_seed is None:
            return self.render(given, {})
        return self.render(given, self.draw_noise(noise_seed.to(segmentation.device), *segmentation.shape[-2:]))

    def render(self, given: Mapping[str, Tensor | None], noise: Mapping[str, Tensor]) -> Tensor:
        """Render images with noise that is drawn already.

        Parameters
        ----------
        given : mapping of (N, 1, H, W) float
            The maps of `conditions(spec)`, as in `forward`; others are not read.
        noise : mapping of (N, 1, h, w) float
            The fields of `noise_sizes(H, W)`, standard normal; empty to switch noise off.

        Returns
        -------
        (N, 1, H, W) float in [-1, 1]
        """
        maps = self._padded(given)
        injected = [noise.get(_injected(level)) for level in range(self.spec.depth)]
        image: Tensor = self.network(self._stacked(maps, noise.get(_CHANNEL)), self._pyramid(maps), injected)
        height, width = next(value.shape[-2:] for value in given.values() if value is not None)
        return image if image.shape[-2:] == (height, width) else image[..., :height, :width]

    def noise_sizes(self, height: int, width: int) -> dict[str, tuple[int, int]]:
        """Name the noise fields that an image of this size takes, with the height and width of each, px.

        `noise` is an input channel, `noise_<level>` is injected at 1/2^level of the resolution. The sizes are those
        of the image padded to a multiple of 2^depth. Empty where the variant draws none.
        """
        height, width = height + -height % 2**self.spec.depth, width + -width % 2**self.spec.depth
        sizes = {_CHANNEL: (height, width)} if _CHANNEL in inputs(self.spec) else {}
        if self.spec.noise is Noise.inject:
            sizes |= {_injected(level): (height >> level, width >> level) for level in range(self.spec.depth)}
        return sizes

    def draw_noise(self, seed: Tensor, height: int, width: int) -> dict[str, Tensor]:
        """Draw the fields of `noise_sizes(height, width)`, (N, 1, h, w) float32 each, from (N,) int64 seeds."""
        number = {_CHANNEL: _CHANNEL_FIELD} | {_injected(level): level for level in range(self.spec.depth)}
        return {
            name: gaussian_field(seed, number[name], *size) for name, size in self.noise_sizes(height, width).items()
        }

    def noise_magnitude(self) -> Tensor | None:
        """Mean absolute weight of the injected noise, a scalar; None where none is injected.

        A value that falls under 0.02 tells that the network has learned to ignore its noise.
        """
        if self.spec.noise is not Noise.inject:
            return None
        weights = [weight for name, weight in self.named_parameters() if name.endswith("noise_weight")]
        return torch.cat([weight.detach().flatten() for weight in weights]).abs().mean()

    def _padded(self, given: Mapping[str, Tensor | None]) -> Tensor:
        """Pad and stack the conditions, (N, conditions, H, W), in the dtype that convolutions compute in."""
        names = conditions(self.spec)
        stack: list[Tensor] = []
        for name in names:
            value = given[name]
            if value is None:
                raise ValueError(f"{name}: missing, this generator reads {', '.join(names)}")
            if value.ndim != 4 or value.shape[1] != 1 or (stack and value.shape != stack[0].shape):
                raise ValueError(f"{name}: shape {tuple(value.shape)}, allowed is (N, 1, H, W), all alike")
            stack.append(value)
        height, width = stack[0].shape[-2:]
        unit = 2**self.spec.depth
        padding = (0, -width % unit, 0, -height % unit)
        if any(padding):
            stack = [F.pad(x, padding, value=OUTSIDE[name]) for x, name in zip(stack, names, strict=True)]
        stacked = laid_out(torch.cat(stack, dim=1))
        kind = stacked.device.type
        return stacked.to(torch.get_autocast_dtype(kind)) if torch.is_autocast_enabled(kind) else stacked

    def _stacked(self, maps: Tensor, noise: Tensor | None) -> Tensor:
        """Append the noise channel to the conditions if the variant has one."""
        if _CHANNEL not in inputs(self.spec):
            return maps
        channel = torch.zeros_like(maps[:, :1]) if noise is None else noise.to(maps.dtype)
        return torch.cat((maps, channel), dim=1)

    def _pyramid(self, maps: Tensor) -> list[Tensor | None]:
        """Resize segmentation (nearest) and attenuation (bilinear) to every level, once."""
        levels = range(self.spec.depth + 1)
        if self.spec.concat is Concat.input:
            return [None for _ in levels]
        fed = sum(name in ("segmentation", "attenuation") for name in conditions(self.spec))
        pyramid: list[Tensor | None] = [maps[:, :fed]]
        for level in levels[1:]:
            step = 2**level
            # Nearest: the pixel at each cell's corner, which is where a stride-2 convolution is centred.
            resized = [maps[:, :1, ::step, ::step]]
            if fed == 2:
                # Bilinear: the mean of the four pixels around each cell's centre, (step - 1) / 2 px beside that corner.
                size = resized[0].shape[-2:]
                resized.append(F.interpolate(maps[:, 1:2], size, mode="bilinear", align_corners=False))
            pyramid.append(laid_out(torch.cat(resized, dim=1)))
        return pyramid


def _injected(level: int) -> str:
    """Name the field injected at 1/2^level of the resolution."""
    return f"{_CHANNEL}_{level}"
