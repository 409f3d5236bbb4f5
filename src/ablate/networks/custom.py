"""A network of the user's as a generator: its class is named by a dotted path."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.parameter import UninitializedParameter

from ablate.networks.spec import GeneratorSpec, inputs
from ablate.user_code import in_one_line, load


class CustomNetwork(nn.Module):
    """A user's network, made with its number of input channels. It keeps the initial weights that it gives itself.

    A path that leads to no `torch.nn.Module`, or to a class that cannot be made, is a ValueError.
    """

    def __init__(self, spec: GeneratorSpec) -> None:
        super().__init__()
        self.target, channels = str(spec.target), len(inputs(spec))
        try:
            network_class = load(self.target)
        except ValueError as error:
            allowed = "the path of a class, as my_package.MyGenerator"
            raise ValueError(f"target={self.target}: {error}; allowed is {allowed}") from error
        if not (isinstance(network_class, type) and issubclass(network_class, nn.Module)):
            raise ValueError(f"target={self.target}: is no class of torch.nn.Module")
        try:
            self.inner: nn.Module = network_class(channels)
        except (Exception, SystemExit) as error:  # whatever the user's class does
            raise ValueError(f"target={self.target}: {self.target}({channels}) fails: {in_one_line(error)}") from error

    def forward(self, stacked: Tensor, _maps: Sequence[Tensor | None], _noise: Sequence[Tensor | None]) -> Tensor:
        """Render (N, inputs, H, W) to (N, 1, H, W); H and W are multiples of 2^depth."""
        image = self.inner(stacked)
        allowed = (len(stacked), 1, *stacked.shape[-2:])
        if not isinstance(image, Tensor) or image.shape != allowed:
            returned = tuple(image.shape) if isinstance(image, Tensor) else type(image).__name__
            shape = tuple(stacked.shape)
            raise ValueError(f"target={self.target}: returns {returned} for {shape}, allowed is {allowed}")
        return image


def check_custom(spec: GeneratorSpec, side: int) -> None:
    """Try a training step on two images of `side` px; a ValueError names the class and what is wrong."""
    network = CustomNetwork(spec)
    if any(isinstance(parameter, UninitializedParameter) for parameter in network.parameters()):
        raise ValueError(f"target={spec.target}: has parameters without a size (lazy layers); give them one")
    if not any(parameter.requires_grad for parameter in network.parameters()):
        raise ValueError(f"target={spec.target}: has no parameter to train")
    side += -side % 2**spec.depth
    maps = torch.rand(2, len(inputs(spec)), side, side, generator=torch.Generator().manual_seed(0)) * 2 - 1
    try:
        image = network(maps, [], [])
        wrong = _wrong_with(image)
        if not wrong:
            image.mean().backward()
            wrong = _wrong_with(network.eval()(maps, [], []))  # as it renders once it is trained
    except ValueError:
        raise
    except (Exception, SystemExit) as error:  # whatever the user's class does
        raise ValueError(
            f"target={spec.target}: two images of {side} x {side} px fail: {in_one_line(error)}"
        ) from error
    if wrong:
        raise ValueError(f"target={spec.target}: returns {wrong}, allowed are float32 numbers in [-1, 1]")


def _wrong_with(image: Tensor) -> str:
    if image.dtype != torch.float32:
        return str(image.dtype)
    if not image.requires_grad:
        return "an image that does not depend on its parameters"
    return "" if bool(image.isfinite().all()) else "numbers that are not finite"
