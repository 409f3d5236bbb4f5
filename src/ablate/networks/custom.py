"""A network of the user's own, named by a dotted path."""

from collections.abc import Callable, Sequence
from typing import Any

from torch import Tensor, nn

from ablate.networks.spec import GeneratorSpec, input_channels
from ablate.user_code import describe_error, load


class CustomNetwork(nn.Module):
    """A user's network, made with its number of input channels. It keeps the initial weights that it gives itself.

    A path that leads to no `torch.nn.Module`, or to a class that cannot be made, is a ValueError. `loaded` gives what
    the path names.
    """

    def __init__(self, spec: GeneratorSpec, labels: int = 1, loaded: Callable[[str], Any] = load) -> None:
        super().__init__()
        self.target = str(spec.target)
        channels = input_channels(spec, labels)
        try:
            network_class = loaded(self.target)
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
