"""What a generator is made of: the components that an ablation switches, as values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

MIN_DEPTH, MAX_DEPTH = 2, 8


class Family(StrEnum):
    """Local generator of the paper (SA2H), or the U-Net of pix2pix (LSA2H, NSA2H)."""

    local = "local"
    unet = "unet"


class Attenuation(StrEnum):
    """Whether the integral attenuation map is an input."""

    integral = "integral"
    none = "none"


class Concat(StrEnum):
    """Where segmentation and attenuation enter: before every convolution, or before the first only."""

    every_level = "every_level"
    input = "input"


class Upsampling(StrEnum):
    """Up block: transposed 3x3 and a stride-1 3x3 convolution, or one transposed 4x4 convolution."""

    texture = "texture"
    transposed = "transposed"


class Noise(StrEnum):
    """Gaussian noise: added to the decoder's features, as an input channel, or absent."""

    inject = "inject"
    input = "input"
    none = "none"


class ExtraInput(StrEnum):
    """A further input channel: the low-quality image, or noise in its place."""

    none = "none"
    low = "low"
    noise = "noise"


_ENUMS = {
    "family": Family,
    "attenuation": Attenuation,
    "concat": Concat,
    "upsampling": Upsampling,
    "noise": Noise,
    "extra_input": ExtraInput,
}


@dataclass(frozen=True)
class GeneratorSpec:
    """A generator, named by its components; the defaults are the paper's full SA2H.

    Plain strings are accepted for the enums. The U-Net exists with `concat=input`,
    `upsampling=transposed` and without injected noise only: anything else is refused, so that no
    two specifications name the same network.

    Attributes
    ----------
    family, attenuation, concat, upsampling, noise, extra_input : StrEnum
        The components.
    depth : int
        Number of down-sampling blocks, 2 to 8: the receptive field.
    width : float
        Multiplier of every channel count; 1 is the paper's.
    noise_start : float
        Initial weight of injected noise, every channel; the paper starts it at zero.

    Raises
    ------
    ValueError
        Where a value, or a combination of values, is none of those allowed.
    """

    family: Family = Family.local
    attenuation: Attenuation = Attenuation.integral
    concat: Concat = Concat.every_level
    upsampling: Upsampling = Upsampling.texture
    noise: Noise = Noise.inject
    depth: int = 4
    extra_input: ExtraInput = ExtraInput.none
    width: float = 1.0
    noise_start: float = 0.0

    def __post_init__(self) -> None:
        for name, enum in _ENUMS.items():
            value = getattr(self, name)
            try:
                object.__setattr__(self, name, enum(value))
            except ValueError:
                raise ValueError(f"{name}={value!r}: allowed are {', '.join(enum)}") from None
        if isinstance(self.depth, bool) or self.depth != int(self.depth):
            raise ValueError(f"depth={self.depth!r}: allowed are whole numbers")
        object.__setattr__(self, "depth", int(self.depth))
        if not MIN_DEPTH <= self.depth <= MAX_DEPTH:
            raise ValueError(f"depth={self.depth}: allowed are {MIN_DEPTH} to {MAX_DEPTH}")
        if not (math.isfinite(self.width) and self.width > 0):
            raise ValueError(f"width={self.width!r}: allowed are finite numbers above 0")
        if not math.isfinite(self.noise_start):
            raise ValueError(f"noise_start={self.noise_start!r}: allowed are finite numbers")
        self._refuse_contradictions()

    def _refuse_contradictions(self) -> None:
        if self.family is Family.unet:
            if self.concat is not Concat.input:
                raise ValueError(f"concat={self.concat} with family=unet: allowed is concat=input")
            if self.upsampling is not Upsampling.transposed:
                raise ValueError(f"upsampling={self.upsampling} with family=unet: allowed is upsampling=transposed")
            if self.noise is Noise.inject:
                raise ValueError("noise=inject with family=unet: allowed are noise=none, noise=input")
        if self.noise is Noise.input and self.extra_input is ExtraInput.noise:
            raise ValueError("extra_input=noise with noise=input: allowed is one noise channel, drop either")
        if self.noise is not Noise.inject and self.noise_start != 0:
            raise ValueError(
                f"noise_start={self.noise_start} with noise={self.noise}: allowed is 0, nothing is injected"
            )


def conditions(spec: GeneratorSpec) -> tuple[str, ...]:
    """Name the maps of a pair that the generator reads, in the order of its input channels.

    These are also what the discriminator is conditioned on, and what a dataset has to provide.
    """
    names = ["segmentation"]
    if spec.attenuation is Attenuation.integral:
        names.append("attenuation")
    if spec.extra_input is ExtraInput.low:
        names.append("low")
    return tuple(names)


def inputs(spec: GeneratorSpec) -> tuple[str, ...]:
    """Name the input channels of the generator: its conditions, then "noise" where noise is a channel."""
    has_noise = spec.noise is Noise.input or spec.extra_input is ExtraInput.noise
    return (*conditions(spec), "noise") if has_noise else conditions(spec)


def draws_noise(spec: GeneratorSpec) -> bool:
    """Whether two draws of noise can give two images: noise is a channel or is injected."""
    return spec.noise is Noise.inject or "noise" in inputs(spec)


def scaled(channels: int, width: float) -> int:
    """Scale a channel count by the width multiplier, rounded, at least 4."""
    return max(4, round(channels * width))
