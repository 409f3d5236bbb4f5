"""Whether a network of the user's can be trained, and renders what it has learnt once a checkpoint is loaded."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parameter import UninitializedParameter

from ablate.networks.custom import CustomNetwork
from ablate.networks.spec import GeneratorSpec, input_channels
from ablate.networks.stored import check_calls
from ablate.user_code import check_dtype, describe_error, load_anew

_STEPS = 2  # of a trial
_MOST_APART = 0.01  # of an image in [-1, 1] between two renderings; a GPU may round differently each time
_MOST_CHANGED = 0.002  # beyond that, by a checkpoint: a quarter of a grey level
_NAMED = 4  # attributes in a message


class UnsavedStateError(ValueError):
    """A checkpoint does not give a network of the user's back; the message says what is not in it."""


def check_custom(spec: GeneratorSpec, side: int, labels: int = 1) -> None:
    """Try a training of two steps on two images of `side` px, what a checkpoint of it renders, and a larger image.

    A ValueError names the class and what is wrong.
    """
    where = f"target={spec.target}"
    network = CustomNetwork(spec, labels)
    if any(isinstance(parameter, UninitializedParameter) for parameter in network.parameters()):
        raise ValueError(f"{where}: has parameters without a size (lazy layers); give them one")
    if not any(parameter.requires_grad for parameter in network.parameters()):
        raise ValueError(f"{where}: has no parameter to train")
    maps = _trial_maps(spec, side, labels)
    before = dict(network.named_parameters())
    tried = f"two images of {maps.shape[2]} x {maps.shape[3]} px fail"
    try:
        with _evaluating(network):
            image = network(maps, [], [])
            check_dtype()
            _check_image(image, where)  # what it keeps of images now is old when it is trained
        optimizer = torch.optim.Adam(network.parameters(), 1e-3)
        for _ in range(_STEPS):
            image = network(maps, [], [])
            _check_image(image, where)
            if not image.requires_grad:
                raise ValueError(f"{where}: returns an image that does not depend on its parameters")
            optimizer.zero_grad()
            image.mean().backward()
            optimizer.step()
        _check_seeds(spec, labels, maps)
        late = [name for name, value in network.named_parameters() if before.get(name) is not value]
        if late:
            named = ", ".join(name.removeprefix("inner.") for name in late[:_NAMED])
            when = "as it renders: it is neither trained nor loaded; allowed are layers that are made in __init__"
            raise ValueError(f"{where}: makes {named} {when}")
        check_saved(network, spec, labels, side)
        tall = torch.cat(maps.split(1), dim=2)
        tried = f"an image of {tall.shape[2]} x {tall.shape[3]} px fails, as frames are larger than crops"
        with _evaluating(network):
            _check_image(network(tall, [], []), where)
    except (Exception, SystemExit) as error:  # whatever the user's class does
        if str(error).startswith(where):
            raise
        raise ValueError(f"{where}: {tried}: {describe_error(error)}") from error


def _check_seeds(spec: GeneratorSpec, labels: int, maps: Tensor) -> None:
    """Raise ValueError where a class seeds torch as it is made or renders: all trainings would then begin alike."""
    states = []
    for seed in range(2):
        with torch.random.fork_rng([]):
            torch.manual_seed(seed)
            CustomNetwork(spec, labels)(maps, [], [])
            states.append(torch.get_rng_state())
    if torch.equal(*states):
        why = "seeds torch (torch.manual_seed), so that training.seed decides nothing"
        raise ValueError(f"target={spec.target}: {why}; allowed are draws that follow it, and a torch.Generator")


def check_saved(
    network: CustomNetwork,
    spec: GeneratorSpec,
    labels: int,
    side: int,
    state: Mapping[str, Any] | None = None,
    average: Sequence[Tensor] | None = None,
) -> None:
    """Check that a new process that loads a network renders as this one, whatever either has rendered before.

    Two images of one trial are rendered here, one after the other, and in the opposite order by a network that is made
    anew and loads what is saved. What differs is kept elsewhere: in an attribute, a buffer that is not persistent, the
    module of the class.

    Parameters
    ----------
    network : CustomNetwork
        It may be in training; what is rendered here changes no parameter and no buffer of it.
    spec, labels, side : GeneratorSpec, int, int
        What it was made with, and the sides of the images, px.
    state : mapping, optional
        What was saved of it, as it was read back; without it, what would be.
    average : sequence of Tensor, optional
        Parameters that are saved in place of its own.

    Raises
    ------
    UnsavedStateError
        Which names the class, and what it keeps where.
    ValueError
        If it draws random numbers, or returns what is no image.
    """
    where = f"target={spec.target}"
    state = read_back(network.state_dict(), where) if state is None else state
    maps = _trial_maps(spec, side, labels).to(next(network.parameters()).device)
    devices = [maps.device] if maps.is_cuda else []
    with torch.random.fork_rng(devices), _evaluating(network, average):
        first, second, again = (network(maps[k : k + 1], [], []) for k in (0, 1, 0))
        for image in (first, second, again):
            _check_image(image, where)
        noise = float((first - again).abs().max())
        if noise > _MOST_APART:
            raise ValueError(
                f"{where}: renders the same maps differently each time, as it draws random numbers or keeps what it "
                "has rendered before, so that no seed decides an image; allowed is noise that it reads, as its last "
                "channel (model.noise=input)"
            )
        torch.manual_seed(1)  # another than that of the training, as in any other process
        loaded = CustomNetwork(spec, labels, load_anew).to(maps.device)
        try:
            loaded.load_state_dict(state)
        except (Exception, SystemExit) as error:
            raise UnsavedStateError(
                f"{where}: what is saved of it cannot be loaded: {describe_error(error)}"
            ) from error
        with _evaluating(loaded):
            images = [loaded(maps[k : k + 1], [], []) for k in (1, 0)]
    apart = max(float((a - b).abs().max()) for a, b in zip((second, first), images, strict=True))
    if not apart <= _MOST_CHANGED + 2 * noise:
        unsaved = _unsaved(network.inner, loaded.inner)
        names = ", ".join(unsaved[:_NAMED]) or "in its module or elsewhere"
        raise UnsavedStateError(
            f"{where}: another process that loads its checkpoint renders up to {apart * 127.5:.1f} grey levels "
            f"otherwise, as it keeps state that is not saved ({names}); allowed are parameters, register_buffer and "
            "get_extra_state"
        )


