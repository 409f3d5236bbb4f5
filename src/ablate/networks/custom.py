"""A network of the user's own, named by a dotted path."""

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torch.nn.parameter import UninitializedParameter

from ablate.networks.spec import GeneratorSpec, input_channels
from ablate.user_code import describe_error, load


class CustomNetwork(nn.Module):
    """A user's network, made with its number of input channels. It keeps the initial weights that it gives itself.

    A path that leads to no `torch.nn.Module`, or to a class that cannot be made, is a ValueError.
    """

    def __init__(self, spec: GeneratorSpec, labels: int = 1) -> None:
        super().__init__()
        self.target = str(spec.target)
        channels = input_channels(spec, labels)
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
            raise ValueError(
                f"target={self.target}: {self.target}({channels}) fails: {describe_error(error)}"
            ) from error

    def forward(self, stacked: Tensor, _maps: Sequence[Tensor | None], _noise: Sequence[Tensor | None]) -> Tensor:
        """Render (N, inputs, H, W) to (N, 1, H, W); H and W are multiples of 2^depth."""
        image = self.inner(stacked)
        allowed = (len(stacked), 1, *stacked.shape[-2:])
        if not isinstance(image, Tensor) or image.shape != allowed:
            returned = tuple(image.shape) if isinstance(image, Tensor) else type(image).__name__
            shape = tuple(stacked.shape)
            raise ValueError(f"target={self.target}: returns {returned} for {shape}, allowed is {allowed}")
        return image


def check_custom(spec: GeneratorSpec, side: int, labels: int = 1) -> None:
    """Try a training step on two images of `side` px; a ValueError names the class and what is wrong."""
    network = CustomNetwork(spec, labels)
    if any(isinstance(parameter, UninitializedParameter) for parameter in network.parameters()):
        raise ValueError(f"target={spec.target}: has parameters without a size (lazy layers); give them one")
    if not any(parameter.requires_grad for parameter in network.parameters()):
        raise ValueError(f"target={spec.target}: has no parameter to train")
    side += -side % 2**spec.depth
    random = torch.Generator().manual_seed(0)
    maps = torch.rand(2, input_channels(spec, labels), side, side, generator=random) * 2 - 1
    try:
        image = network(maps, [], [])
        fault = _fault_of(image)
        if not fault:
            image.mean().backward()
            network.eval()  # as it renders once it is trained
            once = network(maps, [], [])
            again = network(maps, [], [])
            fault = _fault_of(once) or _fault_of(again)
            if not fault and not torch.allclose(once, again, atol=0.01):
                raise ValueError(
                    f"target={spec.target}: renders the same maps differently each time, so that no seed decides an "
                    "image; allowed is noise that it reads, as its last channel (model.noise=input)"
                )
    except ValueError:
        raise
    except (Exception, SystemExit) as error:  # whatever the user's class does
        images = f"two images of {side} x {side} px"
        raise ValueError(f"target={spec.target}: {images} fail: {describe_error(error)}") from error
    if fault:
        raise ValueError(f"target={spec.target}: returns {fault}, allowed are float32 numbers in [-1, 1]")


def _fault_of(image: Tensor) -> str:
    if image.dtype != torch.float32:
        return str(image.dtype)
    if not image.requires_grad:
        return "an image that does not depend on its parameters"
    return "" if bool(image.isfinite().all()) else "numbers that are not finite"
