"""A network of the user's as a generator: its class is named by a dotted path."""

import hashlib
import inspect
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import torch
from torch import Tensor, nn

from ablate.networks.spec import GeneratorSpec, inputs


class CustomNetwork(nn.Module):
    """A user's network, made with its number of input channels. It keeps the initial weights that it gives itself.

    Raises
    ------
    ValueError
        Where the path leads to no `torch.nn.Module`, or the class cannot be made.
    """

    def __init__(self, spec: GeneratorSpec) -> None:
        super().__init__()
        self.target = str(spec.target)
        made = custom_class(self.target)
        channels = len(inputs(spec))
        try:
            self.inner: nn.Module = made(channels)
        except Exception as error:  # whatever the user's class does
            raise ValueError(f"target={self.target}: {self.target}({channels}) fails: {_said(error)}") from error

    def forward(self, stacked: Tensor, _maps: Sequence[Tensor | None], _noise: Sequence[Tensor | None]) -> Tensor:
        """Render (N, inputs, H, W) to (N, 1, H, W); H and W are multiples of 2^depth."""
        image = self.inner(stacked)
        wanted = (len(stacked), 1, *stacked.shape[-2:])
        if not isinstance(image, Tensor) or image.shape != wanted:
            found = tuple(image.shape) if isinstance(image, Tensor) else type(image).__name__
            raise ValueError(f"target={self.target}: returns {found} for {tuple(stacked.shape)}, allowed is {wanted}")
        return image


def custom_class(path: str) -> type[nn.Module]:
    """Import the class of a dotted path; a ValueError names the path and what is wrong."""
    module, _, name = path.rpartition(".")
    if not module:
        raise ValueError(f"target={path}: allowed is the path of a class, as my_package.MyGenerator")
    try:
        found = getattr(import_module(module), name)
    except Exception as error:  # whatever the user's module does
        raise ValueError(f"target={path}: {_said(error)}; allowed is the path of a class") from error
    if not (isinstance(found, type) and issubclass(found, nn.Module)):
        raise ValueError(f"target={path}: is no class of torch.nn.Module")
    return found


def custom_source(path: str) -> str:
    """SHA-256 of the file that defines a class, so that a run is known by the code of its network."""
    file = inspect.getsourcefile(custom_class(path))
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""


def check_custom(spec: GeneratorSpec, side: int) -> None:
    """Render one image of `side` px with untrained weights; a ValueError names the class and what is wrong."""
    network = CustomNetwork(spec)
    side += -side % 2**spec.depth
    try:
        with torch.no_grad():
            image = network(torch.zeros(1, len(inputs(spec)), side, side), [], [])
    except ValueError:
        raise
    except Exception as error:  # whatever the user's class does
        raise ValueError(f"target={spec.target}: an image of {side} x {side} px fails: {_said(error)}") from error
    if not image.is_floating_point():
        raise ValueError(f"target={spec.target}: returns {image.dtype}, allowed are floating-point numbers in [-1, 1]")
    if not any(parameter.requires_grad for parameter in network.parameters()):
        raise ValueError(f"target={spec.target}: has no parameter to train")


def _said(error: Exception) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split()):.200}"
