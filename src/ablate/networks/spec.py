"""A generator as values: the components that an ablation switches, and the input channels that follow from them."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from ablate.setting import Checked, setting

DEPTHS = range(1, 9)


class Family(StrEnum):
    """The paper's local generator (SA2H), the U-Net of pix2pix (LSA2H, NSA2H), or a network of the user's."""

    local = "local"
    unet = "unet"
    custom = "custom"


class Space(StrEnum):
    """Where the network works: on the pixels of the image, or in beam space, before scan conversion.

    In beam space rows are depths and columns are scanlines, so a crop tells the direction of the beam, every value lies
    in the fan, and shadows are columns.
    """

    image = "image"
    beam = "beam"


class Position(StrEnum):
    """Further maps that say where a value lies: none, its depth, or its depth and the place of its scanline."""

    none = "none"
    depth = "depth"
    beam = "beam"


class Interfaces(StrEnum):
    """Whether the interface map is an input: what surfaces return, also by way of one another."""

    none = "none"
    echo = "echo"


class Grain(StrEnum):
    """What follows the finest noise: the output convolution alone, or a refining 3x3 convolution before it."""

    output = "output"
    refine = "refine"


class Fold(StrEnum):
    """Whether the finest level has every row, or pairs of rows as one with twice the channels: half the work.

    Rows of beam space are three to a pulse, so two of them lie in one resolution cell.
    """

    none = "none"
    rows = "rows"


class Attenuation(StrEnum):
    """Which map of attenuation is an input: the integral one, the one compensated for the time gain, or none.

    `illumination` is more than the paper's: it also knows what surfaces keep from the tissue behind them, and that a
    shadow is soft, because many elements see a point. `compound` is the mean of the integral maps of all angles that
    frames are compounded of.
    """

    integral = "integral"
    compensated = "compensated"
    illumination = "illumination"
    compound = "compound"
    none = "none"


class Concat(StrEnum):
    """Which convolutions read segmentation and attenuation: every one, or the first only."""

    every_level = "every_level"
    input = "input"


class Upsampling(StrEnum):
    """The up block: a transposed 3x3 and a stride-1 3x3 convolution, or one transposed 4x4 convolution."""

    texture = "texture"
    transposed = "transposed"


class Noise(StrEnum):
    """Where random texture comes from.

    `inject`: Gaussian noise by pixel in the features of the decoder; `input`: in an input channel. Both stick to the
    screen. `body`: the lattice of the simulator's scatterers, a map that every convolution of the local network reads,
    so that speckle moves with the anatomy; it is defined in beam space alone.
    """

    inject = "inject"
    input = "input"
    body = "body"
    none = "none"


class ExtraInput(StrEnum):
    """A further input channel, as of the paper's U-Nets: the low-quality image, or noise in its place."""

    none = "none"
    low = "low"
    noise = "noise"


