"""A network of the user's as a generator: its class is named by a dotted path."""

import hashlib
import inspect
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.nn.parameter import UninitializedParameter

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
        except (Exception, SystemExit) as error:  # whatever the user's class does
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
    except (Exception, SystemExit) as error:  # whatever the user's module does
        raise ValueError(f"target={path}: {_said(error)}; allowed is the path of a class") from error
    if not (isinstance(found, type) and issubclass(found, nn.Module)):
        raise ValueError(f"target={path}: is no class of torch.nn.Module")
    return found


def custom_source(path: str) -> str:
    """SHA-256 of the file that defines a class, so that a run is known by the code of its network."""
    file = inspect.getsourcefile(custom_class(path))
    return hashlib.sha256(Path(file).read_bytes()).hexdigest() if file else ""


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
    except ValueError:
        raise
    except (Exception, SystemExit) as error:  # whatever the user's class does
        raise ValueError(f"target={spec.target}: two images of {side} x {side} px fail: {_said(error)}") from error
    if wrong:
        raise ValueError(f"target={spec.target}: returns {wrong}, allowed are float32 numbers in [-1, 1]")


def _wrong_with(image: Tensor) -> str:
    if image.dtype != torch.float32:
        return str(image.dtype)
    if not image.requires_grad:
        return "an image that does not depend on its parameters"
    return "" if bool(image.isfinite().all()) else "numbers that are not finite"


def _said(error: BaseException) -> str:
    return f"{type(error).__name__}: {' '.join(str(error).split()):.200}"
