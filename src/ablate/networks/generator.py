"""A generator made from its specification; images of any size are padded, rendered and cropped."""

import math
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from ablate.networks.custom import CustomNetwork
from ablate.networks.families import LocalNetwork, UNetwork
from ablate.networks.layers import area_means, draw_initial_weights, laid_out
from ablate.networks.spec import (
    DEPTHS,
    Family,
    GeneratorSpec,
    Noise,
    conditions,
    fed_channels,
    inputs,
    map_channels,
    rows_of_a_cell,
)

# The value of each map outside the fan, also used for padding.
OUTSIDE = {"segmentation": -1.0, "low": -1.0}  # and 0 of all others
# Number of each noise field: those injected at the levels of the decoder, and the input channel.
FIELD_NUMBERS = {f"noise_{level}": level for level in range(DEPTHS[-1])} | {"noise": 64}
# splitmix64: Steele, Lea and Flood, "Fast splittable pseudorandom number generators", OOPSLA 2014;
# the constants are those of its reference implementation, as signed 64-bit integers.
_GOLDEN = 0x9E3779B97F4A7C15 - (1 << 64)
_MIX_1 = 0xBF58476D1CE4E5B9 - (1 << 64)
_MIX_2 = 0x94D049BB133111EB - (1 << 64)
_BITS_24 = (1 << 24) - 1


