"""The region of the input that a pixel of the output depends on, measured on the network itself.

The network's own code runs on columns in place of values: each value is the farthest column of the input that it
depends on. A convolution gives the farthest column of its window, a sum the farther one of its two terms, an activation
changes nothing. So no list of layers is needed, and a component that is added later is followed without a change here.
An operation without a rule here is refused, so that no field is wrong in silence.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import reduce
from typing import Any, cast

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ablate.networks.families import PatchDiscriminator
from ablate.networks.generator import Generator
from ablate.networks.spec import Family, GeneratorSpec, conditions, map_channels, rows_of_a_cell

_Pair = tuple[int, int]
_NARROW = 1e-6  # times the paper's channels: the fewest that a network has, as their number does not matter
_PERIODS = (4, 8, 16, 32, 64, 128)  # of a strip, of which one is wide enough for the region to end within it

# Operations of torch by name. Of these two kinds, a value depends on what its terms at the same place depend on.
_SUMS = {"add", "sub", "mul", "div", "addcmul", "lerp", "maximum", "minimum"}
_ACTIVATIONS = {"relu", "leaky_relu", "elu", "gelu", "silu", "softplus", "sigmoid", "tanh", "clamp", "instance_norm"}
# These move columns as they move values; the others tell what does not depend on values, such as a shape.
_MOVES = {"cat", "stack", "chunk", "split", "unbind", "repeat", "expand", "reshape", "view", "flatten", "permute"}
_MOVES |= {"squeeze", "unsqueeze", "contiguous", "clone", "to", "__getitem__", "zeros_like", "pixel_shuffle"}
_DESCRIBES = {"__get__", "__len__", "__repr__", "size", "dim", "is_floating_point"}


def receptive_field(spec: GeneratorSpec, labels: int = 1) -> int | None:
    """Measure the side of the generator's receptive field, px; None for a custom network, whose code is unknown.

    It is that across scanlines; of folded rows it is about twice as many rows.

    The result depends by a few pixels on the position relative to the strides; the largest is returned. The statistics
    of instance norm, which are global, and the border of the image are not counted. A network with an operation that
    cannot be followed is a ValueError.
    """
    if spec.family is Family.custom:
        return None
    with torch.random.fork_rng():  # of the weights only the sizes are read
        generator = Generator(replace(spec, width=_NARROW), labels)
    period = 2**spec.depth

    def render(columns: Tensor) -> Tensor:
        strip = columns.expand(1, 1, period * rows_of_a_cell(spec), -1)
        maps = {name: strip.expand(1, map_channels(name, labels), -1, -1) for name in conditions(spec)}
        return generator.render(maps, {})

    return _side(render, period, stride=1)


def patch_size(discriminator: PatchDiscriminator) -> int:
    """Measure the side of the patch that one output of the discriminator depends on, px."""
    channels = discriminator.first.in_channels - 1

    def judge(columns: Tensor) -> Tensor:
        image = columns.expand(1, 1, 64, -1)
        return cast(Tensor, discriminator(image.expand(1, channels, -1, -1), image))

    return _side(judge, period=8, stride=8)


def _side(network: Callable[[Tensor], Tensor], period: int, stride: int) -> int:
    """Measure the most columns that one output of a network depends on.

    Parameters
    ----------
    network : callable
        Takes the columns of its input, (W,), and returns the farthest ones, (1, 1, h, about W / stride).
    period : int
        The shift of the input, px, that only shifts the output.
    stride : int
        Pixels of the input from one output to the next.

    Returns
    -------
    int
        The largest of one period of outputs, px.

    Raises
    ------
    ValueError
        If the network has an operation that cannot be followed, or depends on all columns.
    """
    outputs = period // stride
    shift = torch.full((outputs,), float(period))
    for periods in _PERIODS:
        columns = torch.arange(1.0, periods * period + 1)
        last = _farthest(network, columns)
        first = _farthest(network, columns.flip(0))  # counted from the right border
        # Outputs that do not reach the far border depend on columns one period further than those a period before.
        ends = last[:outputs]
        starts = first[-outputs:]
        ends_are_inside = torch.equal(last[outputs : 2 * outputs] - ends, shift)
        starts_are_inside = torch.equal(first[-2 * outputs : -outputs] - starts, shift)
        if ends_are_inside and starts_are_inside:
            between = (len(last) - outputs) * stride  # from the outputs at the left border to those at the right one
            return int((ends + starts - len(columns) + between).max())
    raise ValueError(f"the receptive field is larger than {columns.numel() // 2} px")


def _farthest(network: Callable[[Tensor], Tensor], columns: Tensor) -> Tensor:
    """Run a network on columns; returns what each output of its middle row depends on, (outputs,)."""
    with torch.no_grad():
        reached = network(columns.as_subclass(_Columns)).as_subclass(Tensor)
    return reached[0, 0, reached.shape[2] // 2]


class _Columns(Tensor):
    """The farthest column that each value depends on, counted from 1; 0 is none."""

    @classmethod
    def __torch_function__(
        cls, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: dict[str, Any] | None = None
    ) -> Any:
        """Follow an operation by its rule."""
        name = func.__name__
        if name in _SUMS | _ACTIVATIONS:
            return _farther(args).as_subclass(cls)
        if name in _WINDOWED:
            columns, *others = args
            return _WINDOWED[name](columns.as_subclass(Tensor), *others, **kwargs or {}).as_subclass(cls)
        if name in _MOVES | _DESCRIBES:
            return super().__torch_function__(func, types, args, kwargs or {})
        raise ValueError(f"the receptive field of a network with {name} is unknown: it has no rule in {__name__}")


def _farther(terms: tuple[Any, ...]) -> Tensor:
    """Follow an operation on values at the same place; weights and numbers among its terms depend on no column."""
    shape = np.broadcast_shapes(*(term.shape for term in terms if isinstance(term, Tensor)))
    columns = [term.as_subclass(Tensor) for term in terms if isinstance(term, _Columns)]
    return reduce(torch.maximum, columns).expand(shape)


def _convolution(
    columns: Tensor,
    weight: Tensor,
    _bias: Tensor | None = None,
    stride: _Pair = (1, 1),
    padding: _Pair = (0, 0),
    dilation: _Pair = (1, 1),
    _groups: int = 1,
) -> Tensor:
    """Follow `torch.conv2d`: the farthest column of each window, of all channels."""
    channels, _, *kernel = weight.shape
    rows, lines = padding
    padded = F.pad(columns.amax(1, keepdim=True), (lines, lines, rows, rows))
    return torch.max_pool2d(padded, kernel, stride, 0, dilation).expand(-1, channels, -1, -1)


def _transposed_convolution(
    columns: Tensor,
    weight: Tensor,
    _bias: Tensor | None = None,
    stride: _Pair = (1, 1),
    padding: _Pair = (0, 0),
    output_padding: _Pair = (0, 0),
) -> Tensor:
    """Follow `torch.conv_transpose2d`: a convolution of its input with zeros between the pixels."""
    batch, _, height, width = columns.shape
    rows, lines = stride
    spread = columns.new_zeros(batch, 1, (height - 1) * rows + 1, (width - 1) * lines + 1)
    spread[..., ::rows, ::lines] = columns.amax(1, keepdim=True)
    _, channels, *kernel = weight.shape
    before = [size - 1 - cut for size, cut in zip(kernel, padding, strict=True)]
    after = [size + more for size, more in zip(before, output_padding, strict=True)]
    padded = F.pad(spread, (before[1], after[1], before[0], after[0]))
    return torch.max_pool2d(padded, kernel, 1).expand(-1, channels, -1, -1)


def _pooled(columns: Tensor, kernel: int) -> Tensor:
    """Follow `F.avg_pool2d`."""
    return torch.max_pool2d(columns, kernel)


_WINDOWED: dict[str, Callable[..., Tensor]] = {
    "conv2d": _convolution,
    "conv_transpose2d": _transposed_convolution,
    "avg_pool2d": _pooled,
}
