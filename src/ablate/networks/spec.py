"""A generator as values: the components that an ablation switches, and the input channels that follow from them."""

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from ablate.validation import coerce_enums

DEPTHS = range(1, 9)


class Family(StrEnum):
    """The paper's local generator (SA2H), the U-Net of pix2pix (LSA2H, NSA2H), or a network of the user's."""

    local = "local"
    unet = "unet"
    custom = "custom"


class Attenuation(StrEnum):
    """Which attenuation map is an input: the integral one, the one compensated for the time gain, or none."""

    integral = "integral"
    compensated = "compensated"
    none = "none"


class Concat(StrEnum):
    """Which convolutions read segmentation and attenuation: every one, or the first only."""

    every_level = "every_level"
    input = "input"


class Upsampling(StrEnum):
    """The up block: a transposed 3x3 and a stride-1 3x3 convolution, or one transposed 4x4 convolution.

    `resize` is `texture` with nearest neighbour and a stride-1 3x3 convolution in place of the transposed one.
    """

    texture = "texture"
    transposed = "transposed"
    resize = "resize"


class Noise(StrEnum):
    """Where Gaussian noise enters: the features of the decoder, an input channel, or nowhere."""

    inject = "inject"
    input = "input"
    none = "none"


class ExtraInput(StrEnum):
    """A further input channel of the U-Nets: the low-quality image, or noise in its place."""

    none = "none"
    low = "low"
    noise = "noise"


@dataclass(frozen=True)
class GeneratorSpec:
    """A generator, named by its components; the defaults are the paper's full model SA2H.

    Enums may be given as plain strings. The U-Net and a custom network allow only `concat=input`,
    `upsampling=transposed` and noise that is not injected, so that no two specifications name the same network.

    Attributes
    ----------
    attenuation, concat, upsampling, noise, depth
        The components; `COMPONENTS` says what each is for.
    width : float
        Multiplier of every channel count; 1 is the paper's.
    noise_start : float
        Initial weight of injected noise in every channel; the paper starts at zero.
    target : str or None
        With `family=custom`, the dotted path of the class of the network, as `my_package.MyGenerator`. Its images have
        sides that are multiples of 2^depth; `width` is not passed on.

    Raises
    ------
    ValueError
        For a value, or a combination of values, that is not allowed.
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
    target: str | None = None

    def __post_init__(self) -> None:
        coerce_enums(self)
        if isinstance(self.depth, bool) or self.depth != int(self.depth):
            raise ValueError(f"depth={self.depth!r}: allowed are whole numbers")
        object.__setattr__(self, "depth", int(self.depth))
        if self.depth not in DEPTHS:
            raise ValueError(f"depth={self.depth}: allowed are {DEPTHS[0]} to {DEPTHS[-1]}")
        if not (math.isfinite(self.width) and self.width > 0):
            raise ValueError(f"width={self.width!r}: allowed are finite numbers above 0")
        if not math.isfinite(self.noise_start):
            raise ValueError(f"noise_start={self.noise_start!r}: allowed are finite numbers")
        if self.family is Family.unet and self.depth < 2:
            raise ValueError(f"depth={self.depth} with family=unet: allowed are 2 to {DEPTHS[-1]}")
        if self.family is not Family.local:
            of = f"with family={self.family}"
            if self.concat is not Concat.input:
                raise ValueError(f"concat={self.concat} {of}: allowed is concat=input")
            if self.upsampling is not Upsampling.transposed:
                raise ValueError(f"upsampling={self.upsampling} {of}: allowed is upsampling=transposed")
            if self.noise is Noise.inject:
                raise ValueError(f"noise=inject {of}: allowed are noise=none, noise=input")
        if (self.family is Family.custom) != (self.target is not None):
            allowed = "the path of a class, as my_package.MyGenerator" if self.family is Family.custom else "null"
            raise ValueError(f"target={self.target} with family={self.family}: allowed is {allowed}")
        if self.noise is Noise.input and self.extra_input is ExtraInput.noise:
            raise ValueError("extra_input=noise with noise=input: allowed is one noise channel, drop either")
        if self.noise is not Noise.inject and self.noise_start != 0:
            raise ValueError(
                f"noise_start={self.noise_start} with noise={self.noise}: allowed is 0, nothing is injected"
            )


@dataclass(frozen=True)
class Component:
    """One switch of the study.

    Attributes
    ----------
    name : str
        The variant without this component is `sa2h-<name>`.
    field : str
        Its key in `GeneratorSpec`, in stored configurations and in the table of effects.
    on, off
        The level of the full model SA2H, and the level that stands for "without the component".
    metric : str, optional
        Name of the metric that measures whether the component does what it is for; None where no metric does.
    """

    name: str
    field: str
    levels: tuple[Any, ...]
    on: Any
    off: Any
    label: str
    metric: str | None
    purpose: str


_FULL = GeneratorSpec()
# fmt: off
COMPONENTS = (
    Component(
        "att", "attenuation", tuple(Attenuation), _FULL.attenuation, Attenuation.none,
        "attenuation map", "shadow_contrast",
        "The integral attenuation map tells the generator where shadows and enhancement lie.",
    ),
    Component(
        "concat", "concat", tuple(Concat), _FULL.concat, Concat.input,
        "maps at every level", "thin_contrast",
        "Segmentation and attenuation at every convolution keep structures where the maps have them.",
    ),
    Component(
        "conv", "upsampling", tuple(Upsampling), _FULL.upsampling, Upsampling.transposed,
        "texture-friendly up-sampling", "nyquist_excess",
        "A stride-1 convolution after each transposed one removes the checkerboard pattern of up-sampling.",
    ),
    Component(
        "noise", "noise", tuple(Noise), _FULL.noise, Noise.input,
        "noise at every resolution", "crps",
        "Noise injected at every resolution of the decoder gives speckle a random source.",
    ),
    Component(
        "depth", "depth", tuple(DEPTHS), _FULL.depth, DEPTHS[-1],
        "small receptive field", "mae_smooth",
        "Few levels keep the receptive field small, so the network learns no layout of whole frames.",
    ),
    Component(  # an option of the data set: in which order the labels become grey levels of the segmentation
        "encoding", "encoding", ("echogenicity", "arbitrary"), "echogenicity", "arbitrary",
        "order of the labels", "mae_smooth",
        "Labels ordered from dark to bright tell the generator how bright each tissue is.",
    ),
)
# fmt: on


_ATTENUATION_MAPS: dict[Attenuation, tuple[str, ...]] = {
    Attenuation.integral: ("attenuation",),
    Attenuation.compensated: ("compensated",),
    Attenuation.none: (),
}


def conditions(spec: GeneratorSpec) -> tuple[str, ...]:
    """Name the maps of a pair that the generator reads, in the order of its input channels.

    These are also what the discriminator is conditioned on, and what a dataset has to provide.
    """
    low = ("low",) if spec.extra_input is ExtraInput.low else ()
    return ("segmentation", *_ATTENUATION_MAPS[spec.attenuation], *low)


def maps_of_every_level(spec: GeneratorSpec) -> tuple[str, ...]:
    """Name the conditions that every convolution reads, the first ones of all; none where the maps enter only once."""
    return () if spec.concat is Concat.input else tuple(name for name in conditions(spec) if name != "low")


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