class Generator(nn.Module):
    """Renders a B-mode image from the segmentation and the other inputs of its specification.

    It has no parameter, and computes nothing, that its variant does not use.

    Parameters
    ----------
    spec : GeneratorSpec
        Its components.
    labels : int
        Channels of the segmentation, which follow from how the data set encodes its labels.
    """

    def __init__(self, spec: GeneratorSpec, labels: int = 1) -> None:
        super().__init__()
        self.spec = spec
        self.labels = labels
        self.network: LocalNetwork | UNetwork | CustomNetwork
        if spec.family is Family.custom:
            self.network = CustomNetwork(spec, labels)  # which keeps the weights that it gives itself
            return
        network = LocalNetwork if spec.family is Family.local else UNetwork
        self.network = network(spec, labels)
        draw_initial_weights(self)

    def forward(
        self,
        segmentation: Tensor,
        attenuation: Tensor | None = None,
        low: Tensor | None = None,
        noise_seed: Tensor | None = None,
        **others: Tensor | None,
    ) -> Tensor:
        """Render images, which are not masked: the caller applies the fan.

        Maps that the variant does not read, those that are not among `conditions(spec)`, are ignored.

        Parameters
        ----------
        segmentation : (N, labels, H, W) float
            Encoded labels in [-1, 1], -1 outside the fan.
        attenuation : (N, 1, H, W) float, optional
            In [0, 1], 0 outside the fan.
        low : (N, 1, H, W) float, optional
            The low-quality image in [-1, 1], -1 outside the fan.
        noise_seed : (k N,) int64, optional
            One seed for all noise of each rendering: the first N are one of each sample, the next N another. None
            switches noise off (fields of zero); k is 1 then, and where the variant draws none.
        **others : (N, 1, H, W) float, optional
            `compensated`, `illumination`, `compound` and `interfaces` in [0, 1], `depth` and `lateral` in [-1, 1]; and
            `grain`, (N, 4, H, W), real and imaginary parts of the lattice of scatterers.

        Returns
        -------
        (k N, 1, H, W) float
            In [-1, 1].

        Raises
        ------
        ValueError
            If a map is missing or has another shape, or the seeds are not k for each sample.
        """
        given = {"segmentation": segmentation, "attenuation": attenuation, "low": low, **others}
        if noise_seed is None:
            return self.render(given, {})
        if len(noise_seed) % len(segmentation):
            raise ValueError(f"noise_seed: {len(noise_seed)} for {len(segmentation)} samples, allowed is a multiple")
        return self.render(given, self.draw_noise(noise_seed.to(segmentation.device), *segmentation.shape[-2:]))

    def render(self, given: Mapping[str, Tensor | None], noise: Mapping[str, Tensor]) -> Tensor:
        """Render as `forward`, with fields (k N, 1, h, w) of `noise_sizes(H, W)`; an empty mapping is no noise."""
        each = rows_of_a_cell(self.spec)
        maps = stacked = folded(self._padded(given), each)
        if "noise" in inputs(self.spec):
            channel = folded(noise["noise"].to(maps.dtype), each) if noise else torch.zeros_like(maps[:, :each])
            if len(channel) > len(maps):
                maps = maps.repeat(len(channel) // len(maps), 1, 1, 1)
            stacked = torch.cat((maps, channel), dim=1)
        injected = [noise.get(f"noise_{level}") for level in range(self.spec.depth)]
        image = unfolded(self.network(stacked, self._pyramid(maps), injected), each)
        height, width = next(value.shape[-2:] for value in given.values() if value is not None)
        return image if image.shape[-2:] == (height, width) else image[..., :height, :width]

    def noise_sizes(self, height: int, width: int) -> dict[str, tuple[int, int]]:
        """List the noise fields of an image of this size: name, and height and width, px.

        `noise` is an input channel, `noise_<level>` is injected at 1/2^level of the resolution of the finest level.
        Sizes are those of the image padded to a multiple of 2^depth, of folded rows twice that. The result is empty for
        a variant without noise.
        """
        each, unit = rows_of_a_cell(self.spec), 2**self.spec.depth
        height += -height % (each * unit)
        width += -width % unit
        sizes = {"noise": (height, width)} if "noise" in inputs(self.spec) else {}
        if self.spec.noise is Noise.inject:
            rows = height // each
            sizes |= {f"noise_{level}": (rows >> level, width >> level) for level in range(self.spec.depth)}
        return sizes

    def draw_noise(self, seed: Tensor, height: int, width: int) -> dict[str, Tensor]:
        """Draw the fields of `noise_sizes(height, width)`, (N, 1, h, w) float32 each, from (N,) int64 seeds."""
        sizes = self.noise_sizes(height, width)
        return {name: gaussian_field(seed, FIELD_NUMBERS[name], *size) for name, size in sizes.items()}

    def noise_magnitude(self) -> Tensor | None:
        """Compute the mean absolute weight of the injected noise, a scalar; None if no noise is injected."""
        named = self.named_parameters()
        weights = [weight.detach().flatten() for name, weight in named if name.endswith("noise_weight")]
        return torch.cat(weights).abs().mean() if weights else None

    def _padded(self, given: Mapping[str, Tensor | None]) -> Tensor:
        """Pad and stack the conditions, (N, conditions, H, W), in the dtype of the convolutions."""
        names = conditions(self.spec)
        maps: list[Tensor] = []
        for name in names:
            value = given.get(name)
            if value is None:
                raise ValueError(f"{name}: missing, this generator reads {', '.join(names)}")
            first = maps[0] if maps else value
            channels = map_channels(name, self.labels)
            allowed = (*first.shape[:1], channels, *first.shape[2:])
            if value.ndim != 4 or value.shape != allowed:
                alike = f"(N, {channels}, H, W), N, H and W alike of all maps"
                raise ValueError(f"{name}: shape {tuple(value.shape)}, allowed is {alike}")
            if not value.is_floating_point():
                raise ValueError(f"{name}: {value.dtype}, allowed are floats, as `network_inputs` makes them")
            maps.append(value)
        height, width = maps[0].shape[-2:]
        unit = 2**self.spec.depth
        padding = (0, -width % unit, 0, -height % (unit * rows_of_a_cell(self.spec)))
        if any(padding):
            maps = [F.pad(x, padding, value=OUTSIDE.get(name, 0.0)) for x, name in zip(maps, names, strict=True)]
        stacked = laid_out(torch.cat(maps, dim=1))
        device = stacked.device.type
        return stacked.to(torch.get_autocast_dtype(device)) if torch.is_autocast_enabled(device) else stacked

    def _pyramid(self, maps: Tensor) -> list[Tensor | None]:
        """Resize the maps to every level, once: means over areas, but a scalar order of labels has no mean."""
        fed = fed_channels(self.spec, self.labels)
        if fed.stop == 0:
            return [None for _ in range(self.spec.depth + 1)]
        orders = rows_of_a_cell(self.spec) if self.labels == 1 and fed.start == 0 else 0
        pyramid: list[Tensor | None] = [maps[:, fed]]
        means = maps[:, fed.start + orders : fed.stop]
        for level in range(1, self.spec.depth + 1):
            step = 2**level
            # Of an order the pixel at each cell's corner, where a convolution of stride 2 is centred.
            resized = [maps[:, :orders, ::step, ::step]] if orders else []
            if means.shape[1]:
                means = area_means(means)
                resized.append(means)
            pyramid.append(laid_out(torch.cat(resized, dim=1)))
        return pyramid


def copied(generator: Generator) -> Generator:
    """A generator made anew with the same state, on the CPU; not every class of the user's can be copied as it is."""
    with torch.random.fork_rng():
        copy = Generator(generator.spec, generator.labels)
    copy.load_state_dict(generator.state_dict())
    return copy.train(generator.training)


def folded(maps: Tensor, rows: int) -> Tensor:
    """Make each `rows` rows of (N, C, H, W) one row with `rows` channels in place of each: (N, C rows, H / rows, W)."""
    if rows == 1:
        return maps
    batch, channels, height, width = maps.shape
    cells = maps.reshape(batch, channels, height // rows, rows, width).permute(0, 1, 3, 2, 4)
    return laid_out(cells.reshape(batch, channels * rows, height // rows, width))


def unfolded(maps: Tensor, rows: int) -> Tensor:
    """The inverse of `folded`, of one channel: (N, rows, h, W) to (N, 1, h rows, W)."""
    if rows == 1:
        return maps
    batch, _, height, width = maps.shape
    return maps.permute(0, 2, 1, 3).reshape(batch, 1, height * rows, width)


def gaussian_field(seed: Tensor, level: int, height: int, width: int) -> Tensor:
    """Draw one standard normal field for each sample, from a hash of seed, level and pixel.

    There is no state. A field does not depend on the batch, on earlier draws or on the device, so a resumed training
    gets the same noise as an uninterrupted one.

    Parameters
    ----------
    seed : (N,) int64
        One seed for each sample; the field is computed on its device.
    level : int
        Number of the field; fields of different levels are independent.
    height, width : int
        Pixels.

    Returns
    -------
    (N, 1, height, width) float32
        Values within +-5.9, because a draw has 24 bits.

    Notes
    -----
    splitmix64 counts the pixels; the two halves of a word give a pair of normals by the transform of
    Box and Muller, "A note on the generation of random normal deviates", 1958.
    """
    pixels = height * width
    pairs = (pixels + 1) // 2
    if seed.is_floating_point():
        raise ValueError(f"seed: {seed.dtype}, allowed are whole numbers")
    key = _mix(_mix(seed.long()) + level * 2 + 1)
    counter = torch.arange(1, pairs + 1, device=seed.device, dtype=torch.int64)
    word = _mix(key[:, None] + counter * _GOLDEN)
    radius = ((word & _BITS_24).float().add_(0.5).mul_(2.0**-24)).log_().mul_(-2.0).sqrt_()
    angle = _shifted(word, 40).float().mul_(2.0 * math.pi * 2.0**-24)
    normals = torch.cat((radius * angle.cos(), radius * angle.sin()), dim=1)
    return normals[:, :pixels].reshape(-1, 1, height, width)


def _shifted(word: Tensor, bits: int) -> Tensor:
    """Shift right by `bits` and fill with zeros; torch's shift of int64 copies the sign."""
    return (word >> bits) & ((1 << (64 - bits)) - 1)


def _mix(word: Tensor) -> Tensor:
    """Apply the final mixing of splitmix64; products wrap modulo 2^64."""
    word = (word ^ _shifted(word, 30)) * _MIX_1
    word = (word ^ _shifted(word, 27)) * _MIX_2
    return word ^ _shifted(word, 31)