def read_back(state: Mapping[str, Any], where: str) -> dict[str, Any]:
    """What is read from a checkpoint of a state_dict; an UnsavedStateError that begins with `where` if it cannot be."""
    read = {}
    for name, value in state.items():
        in_memory = BytesIO()
        try:
            torch.save(value, in_memory)
            check_calls(in_memory)
            in_memory.seek(0)
            read[name] = torch.load(in_memory, map_location="cpu", weights_only=True)
        except Exception as error:  # pickle raises many kinds
            allowed = "allowed are tensors, numbers of Python, text, and lists and dicts of them, as of get_extra_state"
            raise UnsavedStateError(f"{where}: its {name} cannot be read from a checkpoint; {allowed}") from error
    return read


def _trial_maps(spec: GeneratorSpec, side: int, labels: int) -> Tensor:
    """Two images of inputs in [-1, 1], the second much brighter, so that what is kept of one shows in the other.

    They are (2, inputs, side, side), with sides of the next multiple of 2^depth.
    """
    side += -side % 2**spec.depth
    random = torch.Generator().manual_seed(0)
    maps = torch.rand(2, input_channels(spec, labels), side, side, generator=random)
    return 0.4 * maps + torch.tensor([-0.4, 0.6])[:, None, None, None]


@contextmanager
def _evaluating(network: nn.Module, parameters: Sequence[Tensor] | None = None) -> Iterator[None]:
    """Render without gradients, perhaps with other parameters; all that is saved of the network is then as before."""
    modes = {part: part.training for part in network.modules()}  # some may not train, as they were made
    tensors = [*network.parameters(), *network.buffers()]
    kept = [tensor.detach().clone() for tensor in tensors]
    try:
        with torch.no_grad():
            for own, other in zip(network.parameters(), parameters or (), strict=False):
                own.copy_(other)
            network.eval()
            yield
    finally:
        with torch.no_grad():
            for tensor, before in zip(tensors, kept, strict=True):
                if not torch.equal(tensor, before):  # some may not be written to, as expanded ones
                    tensor.copy_(before)
        for part, mode in modes.items():
            part.training = mode


def _check_image(image: Tensor, where: str) -> None:
    if image.dtype != torch.float32 or not bool(image.isfinite().all()):
        returned = image.dtype if image.dtype != torch.float32 else "numbers that are not finite"
        raise ValueError(f"{where}: returns {returned}, allowed are float32 numbers in [-1, 1]")


def _unsaved(network: nn.Module, loaded: nn.Module) -> list[str]:
    """Names of attributes and buffers that differ between two networks and are not in their state_dict."""
    saved, ours = loaded.state_dict().keys(), vars(nn.Module()).keys()
    others = dict(loaded.named_modules())
    names = []
    for path, part in network.named_modules():
        if path not in others:
            continue
        state = {**vars(others[path]), **others[path]._buffers}
        for name, value in {**vars(part), **part._buffers}.items():
            dotted = f"{path}.{name}".lstrip(".")
            if name not in ours and dotted not in saved and not _alike(value, state.get(name)):
                names.append(dotted)
    return names


def _alike(a: Any, b: Any) -> bool:
    """Whether two values have equal numbers, tensors and texts in them."""
    if isinstance(a, nn.Module) and isinstance(b, nn.Module):
        a, b = a.state_dict(), b.state_dict()
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_alike(a[key], b[key]) for key in a)
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(_alike, a, b))
    if isinstance(a, Tensor) and isinstance(b, Tensor):
        return a.shape == b.shape and torch.equal(a.cpu(), b.cpu())
    is_value = isinstance(a, bool | int | float | str | Tensor | np.ndarray | np.generic) or a is None
    return not is_value or np.array_equal(a, b)