@dataclass(frozen=True)
class GeneratorSpec(Checked):
    """A generator, named by its components; the defaults are the paper's full model SA2H.

    Enums may be given as plain strings. The U-Net and a custom network allow only `concat=input`,
    `upsampling=transposed` and noise that is not injected.

    A value, or a combination of values, that is not allowed is a ValueError that names it and what is allowed.
    """

    family: Family = setting(Family.local, "Architecture.")
    space: Space = setting(Space.image, "Where the network works: on the image or in beam space.")
    position: Position = setting(Position.none, "Which maps of position are inputs.")
    interfaces: Interfaces = setting(Interfaces.none, "Whether the interface map is an input.")
    fold: Fold = setting(Fold.none, "Whether pairs of rows are one row of the finest level.")
    grain: Grain = setting(Grain.output, "What follows the finest noise.")
    attenuation: Attenuation = setting(Attenuation.integral, "Which attenuation map is an input.")
    concat: Concat = setting(Concat.every_level, "Which convolutions read segmentation and attenuation.")
    upsampling: Upsampling = setting(Upsampling.texture, "The up block.")
    noise: Noise = setting(Noise.inject, "Where random texture comes from; `body` with `space=beam`.")
    depth: int = setting(
        4,
        "Levels; the receptive field doubles with each. With `family=custom`, sides are multiples of 2^depth.",
        least=DEPTHS[0],
        most=DEPTHS[-1],
    )
    extra_input: ExtraInput = setting(ExtraInput.none, "A further input channel.")
    width: float = setting(1.0, "Multiplier of every channel count; 1 is the paper's.", above=0)
    noise_start: float = setting(0.0, "Initial weight of injected noise; the paper's is zero.", least=-1000, most=1000)
    target: str | None = setting(
        None, "With `family=custom`, the dotted path of the network's class, as `my_package.MyGenerator`."
    )
    settings: dict[str, Any] = setting(
        {}, "With `family=custom`, what the class is made with besides its channels, as `model.settings.hidden=32`."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.family is Family.unet and self.depth < 2:
            raise ValueError(f"depth={self.depth} with family=unet: allowed are 2 to {DEPTHS[-1]}")
        if self.family is not Family.local:
            self._check_without_local_components()
        if self.family is Family.custom and self.fold is not Fold.none:
            raise ValueError(
                f"fold={self.fold} with family=custom: a network of your own folds for itself, allowed is none"
            )
        if (self.family is Family.custom) != (self.target is not None):
            allowed = "the path of a class, as my_package.MyGenerator" if self.family is Family.custom else "null"
            raise ValueError(f"target={self.target} with family={self.family}: allowed is {allowed}")
        if self.settings and self.family is not Family.custom:
            name, value = next(iter(self.settings.items()))
            reason = "it has no settings of its own, as a network of yours may have (variant=custom)"
            raise ValueError(f"settings.{name}={value} with family={self.family}: {reason}")
        if self.noise is Noise.input and self.extra_input is ExtraInput.noise:
            raise ValueError("extra_input=noise with noise=input: allowed is one noise channel, drop either")
        if self.noise is Noise.body and self.space is not Space.beam:
            raise ValueError(
                f"noise=body with space={self.space}: the scatterers are known on the scanlines, allowed is space=beam"
            )
        if self.noise is not Noise.inject and self.noise_start != 0:
            raise ValueError(
                f"noise_start={self.noise_start} with noise={self.noise}: nothing is injected, allowed is 0"
            )

    def _check_without_local_components(self) -> None:
        family = f"with family={self.family}"
        for name, allowed in _WITHOUT_LOCAL_COMPONENTS.items():
            value = getattr(self, name)
            if value != allowed:
                raise ValueError(f"{name}={value} {family}: allowed is {name}={allowed}")
        if self.noise is Noise.inject:
            raise ValueError(f"noise=inject {family}: allowed are noise=none, noise=input, noise=body")


# What a U-Net and a custom network have in place of the local network's components.
_WITHOUT_LOCAL_COMPONENTS = {"concat": "input", "upsampling": "transposed", "grain": "output"}
_POSITION_MAPS = {Position.none: (), Position.depth: ("depth",), Position.beam: ("depth", "lateral")}
_ATTENUATION_MAPS = {
    Attenuation.integral: ("attenuation",),
    Attenuation.compensated: ("compensated",),
    Attenuation.illumination: ("illumination",),
    Attenuation.compound: ("compound",),
    Attenuation.none: (),
}
#: Maps of the surfaces on each scanline, which the simulator makes and nobody can derive from S and A.
OF_SURFACES = frozenset({"interfaces", "illumination"})
#: The mean attenuation map of all angles, which only the simulator makes either.
COMPOUND = "compound"
#: Maps of position, which follow from the probe alone and are the same in all frames.
OF_POSITION = frozenset(_POSITION_MAPS[Position.beam])
#: The lattice of scatterers: real and imaginary parts of both values of a row, of the pose and a seed.
GRAIN = "grain"
GRAIN_CHANNELS = 4
#: Maps that are not stored, because a pose and a probe tell them.
NOT_STORED = OF_POSITION | {GRAIN}


def conditions(spec: GeneratorSpec) -> tuple[str, ...]:
    """Name the maps of a pair that the generator reads, in the order of its input channels.

    These are also what a dataset has to provide; `map_channels` counts the channels of each.
    """
    names = ["segmentation", *_ATTENUATION_MAPS[spec.attenuation]]
    if spec.interfaces is Interfaces.echo:
        names.append("interfaces")
    names += _POSITION_MAPS[spec.position]
    if spec.noise is Noise.body:
        names.append(GRAIN)
    if spec.extra_input is ExtraInput.low:
        names.append("low")
    return tuple(names)


def judged(spec: GeneratorSpec) -> tuple[str, ...]:
    """Name the maps that the discriminator is conditioned on: all that the generator reads but its random texture."""
    return tuple(name for name in conditions(spec) if name != GRAIN)


def map_channels(name: str, labels: int = 1) -> int:
    """Count the channels of a map; `labels` are those of the segmentation, by how a data set encodes its labels."""
    return {"segmentation": labels, GRAIN: GRAIN_CHANNELS}.get(name, 1)


def rows_of_a_cell(spec: GeneratorSpec) -> int:
    """Count the rows of a frame that are one row of the finest level, and so the channels of the output."""
    return 2 if spec.fold is Fold.rows else 1


def fed_channels(spec: GeneratorSpec, labels: int = 1) -> slice:
    """Which of the input channels every convolution of the local network reads; an empty slice where none.

    `concat` decides over the maps of the anatomy. The grain is fed at every resolution whatever it says, as noise that
    is injected is. `labels` is as for `map_channels`; of folded rows each channel counts twice.
    """
    if spec.family is not Family.local:
        return slice(0, 0)
    names = [name for name in conditions(spec) if name != "low"]
    each = rows_of_a_cell(spec)
    end = each * sum(map_channels(name, labels) for name in names)
    if spec.concat is Concat.every_level:
        return slice(0, end)
    return slice(end - each * GRAIN_CHANNELS, end) if GRAIN in names else slice(0, 0)


def inputs(spec: GeneratorSpec) -> tuple[str, ...]:
    """Name the inputs of the generator: its conditions, then "noise" where noise is a channel."""
    has_noise = spec.noise is Noise.input or spec.extra_input is ExtraInput.noise
    return (*conditions(spec), "noise") if has_noise else conditions(spec)


def input_channels(spec: GeneratorSpec, labels: int = 1) -> int:
    """Count the channels of the network's first convolution; `labels` of them are the segmentation."""
    return rows_of_a_cell(spec) * sum(map_channels(name, labels) for name in inputs(spec))


def draws_noise(spec: GeneratorSpec) -> bool:
    """Whether two draws of noise can give two images: noise is a channel or is injected."""
    return spec.noise is Noise.inject or "noise" in inputs(spec)


def scaled(channels: int, width: float) -> int:
    """Scale a channel count by the width multiplier, rounded, at least 4."""
    return max(4, round(channels * width))
