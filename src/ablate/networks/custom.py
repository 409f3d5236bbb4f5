"""A network of the user's own, named by a dotted path."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

from torch import Tensor, nn

from ablate.networks.custom_settings import check_taken
from ablate.networks.spec import GeneratorSpec, input_channels
from ablate.user_code import check_dtype, describe_error, load


class CustomNetwork(nn.Module):
    """A user's network, made with its number of input channels and its own settings, which are keyword arguments.

    It keeps the initial weights that it gives itself. A path that leads to no `torch.nn.Module`, settings that the
    class does not take, and a class that cannot be made are ValueErrors. `loaded` gives what the path names.
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
        check_taken(network_class, self.target, spec.settings)
        try:
            self.inner: nn.Module = network_class(channels, **deepcopy(spec.settings))
            check_dtype()
        except (Exception, SystemExit) as error:  # whatever the user's class does
            given = ", ".join([str(channels), *(f"{name}={value!r}" for name, value in spec.settings.items())])
            raise ValueError(f"target={self.target}: {self.target}({given}) fails: {describe_error(error)}") from error

    def forward(self, stacked: Tensor, _maps: Sequence[Tensor | None], _noise: Sequence[Tensor | None]) -> Tensor:
        """Render (N, inputs, H, W) to (N, 1, H, W); H and W are multiples of 2^depth."""
        image = self.inner(stacked)
        allowed = (len(stacked), 1, *stacked.shape[-2:])
        if not isinstance(image, Tensor) or image.shape != allowed:
            returned = tuple(image.shape) if isinstance(image, Tensor) else type(image).__name__
            shape = tuple(stacked.shape)
            raise ValueError(f"target={self.target}: returns {returned} for {shape}, allowed is {allowed}")
        return image
